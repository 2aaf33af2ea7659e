"""Triangle meshes: the type, its checks, and readers of mesh files."""

from abfm.mesh.files import as_mesh, as_meshes, load_mesh
from abfm.mesh.objects import MeshLike
from abfm.mesh.triangle_mesh import TriangleMesh, per_mesh

__all__ = ["MeshLike", "TriangleMesh", "as_mesh", "as_meshes", "load_mesh", "per_mesh"]
