"""Triangle meshes: the type, its checks, and reading files."""

from abfm.errors import MeshError
from abfm.mesh.files import load_mesh
from abfm.mesh.topology import BoolArray, FloatArray, IntArray
from abfm.mesh.triangle_mesh import TriangleMesh, per_mesh

__all__ = ["BoolArray", "FloatArray", "IntArray", "MeshError", "TriangleMesh", "load_mesh", "per_mesh"]
