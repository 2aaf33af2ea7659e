"""Reader of glTF scenes, text (.gltf with embedded or separate buffers) and binary (.glb).

The positions of vertices include morph targets and the transformation of a node or skin. Format:
sections 3.7.2.2 (morph targets) and 3.7.3 (skins) of glTF 2.0.
"""

from typing import Any

import numpy as np

from abfm.mesh.readers.contents import FileContents, merge_by_position
from abfm.mesh.readers.gltf_document import PARTS_MAX, Document, Part, numbers_of, of
from abfm.mesh.topology import edges_of_faces
from abfm.reading import Opened
from abfm.types import FloatArray

_CHUNK_VERTICES = 1 << 14  # number of skinned vertices processed together


def read_gltf(opened: Opened) -> FileContents:
    """Read all triangles of a scene in its rest pose: transformed, morphed and skinned.

    glTF files repeat a vertex if its texture coordinates or normals are discontinuous. Vertices at
    the same position are therefore merged if this makes the boundary of the surface shorter.
    """
    document = Document(opened)
    contents = joined(placed_parts(document))
    if not document.is_animated:
        return contents
    note = "animations are ignored; the scene was read in its rest pose"
    return contents._replace(messages=(*contents.messages, note))


def placed_parts(document: Document) -> list[Part]:
    meshes: dict[int, list[Part]] = {}
    parts: list[Part] = []
    for node, matrix in list(document.placements()):
        mesh = of(node, "mesh", int, None)
        if mesh not in meshes:
            meshes[mesh] = list(document.parts(mesh))
        placed: dict[tuple[int, ...], tuple[FloatArray, bool]] = {}
        for part in meshes[mesh]:
            key = _vertices_of(part.primitive)
            if key not in placed:
                document.count(len(part.points))
                placed[key] = shaped(document, part, node, matrix)
            document.count(len(part.faces))
            points, is_mirrored = placed[key]  # mirroring turns the outer side of faces inward
            faces = part.faces[:, ::-1] if is_mirrored else part.faces
            parts.append(Part(points, faces, part.primitive))
        if len(parts) > PARTS_MAX:
            raise ValueError(
                f"the scene has more than {PARTS_MAX} parts. Export the surface to be matched alone"
            )
    return parts


def _vertices_of(primitive: dict[str, Any]) -> tuple[int, ...]:
    """Return the indices of the accessors that determine the vertices of a glTF primitive."""
    attributes = of(primitive, "attributes", dict, {})
    targets = of(primitive, "targets", list, [])
    places = [of(entry, "POSITION", int, -1) for entry in (attributes, *targets)]
    names = sorted(name for name in attributes if name.startswith(("JOINTS_", "WEIGHTS_")))
    return (*places, *(of(attributes, name, int, -1) for name in names))


def joined(parts: list[Part]) -> FileContents:
    """Return the vertices and faces of all parts as one surface."""
    arrays = {id(part.points): part.points for part in parts}
    starts = np.cumsum([0, *(len(points) for points in arrays.values())])
    start_of = dict(zip(arrays, starts.tolist(), strict=False))
    vertices = np.concatenate([np.zeros((0, 3)), *arrays.values()])
    shifted = [part.faces + start_of[id(part.points)] for part in parts]
    split = FileContents(vertices, np.concatenate([np.zeros((0, 3), dtype=np.int64), *shifted]))
    if not split.faces.size or split.faces.max() >= len(vertices):
        return split
    merged = merge_by_position(split.vertices, split.faces)
    return merged if _boundary_length(merged) < _boundary_length(split) else split


def _boundary_length(contents: FileContents) -> int:
    _, face_edges = edges_of_faces(contents.faces, len(contents.vertices))
    return int(np.sum(np.bincount(face_edges.ravel()) == 1))


def shaped(
    document: Document, part: Part, node: dict[str, Any], matrix: FloatArray
) -> tuple[FloatArray, bool]:
    """Return the positions (n, 3) of a part in the scene, and whether the part is mirrored.

    The part belongs to the mesh of a ``node`` with the transformation ``matrix`` (4, 4), which a
    skin replaces. Raises ValueError if the data are invalid.
    """
    points = _morphed(document, part, node)
    if (skin := of(node, "skin", int, None)) is not None:
        return _skinned(document, part, points, skin)
    is_mirrored = bool(np.linalg.det(matrix[:3, :3]) < 0)
    if np.array_equal(matrix, np.eye(4)):
        return points, is_mirrored
    return (matrix @ np.column_stack([points, np.ones(len(points))]).T).T[:, :3], is_mirrored


def _morphed(document: Document, part: Part, node: dict[str, Any]) -> FloatArray:
    """Return the vertices (n, 3) of a part, displaced by the weighted sum of its morph targets."""
    targets = of(part.primitive, "targets", list, [])
    mesh = document.entry("meshes", of(node, "mesh", int, None))
    holder = node if "weights" in node else mesh
    if not targets or "weights" not in holder:
        return part.points
    points = part.points
    weights = numbers_of(holder, "weights", len(targets), "mesh with morph targets")
    for weight, target in zip(weights.tolist(), targets, strict=True):
        position = of(target, "POSITION", int, None)
        if weight != 0 and position is not None:
            document.count(len(points))
            shift = document.at_vertices(part, position, "VEC3", as_shares=False)
            points = points + weight * shift
    return points


def _skinned(
    document: Document, part: Part, points: FloatArray, skin: int
) -> tuple[FloatArray, bool]:
    """Return points (n, 3) moved by the joints of a skin, and whether the part is mirrored."""
    matrices = document.joint_matrices(skin)
    attributes = of(part.primitive, "attributes", dict, {})
    joints, weights = [], []
    for k in range(len(attributes)):
        of_set = [of(attributes, f"{name}_{k}", int, None) for name in ("JOINTS", "WEIGHTS")]
        if None in of_set:
            break
        joints.append(document.numbers(of_set[0], "VEC4").astype(np.int64))
        weights.append(document.at_vertices(part, of_set[1], "VEC4"))
    if not joints:
        raise ValueError("a mesh has a skin; glTF also requires JOINTS_0 and WEIGHTS_0")
    joint, weight = np.concatenate(joints, axis=1), np.concatenate(weights, axis=1)
    if joint.shape != weight.shape:
        raise ValueError(
            f"a mesh has joints for {len(joint)} vertices but weights for {len(weight)}; expected "
            "the same numbers"
        )
    document.count(joint.shape[0] * len(joints))
    if not 0 <= joint.min(initial=0) <= joint.max(initial=0) < max(len(matrices), 1):
        raise ValueError(
            f"a vertex refers to joint {joint.max()}, but skin {skin} has {len(matrices)} joints"
        )
    sums = weight.sum(axis=1)
    if not (sums > 0).all():
        raise ValueError(
            f"vertex {np.argmin(sums > 0)} of a mesh with skin {skin} has no weight above 0"
        )
    weight = weight / sums[:, None]
    places = np.column_stack([points, np.ones(len(points))])
    moved = np.empty_like(points)
    for start in range(0, len(points), _CHUNK_VERTICES):
        some = slice(start, start + _CHUNK_VERTICES)
        blended = np.einsum("vk,vkij->vij", weight[some], matrices[joint[some], :3])
        moved[some] = np.einsum("vij,vj->vi", blended, places[some])
    turns = np.sum(weight * np.linalg.det(matrices[:, :3, :3])[joint])
    return moved, bool(turns < 0)
