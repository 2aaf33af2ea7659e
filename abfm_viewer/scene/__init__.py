"""The surfaces and what lies on them, in polyscope."""
