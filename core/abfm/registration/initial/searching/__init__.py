"""Search for an initial map among relaxed candidates."""
