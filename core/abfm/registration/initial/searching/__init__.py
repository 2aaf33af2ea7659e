"""The search of an initial map among relaxed candidates."""
