"""A population with known fields: subjects made from a sulcal depth, and their mean."""

from pathlib import Path

import numpy as np
from PIL.Image import Image
from scipy import sparse
from scipy.spatial import ConvexHull

import abfm
from abfm.batch import Cluster
from abfm.calculus import face_areas, vertex_areas
from abfm.io.sheets import Panel, Sheet, Values
from abfm.population import Channel, Cohort, Settings, Subject
from abfm.types import FloatArray
from abfm_viewer.pictures import figure_picture
from abfm_viewer.window.wave import fsaverage5

_SUBJECTS = 20
_NOISE = 0.1  # relative to the standard deviation of the depth
_VERTICES = 2562  # of the icosphere whose subdivision is the sphere of fsaverage5
_SMOOTHINGS = 4  # number of smoothings, so that the coarse mesh resolves the depth
_DISPLACEMENT = 0.05  # root mean square of the fields, in sqrt(area)
_WAVES = 12  # gradients in a field, and as many rotated ones
_WAVE_NUMBER_MAX = 4.0  # on the unit sphere


def picture(folder: Path) -> Image:
    """Register the subjects, and return a picture of the template, a subject and both means."""
    mesh, depth = _template()
    random = np.random.default_rng(1)
    values = [
        abfm.Flow(mesh, field).point_map().pull_back(depth) + _NOISE * random.normal(size=_VERTICES)
        for field in _fields(mesh)
    ]
    subjects = []
    for number, each in enumerate(values, 1):
        np.save(folder / f"{number:02}.npy", each)
        subjects.append(Subject(f"subject {number:02}", (f"file:{folder}/{number:02}.npy",)))
    np.save(folder / "depth.npy", depth)
    cohort = Cohort((Channel("depth"),), tuple(subjects))
    settings = Settings(functions={"depth": f"file:{folder}/depth.npy"})
    found = abfm.register_population(cohort, mesh, folder / "results", settings, Cluster(jobs=1))
    shown = {
        "template": depth,
        "subject 1": values[0],
        "plain mean": np.mean(values, axis=0),
        "registered mean": found.mean(),
    }
    panels = [Panel(mesh, Values(each, "sulcal depth"), name) for name, each in shown.items()]
    deviation = Values(found.deviation(), "standard deviation")
    panels.append(Panel(mesh, deviation, "standard deviation"))
    return figure_picture(Sheet((tuple(panels),), view_functions=(depth,)))


def _template() -> tuple[abfm.TriangleMesh, FloatArray]:
    """Return the coarse sphere of the template, and its smoothed depth, of standard deviation 1."""
    surfaces = fsaverage5()
    fine = abfm.load_mesh(surfaces / "sphere_left.gii.gz")
    depth = abfm.function(fine, f"file:{surfaces / 'sulc_left.gii.gz'}")[:_VERTICES]
    places = fine.vertices[:_VERTICES]
    faces = ConvexHull(places).simplices
    corners = places[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    inward = np.einsum("fx,fx->f", normals, corners.mean(axis=1)) < 0
    faces[inward] = faces[inward, ::-1]
    mesh = abfm.TriangleMesh(places, faces)
    (i, j), shape = mesh.edges.T, (_VERTICES, _VERTICES)
    adjacent = sparse.csr_array((np.ones(2 * len(i)), (np.r_[i, j], np.r_[j, i])), shape)
    for _ in range(_SMOOTHINGS):
        depth = 0.5 * (depth + (adjacent @ depth) / adjacent.sum(axis=1))
    areas = vertex_areas(mesh)
    depth = depth - np.average(depth, weights=areas)
    return mesh, depth / np.sqrt(np.average(depth**2, weights=areas))


def _fields(mesh: abfm.TriangleMesh) -> FloatArray:
    """Return smooth random fields (N, F, 3), sums of waves, whose mean over the fields is zero."""
    random = np.random.default_rng(0)
    centres = mesh.vertices[mesh.faces].mean(axis=1)
    centres /= np.linalg.norm(centres, axis=1)[:, None]
    fields = np.zeros((_SUBJECTS, len(centres), 3))
    for field in fields:
        for number in range(2 * _WAVES):
            along = random.normal(size=3)
            along /= np.linalg.norm(along)
            frequency, phase = random.uniform(1, _WAVE_NUMBER_MAX), random.uniform(0, 2 * np.pi)
            waves = np.cos(frequency * (centres @ along) + phase)[:, None] * along
            waves *= random.normal()
            waves -= (waves * centres).sum(axis=1)[:, None] * centres
            field += np.cross(centres, waves) if number % 2 else waves
    fields -= fields.mean(axis=0)
    areas = face_areas(mesh)
    mean_square = ((fields**2).sum(axis=2) @ areas).mean() / areas.sum()
    return fields * (_DISPLACEMENT * mesh.length_scale / np.sqrt(mean_square))
