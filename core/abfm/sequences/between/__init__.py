"""Interpolation between frames, and the share of motion that held-out frames confirm."""
