"""Readers of frames in files of several programs."""
