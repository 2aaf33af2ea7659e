"""The sample of a population: subjects made by known flows from a bundled mesh, one an outlier."""

from __future__ import annotations

import math
import os
from contextlib import closing
from pathlib import Path

import numpy as np

from abfm import Flow, TriangleMesh, load_mesh, register_population
from abfm.assets import asset_path
from abfm.batch import Cluster
from abfm.functions import quoted
from abfm.population import Channel, Cohort, Settings, Subject
from abfm.types import FloatArray
from abfm.workers.worker import Worker, no_state

NAME = "population.npz"  # name of the file of the population
MESH = "human_A.off"
SUBJECTS = 8
OUTLIER_NAME = "subject 5, outlier"
_DISPLACEMENT = 0.06  # root mean square of the fields, in sqrt(area)
_NOISE = 0.05  # standard deviation of the noise of the values
_WAVES = 6  # in each field
_WAVE_NUMBER_MAX = 2.0  # waves per sqrt(area)
_OPTIONS = {  # options for a result within seconds, not for the best map
    "refine": 0,
    "iterations": 20,
    "sigma": 0.1,
    "cooling-stages": 1,
    "max-displacement": 0.2,
}
_ENDED_MESSAGE = "the population was not computed, because its process ended; try again"


def function(mesh: TriangleMesh) -> FloatArray:
    """Return the function on the template, (V,): bands along and across the body."""
    x, y, z = (mesh.vertices / mesh.length_scale).T
    return np.asarray(np.sin(5 * y + 1) + 0.7 * np.sin(6 * x) + 0.5 * np.cos(7 * z + 2 * y))


def fields(mesh: TriangleMesh, count: int) -> FloatArray:
    """Return N smooth tangent fields (N, F, 3), sums of waves, whose mean over the N is zero."""
    rng = np.random.default_rng(5)
    corners = mesh.vertices[mesh.faces] / mesh.length_scale
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    areas = np.linalg.norm(normals, axis=1) / 2
    normals /= 2 * areas[:, None]
    found = np.zeros((count, len(corners), 3))
    for field in found:
        for _ in range(_WAVES):
            along, towards = rng.normal(size=(2, 3))
            along *= rng.uniform(0.5, _WAVE_NUMBER_MAX) / np.linalg.norm(along)
            phases = 2 * np.pi * (corners.mean(axis=1) @ along + rng.uniform())
            field += np.cos(phases)[:, None] * towards
        field -= (field * normals).sum(axis=1)[:, None] * normals
    found -= found.mean(axis=0)
    mean_square = ((found**2).sum(axis=2) @ areas).mean() / areas.sum()
    return np.asarray(found * (_DISPLACEMENT * mesh.length_scale / math.sqrt(mean_square)))


def made_in_subprocess(folder: Path) -> Path:
    """Return the folder of the sample population; if it is missing, compute it in a subprocess."""
    if (folder / NAME).is_file():
        return folder
    with closing(Worker(no_state, _ENDED_MESSAGE)) as worker:
        return worker.call(_made, os.fspath(folder)).result()


def _made(_: None, folder: str) -> Path:
    Path(folder).mkdir(parents=True, exist_ok=True)
    path, mesh = asset_path(MESH), load_mesh(asset_path(MESH))
    template, rng = function(mesh), np.random.default_rng(6)
    values = [
        Flow(mesh, field).point_map().pull_back(template) + _NOISE * rng.normal(size=len(template))
        for field in fields(mesh, SUBJECTS)
    ]
    names = [f"subject {number}" for number in range(1, SUBJECTS + 2)]
    names[4] = OUTLIER_NAME
    values.insert(4, -values[4])  # the outlier has the opposite sign
    subjects = []
    for name, each in zip(names, values, strict=True):
        subjects.append(Subject(name, (_written(Path(folder, f"{name}.npy"), each),)))
    target = _written(Path(folder, "template.npy"), template)
    found = register_population(
        Cohort((Channel("bands"),), tuple(subjects)),
        path,
        folder,
        Settings({"bands": target}, options=_OPTIONS, rounds=1),
        Cluster(jobs=1),
    )
    found.save(Path(folder, NAME))
    return Path(folder)


def _written(path: Path, values: FloatArray) -> str:
    np.save(path, values)
    return f"file:{quoted(os.fspath(path))}"
