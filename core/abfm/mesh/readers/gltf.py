"""glTF scenes, as text (.gltf, with its buffers in it or beside it) and binary (.glb)."""

from typing import Any

import numpy as np

from abfm.mesh.readers.contents import FileContents, merge_by_position
from abfm.mesh.readers.gltf_document import PARTS_MAX, Document, Part
from abfm.mesh.readers.gltf_json import of
from abfm.mesh.readers.gltf_shapes import shaped
from abfm.mesh.topology import edges_of_faces
from abfm.reading import Opened
from abfm.types import FloatArray


def read_gltf(opened: Opened) -> FileContents:
    """Read all triangles of a scene as it is shown at rest: transformed, morphed and skinned.

    glTF repeats a vertex wherever texture or normal are discontinuous. Where that leaves cracks,
    vertices at the same position are merged.
    """
    document = Document(opened)
    contents = joined(placed_parts(document))
    if not document.is_animated:
        return contents
    note = "its animations are not applied: it is read as it is at rest"
    return contents._replace(messages=(*contents.messages, note))


def placed_parts(document: Document) -> list[Part]:
    """Return what has triangles, as the scene places it."""
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
            points, is_mirrored = placed[key]  # what is mirrored keeps its outer side
            faces = part.faces[:, ::-1] if is_mirrored else part.faces
            parts.append(Part(points, faces, part.primitive))
        if len(parts) > PARTS_MAX:
            raise ValueError(
                f"its scene has more than {PARTS_MAX} parts: export what is to be matched alone"
            )
    return parts


def _vertices_of(primitive: dict[str, Any]) -> tuple[int, ...]:
    """Return the numbers of the accessors that place the vertices of a primitive."""
    attributes = of(primitive, "attributes", dict, {})
    targets = of(primitive, "targets", list, [])
    places = [of(entry, "POSITION", int, -1) for entry in (attributes, *targets)]
    names = sorted(name for name in attributes if name.startswith(("JOINTS_", "WEIGHTS_")))
    return (*places, *(of(attributes, name, int, -1) for name in names))


def joined(parts: list[Part]) -> FileContents:
    """Return the vertices and faces of all parts, merged by position where that closes cracks."""
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
