"""Small valid files of every kind that abfm reads, each with its reader.

A format is added by a line of `_written`, with a function that writes a small file.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache, partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import scipy.io

from abfm.batch import Ledger, Row
from abfm.batch.ledger import Record
from abfm.io import write_labels, write_stc, write_values
from abfm.reading import Labels
from abfm.tasks import Monitor
from abfm_viewer.document.document import Channel, Surface
from abfm_viewer.document.kinds import MatchDocument
from abfm_viewer.files.project import Origin, save_project
from tests.core.reading.test_vtk_grids import FORMS, legacy
from tests.core.reading.vtk_files import vtk_bytes
from tests.mesh_writers import STL_WRITERS, WRITERS, exported, mni_obj, off_file
from tests.shapes import icosphere, with_loose_vertex
from tests.viewer.files.test_project import DOCUMENT, KNOWN, RESULT

SPHERE = icosphere(1)
MESH = with_loose_vertex(SPHERE)
COUNT = MESH.file_vertex_count
X, Y = MESH.vertices[:, 0].copy(), MESH.vertices[:, 1].copy()
_ON_FILE = np.stack([np.arange(COUNT) / 3, -np.arange(COUNT) / 7, np.arange(COUNT) ** 2.0], axis=1)
# functions as text, which users type and projects contain
_SPECS = (
    "gaussian:vertex=17,width=0.35,height=-2.5 + gaussian:x=0.5,y=1,z=-1",
    "coordinate:x + (expression:x**2*sin(3*y) - sqrt(abs(z))) + shape-diameter",
    *("eigenfunction:3", "geodesic:vertex=4", "indicator:axis=x,above=0.25", "curvature:mean"),
    *("wks:energy=0.5", "hks:time=0.5", "permuted:mirror(coordinate:y + coordinate:z)"),
)


_VTK_FORMS = (("raw", "vtkZLibDataCompressor"), ("ascii", ""), ("base64", ""))


@dataclass(frozen=True)
class Specimen:
    """A file, its reader, and other files that it needs in the same folder."""

    name: str
    reader: str
    content: bytes
    companions: Mapping[str, bytes] = field(default_factory=dict)


@cache
def specimens():
    meshes = {name: write(SPHERE.vertices, SPHERE.faces) for name, (write, _) in WRITERS.items()}
    meshes |= {n: exported(SPHERE.vertices, SPHERE.faces, kind) for n, kind in STL_WRITERS.items()}
    meshes |= {f"legacy-{n}.vtk": legacy(*form) for n, form in enumerate(FORMS)}
    meshes["civet.obj"] = mni_obj(SPHERE).encode()
    preferences = {"theme": "dark", "ui_scale": 1.25, "follow": True, "flow_after_match": False}
    recent = ["/nowhere/a.abfm", "recent.json", "b.off"]
    found = [
        *(Specimen(name, "mesh", content) for name, content in meshes.items()),
        *(Specimen(f"{k}.spec", "spec", spec.encode()) for k, spec in enumerate(_SPECS)),
        Specimen("preferences.json", "state", json.dumps(preferences, indent=1).encode()),
        Specimen("recent.json", "state", json.dumps(recent).encode()),
        *_written(),
        *_waves(),
        *_batch(),
    ]
    return {specimen.name: specimen for specimen in found}


def _written():
    """Return files of the writers of abfm and of other libraries."""
    keys, used = np.arange(COUNT) % 3, np.delete(np.arange(COUNT), 5)
    mirrored = np.arange(COUNT)
    mirrored[used] = used[::-1]
    labels = Labels(keys, {0: "a", 1: "b", 2: "c"}, {k: (0.5, 0.25, k / 2, 1) for k in range(3)})
    plain = MatchDocument(
        (Surface(MESH, "a ball"),), (Channel("gaussian:vertex=7", "coordinate:y"),)
    )
    origin = Origin(Path("/nowhere/rich.abfm"), 1, 2)
    one, three = _ON_FILE[:, 0], _ON_FILE
    writers = {
        "values.npy": ("values", partial(write_values, values=one)),
        "two.npy": ("values", partial(write_values, values=three)),
        "values.csv": ("values", partial(write_values, values=three, names=["a", "b", "c"])),
        "values.txt": ("values", partial(write_values, values=one)),
        "values.shape.gii": ("values", partial(write_values, values=one)),
        "values.gii.gz": ("values", partial(write_values, values=one)),
        "lh.sulc": ("values", partial(write_values, values=one)),
        "lh.mgz": ("values", partial(write_values, values=one)),
        "a.dscalar.nii": ("values", partial(write_values, values=one, structure="CortexLeft")),
        "values.mat": ("values", lambda path: scipy.io.savemat(path, {"thickness": one})),
        "a.label.gii": ("labels", partial(write_labels, labels=labels)),
        "lh.annot": ("labels", partial(write_labels, labels=labels)),
        "map.npy": ("map", lambda path: np.save(path, mirrored)),
        "map.txt": ("map", lambda path: np.savetxt(path, mirrored, "%d")),
        "map.vts": ("map", lambda path: np.savetxt(path, mirrored + 1, "%d")),
        "pairs.csv": ("map", lambda path: np.savetxt(path, np.stack([used, used], 1), "%d", ",")),
        "frames.npy": ("frames", lambda path: np.save(path, three.T)),
        "frames.npz": ("frames", lambda path: np.savez(path, frames=three.T, times=np.arange(3))),
        "frames.csv": ("frames", partial(write_values, values=three)),
        "frames.func.gii": ("frames", partial(write_values, values=three)),
        "frames.mgz": ("frames", partial(write_values, values=three)),
        "wave-lh.stc": ("frames", lambda p: write_stc(p, three.T, np.arange(COUNT), np.arange(3))),
        "table.csv": ("table", lambda path: path.write_text(_TABLE)),
        "landmarks.csv": ("landmarks", lambda path: path.write_text("name,a,b\np,6,9\nq,7,10\n")),
        "plain.abfm": ("project", lambda path: save_project(path, plain, {})),
        "rich.abfm": ("project", lambda path: save_project(path, DOCUMENT, KNOWN)),
        "autosave-1.abfm": ("project", lambda path: save_project(path, DOCUMENT, KNOWN, origin)),
        "result.npz": ("result", RESULT.save),
    }
    with TemporaryDirectory() as place:
        for name, (reader, write) in writers.items():
            write(Path(place, name))
            yield Specimen(name, reader, Path(place, name).read_bytes())


_TABLE = "name,mesh,source,target,alpha\none,m.off,coordinate:x,hks:time=1,0.1\n"


def _waves():
    """Return lists of frames in files of VTK."""
    points = MESH.on_file(MESH.vertices, 9.0)
    companions = {
        f"wave_{k}.vtu": vtk_bytes(points, {"u": _ON_FILE[:, k]}, form, packed, time=float(k))
        for k, (form, packed) in enumerate(_VTK_FORMS)
    }
    rows = "".join(f'<DataSet timestep="{k}" file="wave_{k}.vtu"/>' for k in range(3))
    listed = f'<VTKFile type="Collection"><Collection>{rows}</Collection></VTKFile>'
    series = {"files": [{"name": name, "time": k} for k, name in enumerate(companions)]}
    return [
        Specimen("waves.pvd", "frames", listed.encode(), companions),
        Specimen("waves.vtu.series", "frames", json.dumps(series).encode(), companions),
        *(Specimen(name, "frames", companions[name], companions) for name in companions),
    ]


def _batch():
    """Return files of a folder with two rows, one of which failed, and of subjects."""
    with TemporaryDirectory() as place:
        folder = Path(place)
        off_file(folder / "m.off", SPHERE)
        np.save(folder / "f.npy", X[:42])
        subjects = "name,surface,thickness\n" + "".join(f"s{k},m.off,f.npy\n" for k in range(3))
        options = {"mesh": "m.off", "source": "coordinate:x", "target": "coordinate:y"}
        rows = [Row("one", options | {"iterations": 3}, folder), Row("two", options, folder)]
        ledger = Ledger(folder / "out")
        ledger.make()
        ledger.write_rows(rows, "a table")
        rows[0].task().solve(Monitor()).save(ledger.result_path(rows[0].digest))
        ledger.record(rows[0], Record(rows[0].digest, seconds=1.5))
        ledger.record(rows[1], Record(reason="no reason"))
        files = {
            path.relative_to(folder).as_posix(): path.read_bytes()
            for path in folder.rglob("*")
            if path.is_file()
        }
    own = [name for name in files if name.startswith("out/") and not name.endswith("identity")]
    return [
        Specimen("subjects.csv", "subjects", subjects.encode(), files),
        *(
            Specimen(name, "batch", files[name], {k: v for k, v in files.items() if k != name})
            for name in own
        ),
    ]
