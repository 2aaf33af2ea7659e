"""Files that the app reads and writes: projects, results, autosaved copies and preferences."""
