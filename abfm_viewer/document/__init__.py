"""Immutable documents: the user's input, the result and the view."""
