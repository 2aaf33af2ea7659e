"""Frames of films in files of several programs."""
