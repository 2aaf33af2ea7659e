"""glTF scenes, as text (.gltf, with its buffers in it or beside it) and binary (.glb).

Only the triangles are read, and nothing of materials, images or animations. Own code: trimesh makes
2.4 GB and 19 s of 600 bytes that announce 100 million vertices, takes matrices that are not finite,
and leaves out what is sparse; pygltflib reads the JSON alone, and checks none of it.
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from abfm.mesh.readers.contents import FileContents, merge_by_position
from abfm.mesh.readers.gltf_data import Document
from abfm.mesh.topology import edges_of_faces
from abfm.types import FloatArray, IntArray

TRIANGLES, STRIP, FAN = 4, 5, 6  # modes of primitives; the others are points and lines
_MOST_PARTS = 50_000  # of the scene: primitives, each as often as it is placed, and nodes
# vertices of all parts, over those that are in the file; so many may be anyway
_MOST_TIMES, _FEW = 4, 1_000_000

Part = tuple[FloatArray, IntArray]


def read_gltf(path: Path) -> FileContents:
    """Read all triangles of a scene, transformed as it says.

    glTF repeats a vertex wherever texture or normal are discontinuous. Where that leaves cracks,
    vertices at the same position are merged.
    """
    document = Document(path)
    meshes: dict[int, list[Part]] = {}
    parts: list[Part] = []
    there = placed = 0
    for mesh, matrix in _placements(document):
        if mesh not in meshes:
            meshes[mesh] = list(_parts(document, mesh))
            there += sum(len(points) for points, _ in meshes[mesh])
        for points, faces in meshes[mesh]:
            parts.append(_moved(points, faces, matrix))
            placed += len(points)
        if len(parts) > _MOST_PARTS or placed > max(_FEW, _MOST_TIMES * there):
            raise ValueError(
                f"its scene shows its meshes again and again, more than {len(parts) - 1} times, "
                f"with {placed} vertices "
                f"where the file has {there}: export what is to be matched alone"
            )
    starts = np.cumsum([0, *(len(points) for points, _ in parts)])
    vertices = np.concatenate([np.zeros((0, 3)), *(points for points, _ in parts)])
    shifted = [faces + start for (_, faces), start in zip(parts, starts[:-1], strict=True)]
    split = FileContents(vertices, np.concatenate([np.zeros((0, 3), dtype=np.int64), *shifted]))
    if not split.faces.size or split.faces.max() >= len(vertices):
        return split
    merged = merge_by_position(split.vertices, split.faces)
    return merged if _boundary_length(merged) < _boundary_length(split) else split


def _placements(document: Document) -> Iterator[tuple[int, FloatArray]]:
    """Return the mesh and transformation (4, 4) of every node of the scene that has one: parents
    first, last children first.
    """
    seen: set[int] = set()
    left = [(root, np.eye(4)) for root in document.roots()]
    while left:
        index, above = left.pop()
        if index in seen or len(seen) > _MOST_PARTS:
            reason = (
                "is in the scene twice" if index in seen else f"is beyond the first {_MOST_PARTS}"
            )
            raise ValueError(f"node {index} {reason}: export what is to be matched alone")
        seen.add(index)
        node = document.node(index)
        matrix = above @ node.matrix
        if node.mesh is not None:
            yield node.mesh, matrix
        left.extend((child, matrix) for child in node.children)


def _parts(document: Document, mesh: int) -> Iterator[Part]:
    """Return the vertices and faces of the primitives of a mesh that have triangles."""
    for primitive in document.primitives(mesh):
        if primitive.mode not in (TRIANGLES, STRIP, FAN):
            continue
        points = document.numbers(primitive.positions, "VEC3").astype(np.float64)
        if primitive.indices is None:
            corners = np.arange(len(points))
        else:
            corners = document.numbers(primitive.indices, "SCALAR").astype(np.int64).ravel()
        if primitive.mode == TRIANGLES:
            if len(corners) % 3:
                raise ValueError(
                    f"mesh {mesh} has {len(corners)} corners, which do not make whole triangles"
                )
            faces = corners.reshape(-1, 3)
        else:
            first = (
                corners[:-2]
                if primitive.mode == STRIP
                else np.repeat(corners[:1], max(len(corners) - 2, 0))
            )
            faces = np.stack([first, corners[1:-1], corners[2:]], axis=1)
            if primitive.mode == STRIP:
                faces[1::2] = faces[1::2, ::-1]
        if faces.size and faces.max() >= len(points):
            raise ValueError(
                f"mesh {mesh} names vertex {faces.max()} of {len(points)} numbered from 0"
            )
        yield points, faces


def _moved(points: FloatArray, faces: IntArray, matrix: FloatArray) -> Part:
    """Return a part as it is placed; what is mirrored keeps its outer side."""
    if np.array_equal(matrix, np.eye(4)):
        return points, faces
    moved = (matrix @ np.column_stack([points, np.ones(len(points))]).T).T[:, :3]
    return moved, faces[:, ::-1] if np.linalg.det(matrix[:3, :3]) < 0 else faces


def _boundary_length(contents: FileContents) -> int:
    """Return the number of edges with a single face."""
    _, face_edges = edges_of_faces(contents.faces, len(contents.vertices))
    return int(np.sum(np.bincount(face_edges.ravel()) == 1))
