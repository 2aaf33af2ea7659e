"""Sheets of panels and plots: matches, the paper's figures, and a page with all of these."""
