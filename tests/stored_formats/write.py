"""Write a file of each format: ``python -m tests.stored_formats.write FOLDER``.

Run it for each release that changes a format, with a new folder next to this program. The files of
earlier releases are never replaced.
"""

import sys
import tempfile
from pathlib import Path

import numpy as np

import abfm
from abfm.population import read_subjects, register_population
from abfm.registration.symmetric import SymmetricRegistration
from abfm_viewer.files.documents import read_document
from abfm_viewer.files.project import save_project
from tests.shapes import icosphere

RESULTS = {
    "match": abfm.Match,
    "problem": abfm.Problem,
    "registration": abfm.Registration,
    "correspondence": abfm.Correspondence,
    "symmetric": SymmetricRegistration,
    "sequence": abfm.Sequence,
    "population": abfm.Population,
}
"""Names of the result files, and the types that they contain."""
PROJECTS = ("match", "registration", "sequence")
"""Names of the projects, which are those of the results from which they are opened."""
_SUBJECTS = "surface,f\nmesh.off,expression:exp(x)\nmesh.off,expression:exp(0.95*x+0.3*y)\n"


def write(folder: Path) -> None:
    """Write all files into a folder, about 0.2 MB."""
    folder.mkdir(parents=True)
    mesh = icosphere(1)
    x, y, _ = mesh.vertices.T
    source, target = np.exp(x), np.exp(0.95 * x + 0.3 * y)
    match = abfm.match(mesh, source, target)
    registration = abfm.register(mesh, mesh, source, target)
    back = abfm.register(mesh, mesh, target, source)
    written = {
        "match": match,
        "problem": match.problem,
        "registration": registration,
        "correspondence": registration.initial,
        "symmetric": SymmetricRegistration.average(registration, back),
        "sequence": abfm.sequence(mesh, np.array([source, target, source])),
        "population": _population(mesh),
    }
    for name, found in written.items():
        found.save(folder / f"{name}.npz")
    for name in PROJECTS:
        save_project(folder / f"{name}.abfm", *read_document(folder / f"{name}.npz"))


def _population(mesh: abfm.TriangleMesh) -> abfm.Population:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "subjects.csv").write_text(_SUBJECTS, encoding="utf-8")
        lines = ["OFF", f"{len(mesh.vertices)} {len(mesh.faces)} 0"]
        lines += [" ".join(map(repr, vertex)) for vertex in mesh.vertices.tolist()]
        lines += [f"3 {a} {b} {c}" for a, b, c in mesh.faces.tolist()]
        (folder / "mesh.off").write_text("\n".join(lines), encoding="utf-8")
        return register_population(read_subjects(folder / "subjects.csv"), mesh, folder / "out")


if __name__ == "__main__":
    write(Path(sys.argv[1]))
