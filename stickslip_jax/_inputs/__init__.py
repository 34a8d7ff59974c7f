"""Numbers of a system, its excitation and its start: by name, and those that differ from sample to sample."""
