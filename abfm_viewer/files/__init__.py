"""Files of the app: projects, results, autosaves, preferences."""
