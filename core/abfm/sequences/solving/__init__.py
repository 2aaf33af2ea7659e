"""Solution of a sequence: one interval, the choice of norm and sigma, and sweeps through time."""
