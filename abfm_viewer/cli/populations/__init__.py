"""The command for populations, and their page."""
