"""Panels of the tab Functions: meshes, functions, landmarks, the initial map and frames."""
