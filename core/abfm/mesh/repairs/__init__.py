"""Optional repairs of a mesh, requested by `MeshOptions`."""
