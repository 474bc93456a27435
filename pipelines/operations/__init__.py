"""Operations: signals that stop a run, the jobs of sweeps, and experiment tracking."""
