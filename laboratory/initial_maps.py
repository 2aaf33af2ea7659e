"""Initial maps without landmarks and by five of them, beside each candidate and pyFM's quickstart.

Errors are mean geodesic distances to the truth over the square root of the area; every map is
rated by its continuous form, as `register` takes it.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from importlib import import_module
from importlib.util import find_spec
from itertools import chain
from pathlib import Path
from time import process_time
from typing import NamedTuple

import numpy as np

from abfm import AbfmError, function
from abfm.maps import PointMap
from abfm.registration.initial import initial_map
from abfm.registration.initial.given import Given
from laboratory.shape_pairs import PEOPLE, ShapePair, animals, people

CANDIDATES = ("spectral", "extremities", "embedding", "closest")
HEADS = (
    "pair",
    "kind",
    "default",
    "chosen",
    "runner-up",
    *CANDIDATES,
    "5 landmarks",
    "pyFM",
    "collapsed",
    "flipped",
    "CPU s",
)
_PAIRS_OF_PEOPLE = 15
_ALIKE = "hks"
_CLOSE = 1.2  # of the error of the best candidate, up to which a choice is as good


class Row(NamedTuple):
    """Results of one pair: errors of the default, of each candidate, by landmarks and of pyFM, NaN
    where there is no such map; collapsed and flipped faces and CPU seconds of the default.
    """

    name: str
    kind: str
    ranked: tuple[str, str]  # the chosen candidate and the runner-up
    errors: tuple[float, ...]
    counts: tuple[float, ...]

    def cells(self) -> list[str]:
        default, *others = (f"{error:.4f}" if np.isfinite(error) else "–" for error in self.errors)
        return [
            *(self.name, self.kind, default, *self.ranked, *others),
            *(f"{count:.0f}" for count in self.counts),
        ]

    @property
    def is_close(self) -> bool:
        """Whether the default is about as good as the best candidate."""
        return self.errors[0] <= _CLOSE * float(np.nanmin(self.errors[1 : 1 + len(CANDIDATES)]))


def rows(folder: Path) -> Iterator[list[str]]:
    """Yield a row a pair, then means and medians, and how often the choice is close to the best."""
    found = []
    for pair in chain(people(folder / PEOPLE, _PAIRS_OF_PEOPLE), animals(folder)):
        found.append(measured(pair))
        yield found[-1].cells()
    yield from summary(found)


def summary(found: list[Row]) -> Iterator[list[str]]:
    """Yield rows of means and medians over the pairs that have a map, and of close choices."""
    errors = np.array([row.errors for row in found])
    counts = np.array([row.counts for row in found])
    for name, of in (("mean", np.mean), ("median", np.median)):
        known = (column[np.isfinite(column)] for column in errors.T)
        of_errors = tuple(float(of(column)) if len(column) else np.nan for column in known)
        yield Row(name, "", ("", ""), of_errors, tuple(of(counts, axis=0))).cells()
    close = f"{sum(row.is_close for row in found)} of {len(found)}"
    yield [f"within {_CLOSE} of the best candidate", "", close, *[""] * (len(HEADS) - 3)]


def measured(pair: ShapePair) -> Row:
    """Return the results of the default, its candidates and pyFM."""
    f, g = (function(mesh, _ALIKE)[None] for mesh in (pair.a, pair.b))
    given = Given(pair.a, pair.b, f, g)
    began = process_time()
    first = initial_map(None, given)
    seconds = process_time() - began
    distortion = first.correspondence.distortion()
    ranked = [each.name for each in first.correspondence.candidates]  # the chosen one first
    by_landmarks = Given(pair.a, pair.b, landmarks=pair.landmarks)
    return Row(
        pair.name,
        pair.kind,
        (ranked[0], ranked[1] if len(ranked) > 1 else ""),
        (
            pair.error(first.correspondence.points),
            *(_error(pair, word, given) for word in CANDIDATES),
            _error(pair, None, by_landmarks),
            quickstart_error(pair),
        ),
        (float((distortion.area <= 0).sum()), float(distortion.flipped.sum()), seconds),
    )


def _error(pair: ShapePair, word: str | None, given: Given) -> float:
    with suppress(AbfmError):
        return pair.error(initial_map(word, given).correspondence.points)
    return np.nan


def quickstart_error(pair: ShapePair) -> float:
    """Return the error of pyFM's map by the quickstart of its README; NaN without ``pyfmaps``."""
    if find_spec("pyFM") is None:
        return np.nan
    functional, mesh = import_module("pyFM.functional"), import_module("pyFM.mesh")
    shapes = (
        mesh.TriMesh(each.vertices, each.faces, area_normalize=True, center=True)
        for each in (pair.a, pair.b)
    )
    model = functional.FunctionalMapping(*shapes)
    model.preprocess(descr_type="WKS", subsample_step=2)
    model.fit(K=30, w_descr=1e0, w_lap=1e-1, w_dcomm=1e0, w_orient=1e0)
    found = model.get_p2p(model.zoomout_refine(nit=16, step=5))
    return pair.error(PointMap.of_vertices(pair.b, pair.a, found))
