"""Wavefront OBJ: one vertex per ``v`` line, whatever texture coordinates and normals the faces
also name.
"""

from pathlib import Path

from abfm.mesh.readers.contents import FileContents, PointList, PolygonList, text, whole_number
from abfm.mesh.readers.polygons import split_polygons
from abfm.reading import read_bytes


def read_obj(path: Path) -> FileContents:
    """Read vertices and faces of an OBJ file; groups, materials, textures and normals are passed
    over.
    """
    points, polygons = PointList(), PolygonList()
    for line in text(read_bytes(path)).replace("\\\n", " ").splitlines():
        keyword, *words = line.partition("#")[0].split() or [""]
        if keyword == "v":
            points.append(words)
        elif keyword == "f":
            polygons.append([_vertex(word, len(points)) for word in words])
    return split_polygons(points.array(), *polygons.arrays())


def _vertex(word: str, count: int) -> int:
    """Return the index from 0 of the vertex in ``vertex/texture/normal``: counted from 1, or back
    from the last one so far.
    """
    index = whole_number(word.partition("/")[0])
    if index == 0:
        raise ValueError("a face names vertex 0, but OBJ counts vertices from 1")
    return index - 1 if index > 0 else count + index
