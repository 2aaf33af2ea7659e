"""Images and colours of OBJ files and their MTL files (http://paulbourke.net/dataformats/mtl/)."""

from array import array
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from abfm.errors import brief, one_line
from abfm.mesh.readers.colored import ColoredFaces, Material, inside
from abfm.mesh.readers.contents import Lists, split_polygons
from abfm.mesh.readers.plain import obj_index, obj_lines
from abfm.mesh.readers.references import References
from abfm.reading import Opened, number


def colored_obj(opened: Opened, has_materials: bool = True) -> ColoredFaces:
    """Read an OBJ file with its colours, and its materials in MTL files if it ``has_materials``.

    Vertex colours are the three numbers after the coordinates of vertices.
    """
    lines, references = _Lines(), References(opened.path)
    materials: dict[str, Material] = {}
    read = set[Path]()
    for keyword, words in obj_lines(opened.data):
        if keyword != "mtllib":
            lines.take(keyword, words)
        elif has_materials and (path := references.find(" ".join(words))) not in read:
            read.add(path)
            materials |= _read_mtl(references, " ".join(words))
    return lines.found(materials)


class _Lines:
    """Vertices, faces and colours from the lines of an OBJ file that were read so far."""

    def __init__(self) -> None:
        self._lists, self._places, self._colors = Lists(), array("d"), array("d")
        self._named, self._owners = array("q"), array("q")  # -1: no texture coordinates
        self._names, self._current = {"": 0}, 0

    def take(self, keyword: str, words: Sequence[str]) -> None:
        if keyword == "v":
            self._lists.add_vertex(words)
            if len(words) >= 6:
                self._colors.extend(map(number, words[3:6]))
        elif keyword == "vt":
            self._places.extend(number(word) for word in (*words, "0", "0")[:2])
        elif keyword == "usemtl":
            self._current = self._names.setdefault(" ".join(words), len(self._names))
        elif keyword == "f":
            count = self._lists.vertex_count
            self._lists.add_polygon([obj_index(word, count) for word in words])
            self._named.extend(map(self._place, words))
            self._owners.append(self._current)

    def _place(self, word: str) -> int:
        named = word.split("/")[1:2]
        if not named or not named[0]:
            return -1
        count = len(self._places) // 2
        index = obj_index(named[0], count)
        if not 0 <= index < count:
            raise ValueError(
                f"a face refers to texture coordinates {brief(named[0])}, but the lines before it "
                f"have {count}"
            )
        return index

    def found(self, materials: dict[str, Material]) -> ColoredFaces:
        vertices, (sizes, corners) = self._lists.vertices(), self._lists.polygons()
        corners = inside(corners, len(vertices))
        # split as in `read_obj`; each corner is a separate vertex, so that it can be identified
        triangles = split_polygons(vertices[corners], sizes, np.arange(len(corners))).faces
        colors = np.ones((len(vertices), 4))
        if len(self._colors) == vertices.size:
            colors[:, :3] = np.clip(np.reshape(self._colors, (-1, 3)), 0, 1)
        places = np.append(np.array(self._places), [np.nan, np.nan]).reshape(-1, 2)
        faces = corners[triangles]
        return ColoredFaces(
            vertices,
            faces,
            places[np.array(self._named, dtype=np.int64)[triangles]],
            colors[faces],
            np.repeat(np.array(self._owners, dtype=np.int64), sizes - 2),
            tuple(materials.get(name, Material()) for name in self._names),
        )


def _read_mtl(references: References, name: str) -> dict[str, Material]:
    found: dict[str, Material] = {}
    current = None
    for keyword, words in obj_lines(references.read(name)):
        if keyword == "newmtl":
            current = " ".join(words)
            found[current] = Material(alpha_mode="BLEND")
        elif current is not None and words:
            found[current] = _with(found[current], keyword, words, references)
    # the colour next to an image is ignored: files with Kd 0 do not mean a black image
    return {
        name: each._replace(color=(1.0, 1.0, 1.0, each.color[3])) if each.image else each
        for name, each in found.items()
    }


def _with(
    material: Material, keyword: str, words: Sequence[str], references: References
) -> Material:
    """Return a material to which a line of an MTL file is applied: its keyword and its words."""
    *color, opacity = material.color
    if keyword == "kd":
        color = [min(max(number(word), 0.0), 1.0) for word in (*words, *words, *words)[:3]]
    elif keyword in ("d", "tr"):
        value = min(max(number(words[-1]), 0.0), 1.0)
        opacity = value if keyword == "d" else 1 - value
    elif keyword == "map_kd":
        if words[0].startswith("-"):
            raise ValueError(
                f"map_Kd of a material has options ({one_line(words[0], 20)}), which are not "
                "supported. Remove all but the name of the image"
            )
        return material._replace(image=references.read(" ".join(words)))
    return material._replace(color=(color[0], color[1], color[2], opacity))
