"""From a recording of where a camera looked to its orientation PDF, the paper's Monte Carlo procedure."""
