"""The paper's tables and figures beside what the stored sweeps found."""
