"""The criteria: what counts as seen, by the paper and by a detector that was measured."""
