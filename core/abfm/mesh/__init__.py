"""Triangle meshes: the type, its checks, and reading files."""

from abfm.mesh.files import load_mesh
from abfm.mesh.triangle_mesh import TriangleMesh, per_mesh

__all__ = ["TriangleMesh", "load_mesh", "per_mesh"]
