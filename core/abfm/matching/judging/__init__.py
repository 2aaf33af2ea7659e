"""Verification, verdicts and facts of a match."""
