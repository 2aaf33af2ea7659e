"""Background jobs: evaluation of functions, matches, and other long computations."""
