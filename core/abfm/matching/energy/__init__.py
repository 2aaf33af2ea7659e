"""The energy of the paper, with its gradient."""
