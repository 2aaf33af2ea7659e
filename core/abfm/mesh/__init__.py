"""Triangle meshes: the type, its checks, and reading files."""

from abfm.errors import MeshError
from abfm.mesh.triangle_mesh import BoolArray, FloatArray, IntArray, TriangleMesh, per_mesh

__all__ = ["BoolArray", "FloatArray", "IntArray", "MeshError", "TriangleMesh", "per_mesh"]
