"""Frames between given ones, and how much motion left-out frames confirm."""
