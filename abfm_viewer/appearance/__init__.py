"""Colours, theme, fonts and material."""
