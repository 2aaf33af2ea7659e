"""Repairs of a mesh that its reader asks for by `MeshOptions`."""
