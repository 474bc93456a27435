"""The paper's tables and figures beside the results of the stored sweeps."""
