"""Unsaved changes, and export of pictures, movies and data."""
