"""Files of the app: projects, results, autosaved copies and preferences."""
