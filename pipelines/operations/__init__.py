"""Operations: signals that stop a run, jobs of sweeps, and experiment tracking."""
