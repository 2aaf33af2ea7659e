"""Small valid files of every kind that abfm reads, each with the door that opens it.

A format is added by a line of `_newer`, with a function that returns the bytes of a small file.
"""

import base64
import gzip
import io
import json
import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import nibabel
import numpy as np
import scipy.io
import trimesh

from abfm import Parameters, match
from abfm.batch import Ledger, Row
from abfm.batch.ledger import Record
from abfm.pages.front import Front
from abfm_viewer.document.document import Channel, Document, Look, Point, Run, Surface, View
from abfm_viewer.files.project import Origin, save_project
from tests.core.reading.vtk_files import vtk_bytes
from tests.mesh_writers import STL_WRITERS, WRITERS, exported, off_file, off_text
from tests.shapes import icosphere, with_loose_vertex

WHOLE = icosphere(1)
MESH = with_loose_vertex(WHOLE)
COUNT = MESH.file_vertex_count
X, Y = MESH.vertices[:, 0].copy(), MESH.vertices[:, 1].copy()
# functions as text: no file, but what users type and what projects hold
SPECS = (
    "gaussian:vertex=17,width=0.35",
    "gaussian:vertex=17,width=0.35,height=-2.5 + gaussian:x=0.5,y=1,z=-1",
    "coordinate:x + (expression:x**2*sin(3*y) - sqrt(abs(z))) + shape-diameter",
    *("eigenfunction:3", "geodesic:vertex=4", "indicator:axis=x,above=0.25", "curvature:mean"),
    *("wks:energy=0.5", "hks:time=0.5", "permuted:mirror(coordinate:y + coordinate:z)"),
    *('file:"a, (b).csv",column=depth', "indicator:vertex=3,radius=0.5"),
)


@dataclass(frozen=True)
class Specimen:
    """A file, its door, files that it needs beside it, or who puts something else there."""

    name: str
    door: str
    content: bytes
    beside: Mapping[str, bytes] = field(default_factory=dict)
    place: Callable[[Path], None] | None = None
    must_be_refused: bool = False


@cache
def specimens():
    """All of them, by name."""
    used = np.delete(np.arange(COUNT), 5)
    sym_vts = Specimen("a.sym.vts", "map", _text(used[::-1] + 1), {"a.vts": _text(used + 1)})
    specs = {f"{number}.spec": spec.encode() for number, spec in enumerate(SPECS)}
    recent = ["/nowhere/a.abfm", "recent.json", "b.off"]
    preferences = {"theme": "dark", "ui_scale": 1.25, "follow": True, "flow_after_match": False}
    found = [
        *_meshes(),
        *_all("values", _columns() | _labels()),
        *_all("map", _maps(used)),
        sym_vts,
        Specimen("recent.json", "recent", json.dumps(recent).encode()),
        Specimen("preferences.json", "preferences", json.dumps(preferences, indent=1).encode()),
        *_projects(),
        *_all("spec", specs),
        *(Specimen(name, door, content) for name, (door, content) in _newer().items()),
        *_lists_of_frames(),
        *_batch(),
        _subjects(),
    ]
    return {specimen.name: specimen for specimen in found}


def _all(door, files):
    return [Specimen(name, door, content) for name, content in files.items()]


def _meshes():
    vertices, faces = WHOLE.vertices, WHOLE.faces
    files = {name: write(vertices, faces) for name, (write, _) in WRITERS.items()}
    files |= {name: exported(vertices, faces, kind) for name, kind in STL_WRITERS.items()}
    lines = "mtllib a.mtl\n# made by hand\no sphere\ng all\nvt 0.5 0.5\nvn 0 0 1\nusemtl red\ns off"
    rows = [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in vertices.tolist()]
    for face in (faces - len(vertices)).tolist():
        rows.append("f " + " ".join(f"{corner}/1/1" for corner in face))
    files["rich.obj"] = "\n".join([lines, *rows]).encode()
    made = trimesh.Trimesh(vertices, faces, process=False).export(file_type="gltf")
    buffers = {name: bytes(content) for name, content in made.items() if name.endswith(".bin")}
    tree = json.loads(made["model.gltf"])
    for buffer in tree["buffers"]:
        data = base64.b64encode(buffers[buffer["uri"]]).decode()
        buffer["uri"] = f"data:application/octet-stream;base64,{data}"
    embedded = {"embedded.gltf": json.dumps(tree).encode()}
    for encoding in ("ASCII", "B64BIN"):
        embedded[f"{encoding.lower()}.surf.gii"] = _gifti([vertices, faces], encoding)
    model = Specimen("model.gltf", "mesh", bytes(made["model.gltf"]), buffers)
    return [*_all("mesh", files), model, *_all("mesh", embedded)]


def _gifti(columns, encoding="B64GZ", labels=None):
    """Arrays as GIFTI: two of three columns are a surface, and with names of labels keys."""
    kind = "NIFTI_INTENT_LABEL" if labels else "NIFTI_INTENT_SHAPE"
    intents = {"f": "NIFTI_INTENT_POINTSET", "i": "NIFTI_INTENT_TRIANGLE"}
    arrays = [
        nibabel.gifti.GiftiDataArray(
            column.astype(f"{column.dtype.kind}4"),
            intent=intents[column.dtype.kind] if column.ndim == 2 else kind,
            encoding=f"GIFTI_ENCODING_{encoding}",
            datatype="NIFTI_TYPE_FLOAT32" if column.dtype.kind == "f" else "NIFTI_TYPE_INT32",
        )
        for column in columns
    ]
    image = nibabel.gifti.GiftiImage(darrays=arrays)
    for key, name in (labels or {}).items():
        label = nibabel.gifti.GiftiLabel(key, 0.5, 0.25, 1.0, 1.0)
        label.label = name
        image.labeltable.labels.append(label)
    return image.to_bytes()


def _npy(array):
    file = io.BytesIO()
    np.save(file, array)
    return file.getvalue()


def _text(array, delimiter=" ", header=""):
    file = io.StringIO()
    np.savetxt(file, array, "%.9g", delimiter, header=header, comments="")
    return file.getvalue().encode()


def _columns():
    one, two = np.arange(COUNT) / 7, np.stack([np.arange(COUNT) / 3, -np.arange(COUNT)], axis=1)
    return {
        "values.npy": _npy(one),
        "two.npy": _npy(two.astype(">f4")),
        "values.csv": _text(two, ",", 'index,"the depth"'),
        "values.txt": _text(one),
        "two.txt": b"# by hand\n\n" + _text(two, "\t"),
        "values.vts": _text(np.arange(COUNT)),
        "values.gii": _gifti([one]),
        "two.gii.gz": gzip.compress(_gifti([one, -one], "B64BIN"), mtime=0),
    }


def _labels():
    """Of FreeSurfer and GIFTI; a door asks for the label ``a`` of what holds several."""
    keys = np.arange(COUNT) % 3
    names = {1: "a", 2: "b", -5: "c"}
    rows = "".join(f"{k} 0.5 {k}.25 -1 {k}e-1\n" for k in range(3, COUNT, 4))
    table = [(name, (key + 5, 2, 3, 0)) for key, name in names.items()]
    colours = [5 + key + 2 * 256 + 3 * 65536 for key in names]
    annotation = struct.pack(">i", COUNT)
    annotation += np.stack([np.arange(COUNT), np.take(colours, keys)], 1).astype(">i4").tobytes()
    annotation += struct.pack(">iiii", 1, -2, 3, 0) + struct.pack(">i", len(table))
    for number, (name, colour) in enumerate(table):
        annotation += struct.pack(">ii2s4i", number, 2, name.encode(), *colour)
    overlay = struct.pack(">7i256x", 1, COUNT, 1, 1, 1, 3, 0)
    overlay += (np.arange(COUNT) / 3).astype(">f4").tobytes()
    values = struct.pack(">3sIIi", b"\xff\xff\xff", COUNT, 7, 1)
    return {
        "a.label.gii": _gifti([keys], labels=names),
        "lh.annot": annotation,
        "lh.label": f"#!ascii label\n{len(range(3, COUNT, 4))}\n{rows}".encode(),
        "lh.mgz": gzip.compress(overlay, mtime=0),
        "lh.sulc": values + (np.arange(COUNT) / 7).astype(">f4").tobytes(),
    }


def _maps(used):
    mirrored = np.arange(COUNT)
    mirrored[used] = used[::-1]
    return {
        "map.npy": _npy(mirrored),
        "pairs.csv": _text(np.stack([used, used[::-1]], axis=1), ","),
        "map.txt": _text(mirrored),
        "map.vts": _text(mirrored + 1),
        "map.gii": _gifti([mirrored]),
    }


def _projects():
    f, g = np.stack([X, Y], axis=1), np.stack([Y, X], axis=1)
    # with everything that results may have
    result = match(MESH, f, g, Parameters(iterations=3), mask=X**2, weights=[1, 0.5])
    plain = Document((Surface(MESH, "a ball"),), (Channel("gaussian:vertex=7", "coordinate:y"),))
    front = Front((0.0, 0.0, 1.0), (0.0, 1.0, 0.0))
    stages, coarse = np.array([0, 1]), (np.array([12, 42]), np.array([0.5, 0.0]))
    first = Channel("file:x.npy + gaussian:vertex=7", "coordinate:y")
    run = Run(result.energy_history, result.stages, (2,), 0.25, "alpha 1")
    rich = Document(
        (Surface(MESH, "a ball", front),),
        channels=(first, Channel("eigenfunction:2", "wks:energy=0.5", 0.5)),
        channel=1,
        parameters=result.parameters,
        mask="indicator:axis=x,above=0.0",
        result=result,
        runs=(run, Run(np.ones((2, 3)), stages, (), 0.5, "two meshes", *coarse)),
        time=0.25,
        lines=(Point(3, (0.25, 0.25, 0.5)),),
        points=(Point(0, (1.0, 0.0, 0.0)),),
        view=View(look=Look(front, 2.5, (0.1, 0.2, 0.3)), hidden=("source",), arrows=True),
    )
    origin, known = Origin(Path("/nowhere/rich.abfm"), 1, 2), {"file:x.npy": X}
    found = {}
    with TemporaryDirectory() as folder:
        path = Path(folder, "a")
        for name, save in {
            "plain.abfm": lambda: save_project(path, plain, {}),
            "rich.abfm": lambda: save_project(path, rich, known),
            "autosave-1.abfm": lambda: save_project(path, rich, known, origin),
            "result.npz": lambda: result.save(path),
        }.items():
            save()
            found[name] = path.read_bytes()
    return [*_all("result", {"result.npz": found.pop("result.npz")}), *_all("project", found)]


def _newer():
    """Return door and bytes of files by name."""
    film = np.stack([X, Y, X * Y])
    on_file = MESH.on_file(film.T, 0.0).T
    stc = struct.pack(">ffI", 0, 5, COUNT) + np.arange(COUNT).astype(">u4").tobytes()
    stc += struct.pack(">I", 3) + on_file.astype(">f4").tobytes()
    frames = struct.pack(">7i256x", 1, COUNT, 1, 1, 3, 3, 0) + on_file.astype(">f4").tobytes()
    rows = "".join(f"p{k},{6 + k},{9 + k}\n" for k in range(4))
    table = (
        'name,mesh,source,target,alpha\none,m.off,"gaussian:vertex=1,width=0.2",hks:time=1,0.1\n'
    )
    archive, matlab = io.BytesIO(), io.BytesIO()
    np.savez(archive, frames=on_file, times=np.arange(3.0))
    scipy.io.savemat(matlab, {"thickness": X})
    quads = np.stack([*WHOLE.faces[:, :2].T, *WHOLE.faces[:, 1:].T], axis=1)
    return {
        "film.npy": ("frames", _npy(on_file)),
        "film.npz": ("frames", archive.getvalue()),
        "film.csv": ("frames", _text(on_file.T, ",")),
        "film.gii": ("frames", _gifti(list(on_file))),
        "film.mgz": ("frames", gzip.compress(frames, mtime=0)),
        "film-lh.stc": ("frames", stc),
        "keys.label.gii": (
            "labels",
            _gifti([np.arange(COUNT) % 2], labels={0: "a", 1: "b"}),
        ),
        "rh.annot": ("labels", _labels()["lh.annot"]),
        "table.csv": ("table", table.encode()),
        "landmarks.csv": ("landmarks", f"name,a,b\n{rows}".encode()),
        "quads.white": (
            "info",
            b"\xff\xff\xfd"
            + len(WHOLE.vertices).to_bytes(3, "big")
            + len(quads).to_bytes(3, "big")
            + WHOLE.vertices.astype(">f4").tobytes()
            + b"".join(int(k).to_bytes(3, "big") for k in quads.ravel()),
        ),
        "legacy.vtk": ("mesh", _legacy_vtk().encode()),
        "mesh.vtp": ("info", vtk_bytes(WHOLE.vertices, {"u": X[:42]}, "base64", kind="PolyData")),
        "civet.obj": ("mesh", _mni_obj().encode()),
        "values.mat": ("info", matlab.getvalue()),
        "values.dscalar.nii": ("info", _cifti()),
    }


def _legacy_vtk():
    points = "\n".join(" ".join(map(repr, row)) for row in WHOLE.vertices.tolist())
    faces = "\n".join("3 " + " ".join(map(str, row)) for row in WHOLE.faces.tolist())
    count = len(WHOLE.faces)
    head = (
        f"# vtk DataFile Version 3.0\nball\nASCII\nDATASET POLYDATA\nPOINTS 42 double\n{points}\n"
    )
    return f"{head}POLYGONS {count} {4 * count}\n{faces}\n"


def _mni_obj():
    points = "\n".join(" ".join(f"{x:.6f}" for x in row) for row in WHOLE.vertices.tolist())
    count = len(WHOLE.faces)
    ends = " ".join(str(3 * k) for k in range(1, count + 1))
    corners = " ".join(map(str, WHOLE.faces.ravel().tolist()))
    colour = "0 1 1 1 1"
    return (
        f"P 0.3 0.3 0.4 10 1 42\n{points}\n\n{points}\n\n{count}\n{colour}\n\n{ends}\n\n{corners}\n"
    )


def _cifti():
    axis = nibabel.cifti2.BrainModelAxis.from_surface(np.arange(42), 42, "CortexLeft")
    scalars = nibabel.cifti2.ScalarAxis(["thickness"])
    image = nibabel.Cifti2Image(X[None, :42].astype(np.float32), header=(scalars, axis))
    return image.to_bytes()


def _lists_of_frames():
    values = MESH.on_file(np.stack([X, Y], axis=1), 0.0)
    points = MESH.on_file(MESH.vertices, 9.0)
    beside = {
        f"wave_{k}.vtu": vtk_bytes(points, {"u": values[:, k]}, form, packed, time=float(k))
        for k, (form, packed) in enumerate([("raw", "vtkZLibDataCompressor"), ("ascii", "")])
    }
    rows = "".join(f'<DataSet timestep="{k}" file="wave_{k}.vtu"/>' for k in range(2))
    listed = f'<VTKFile type="Collection"><Collection>{rows}</Collection></VTKFile>'
    files = [{"name": name, "time": k} for k, name in enumerate(beside)]
    others = dict(beside)
    own = others.pop("wave_1.vtu")
    return [
        Specimen("waves.pvd", "frames", listed.encode(), beside),
        Specimen("waves.vtu.series", "info", json.dumps({"files": files}).encode(), beside),
        Specimen("wave_1.vtu", "frames", own, others),
    ]


def _subjects():
    rows = "".join(f"s{k},m{k}.off,f{k}.npy\n" for k in range(3))
    beside = {f"m{k}.off": off_text(WHOLE.vertices, WHOLE.faces).encode() for k in range(3)}
    beside |= {f"f{k}.npy": _npy(X[:42]) for k in range(3)}
    return Specimen("subjects.csv", "subjects", f"name,mesh,thickness\n{rows}".encode(), beside)


def _batch():
    """Return files of a folder of results of two rows, one of which failed."""
    with TemporaryDirectory() as place:
        folder = Path(place)
        off_file(folder / "m.off", WHOLE)
        options = {"mesh": "m.off", "source": "coordinate:x", "target": "coordinate:y"}
        rows = [Row("one", options | {"iterations": 3}, folder), Row("two", options, folder)]
        ledger = Ledger(folder / "out")
        ledger.make()
        ledger.write_rows(rows, "a table")
        found = rows[0].solve()
        found.save(ledger.result(rows[0].digest))
        ledger.record(rows[0], Record(rows[0].digest, seconds=1.5))
        ledger.record(rows[1], Record(reason="no reason"))
        files = {
            path.relative_to(folder).as_posix(): path.read_bytes()
            for path in (folder / "out").rglob("*")
            if path.is_file()
        }
    names = [name for name in files if not name.endswith("identity")]
    return [
        Specimen(name, "batch", files[name], {k: v for k, v in files.items() if k != name})
        for name in names
    ]
