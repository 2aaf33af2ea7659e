"""Points of surfaces, maps between surfaces, and how good they are."""
