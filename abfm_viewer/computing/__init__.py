"""Background jobs: values of functions, matches and other long computations."""
