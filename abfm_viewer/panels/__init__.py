"""One panel per file: each draws itself from the session and calls its methods."""
