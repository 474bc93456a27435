"""Operations: what tells a run to stop, what runs the jobs of a sweep, and what records them."""
