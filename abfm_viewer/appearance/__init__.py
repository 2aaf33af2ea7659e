"""Colours, themes, bundled samples and abbreviated texts."""
