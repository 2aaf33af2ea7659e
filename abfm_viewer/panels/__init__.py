"""Panels of the window, one per file; they draw the session and call its methods."""
