"""The fields of all intervals: one interval, the norm and sigma, the sweeps through time."""
