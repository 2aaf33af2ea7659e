"""Immutable documents, each with the user's input, the result and the view."""
