"""Small valid files of every kind that abfm reads, each with the door through which users open
it.
"""

from __future__ import annotations

import base64
import gzip
import io
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Literal

import nibabel
import numpy as np
import trimesh

from abfm import Match, Parameters, match
from abfm_viewer.document.document import Channel, Document, Front, Look, Point, Run, Surface, View
from abfm_viewer.files.origin import Origin
from abfm_viewer.files.project import save_project
from tests.mesh_writers import STL_WRITERS, WRITERS, exported
from tests.shapes import icosphere, with_loose_vertex

Door = Literal["mesh", "values", "map", "result", "project", "recent", "preferences", "spec"]

WHOLE = icosphere(1)
MESH = with_loose_vertex(WHOLE)
COUNT = MESH.file_vertex_count
X, Y = MESH.vertices[:, 0].copy(), MESH.vertices[:, 1].copy()

SPECS = (
    "gaussian:vertex=17,width=0.35",
    "gaussian:vertex=17,width=0.35,height=-2.5 + gaussian:x=0.5,y=1,z=-1",
    "coordinate:x + (expression:x**2*sin(3*y) - sqrt(abs(z))) + shape-diameter",
    "eigenfunction:3",
    "geodesic:vertex=4",
    "indicator:axis=x,above=0.25",
    "curvature:mean",
    "wks:energy=0.5",
    "hks:time=0.5",
    "permuted:mirror(coordinate:y + coordinate:z)",
    'file:"a, (b).csv",column=depth',
    "indicator:vertex=3,radius=0.5",
)
"""Functions as text; no file, but what users type and what projects hold."""


@dataclass(frozen=True)
class Specimen:
    """A file: its name, its bytes, the door, and files that it needs beside it; or who puts
    something else there.
    """

    name: str
    door: Door
    content: bytes
    beside: Mapping[str, bytes] = field(default_factory=dict)
    place: Callable[[Path], None] | None = None


@cache
def specimens() -> dict[str, Specimen]:
    """All of them, by name."""
    found = [*_meshes(), *_columns(), *_maps(), *_states(), *_projects()]
    found += [
        Specimen(f"{number}.spec", "spec", spec.encode()) for number, spec in enumerate(SPECS)
    ]
    return {specimen.name: specimen for specimen in found}


@cache
def result() -> Match:
    """A result with everything that results may have."""
    f, g = np.stack([X, Y], axis=1), np.stack([Y, X], axis=1)
    return match(MESH, f, g, Parameters(iterations=3), mask=X**2, weights=[1, 0.5])


def _meshes() -> list[Specimen]:
    vertices, faces = WHOLE.vertices, WHOLE.faces
    found = [Specimen(name, "mesh", write(vertices, faces)) for name, (write, _) in WRITERS.items()]
    found += [
        Specimen(name, "mesh", exported(vertices, faces, kind))
        for name, kind in STL_WRITERS.items()
    ]
    with_more = (
        "mtllib a.mtl\n# made by hand\no sphere\ng all\nvt 0.5 0.5\nvn 0 0 1\nusemtl red\ns off\n"
    )
    lines = [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in vertices.tolist()]
    lines += [
        "f " + " ".join(f"{corner - len(vertices)}/1/1" for corner in face)
        for face in faces.tolist()
    ]
    found.append(Specimen("rich.obj", "mesh", (with_more + "\n".join(lines)).encode()))
    files = trimesh.Trimesh(vertices, faces, process=False).export(file_type="gltf")
    buffers = {name: bytes(content) for name, content in files.items() if name.endswith(".bin")}
    found.append(Specimen("model.gltf", "mesh", bytes(files["model.gltf"]), buffers))
    tree = json.loads(files["model.gltf"])
    for buffer in tree["buffers"]:
        buffer["uri"] = (
            "data:application/octet-stream;base64,"
            + base64.b64encode(buffers[buffer["uri"]]).decode()
        )
    found.append(Specimen("embedded.gltf", "mesh", json.dumps(tree).encode()))
    for encoding in ("ASCII", "B64BIN"):
        found.append(
            Specimen(f"{encoding.lower()}.surf.gii", "mesh", _gifti([vertices, faces], encoding))
        )
    return found


def _gifti(columns: list[np.ndarray], encoding: str = "B64GZ") -> bytes:
    """The arrays, floats and indices, as GIFTI: the first two are those of a surface if they
    have three columns.
    """
    intents = {"f": "NIFTI_INTENT_POINTSET", "i": "NIFTI_INTENT_TRIANGLE"}
    arrays = [
        nibabel.gifti.GiftiDataArray(
            column.astype(f"{column.dtype.kind}4"),
            intent=intents[column.dtype.kind] if column.ndim == 2 else "NIFTI_INTENT_SHAPE",
            encoding=f"GIFTI_ENCODING_{encoding}",
            datatype="NIFTI_TYPE_FLOAT32" if column.dtype.kind == "f" else "NIFTI_TYPE_INT32",
        )
        for column in columns
    ]
    return nibabel.gifti.GiftiImage(darrays=arrays).to_bytes()


def _npy(array: np.ndarray) -> bytes:
    file = io.BytesIO()
    np.save(file, array)
    return file.getvalue()


def _text(array: np.ndarray, delimiter: str = " ", header: str = "") -> bytes:
    file = io.StringIO()
    np.savetxt(file, array, "%.9g", delimiter, header=header, comments="")
    return file.getvalue().encode()


def _columns() -> list[Specimen]:
    one, two = np.arange(COUNT) / 7, np.stack([np.arange(COUNT) / 3, -np.arange(COUNT)], axis=1)
    files = {
        "values.npy": _npy(one),
        "two.npy": _npy(two.astype(">f4")),
        "values.csv": _text(two, ",", 'index,"the depth"'),
        "values.txt": _text(one),
        "two.txt": b"# by hand\n\n" + _text(two, "\t"),
        "values.vts": _text(np.arange(COUNT)),
        "values.gii": _gifti([one]),
        "two.gii.gz": gzip.compress(_gifti([one, -one], "B64BIN"), mtime=0),
    }
    return [Specimen(name, "values", content) for name, content in files.items()]


def _maps() -> list[Specimen]:
    used = np.delete(np.arange(COUNT), 5)
    mirrored = np.arange(COUNT)
    mirrored[used] = used[::-1]
    pairs = np.stack([used, used[::-1]], axis=1)
    files = {
        "map.npy": _npy(mirrored),
        "pairs.csv": _text(pairs, ","),
        "map.txt": _text(mirrored),
        "map.vts": _text(mirrored + 1),
        "map.gii": _gifti([mirrored]),
    }
    found = [Specimen(name, "map", content) for name, content in files.items()]
    return [*found, Specimen("a.sym.vts", "map", _text(used[::-1] + 1), {"a.vts": _text(used + 1)})]


def _states() -> list[Specimen]:
    preferences = {"theme": "dark", "ui_scale": 1.25, "follow": True, "flow_after_match": False}
    return [
        Specimen(
            "recent.json",
            "recent",
            json.dumps(["/nowhere/a.abfm", "recent.json", "b.off"]).encode(),
        ),
        Specimen("preferences.json", "preferences", json.dumps(preferences, indent=1).encode()),
    ]


def _projects() -> list[Specimen]:
    found = result()
    plain = Document((Surface(MESH, "a ball"),), (Channel("gaussian:vertex=7", "coordinate:y"),))
    front = Front((0.0, 0.0, 1.0), (0.0, 1.0, 0.0))
    rich = Document(
        (Surface(MESH, "a ball", front),),
        channels=(
            Channel("file:x.npy + gaussian:vertex=7", "coordinate:y"),
            Channel("eigenfunction:2", "wks:energy=0.5", 0.5),
        ),
        channel=1,
        parameters=found.parameters,
        mask="indicator:axis=x,above=0.0",
        result=found,
        runs=(
            Run(found.energy_history, found.stages, (2,), 0.25, "alpha 1"),
            Run(
                np.ones((2, 3)),
                np.array([0, 1]),
                (),
                0.5,
                "two meshes",
                np.array([12, 42]),
                np.array([0.5, 0.0]),
            ),
        ),
        time=0.25,
        lines=(Point(3, (0.25, 0.25, 0.5)),),
        points=(Point(0, (1.0, 0.0, 0.0)),),
        view=View(look=Look(front, 2.5, (0.1, 0.2, 0.3)), hidden=("source",), arrows=True),
    )
    with TemporaryDirectory() as folder:
        path = Path(folder, "a")
        files: list[Specimen] = []
        found.save(path)
        files.append(Specimen("result.npz", "result", path.read_bytes()))
        save_project(path, plain, {})
        files.append(Specimen("plain.abfm", "project", path.read_bytes()))
        save_project(path, rich, {"file:x.npy": X})
        files.append(Specimen("rich.abfm", "project", path.read_bytes()))
        save_project(path, rich, {"file:x.npy": X}, Origin(Path("/nowhere/rich.abfm"), 1, 2))
        files.append(Specimen("autosave-1.abfm", "project", path.read_bytes()))
    return files
