"""Repairs of a mesh, requested by `MeshOptions`."""
