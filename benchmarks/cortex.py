"""Registrations of the cortex of a subject, compared with the map of FreeSurfer.

    python -m benchmarks.cortex --subject sub-001 --labels lh.aparc.annot --write docs/cortex.md

The template is nilearn's fsaverage5, with labels of the same parcellation. The subject is a folder
of FreeSurfer, left hemisphere.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np

from abfm import Correspondence, Parameters, TriangleMesh, load_mesh, register
from abfm.functions import read_column, read_labels
from abfm.maps.spherical import sphere_directions
from abfm.registration import MEASURED_PARAMETERS
from abfm.registration.initial import initial_map
from abfm.registration.initial.map_input import MapInput
from abfm.types import BoolArray, FloatArray
from benchmarks.common import Cells, Table, decimals, fsaverage5, main

HEADINGS = (
    "",
    "depth",
    "curvature",
    "Dice",
    "mean abs. log₂ J",
    "95%",
    "98%",
    "mean log₂ R",
    "95%",
    "folded",
    "round trip (edges)",
    "CPU s",
)

_NORMS: tuple[dict[str, Any], ...] = (
    {},
    {"divergence": 1.0},
    {"alpha": 0.1},
    {"alpha": 0.01},
    {"order": 2, "alpha": 0.01, "sigma": 1.5},
    {"order": 2, "alpha": 0.01, "sigma": 2.0, "divergence": 1.0},
    {"order": 2, "alpha": 0.003, "sigma": 3.0, "divergence": 1.0},
)
_BOUNDS = (1.5, 1.0, 0.6)
_LABELS_OUTSIDE_CORTEX = ("unknown", "corpuscallosum", "medial_wall", "medialwall", "???")
_STEPS_SHOWN = 5


@dataclass(frozen=True, eq=False)
class Hemisphere:
    """A hemisphere of the cortex: its sphere, its surface, and functions on their vertices."""

    sphere: TriangleMesh
    surface: TriangleMesh
    depth: FloatArray
    curvature: FloatArray
    thickness: FloatArray
    labels: tuple[str, ...] = ()

    @property
    def cortex(self) -> BoolArray:
        return np.asarray(self.thickness > 0)


def read_subject(folder: Path) -> Hemisphere:
    def path(name: str) -> Path:
        return next(path for path in sorted(folder.rglob(f"lh.{name}")))

    sphere, surface = load_mesh(path("sphere")), load_mesh(path("smoothwm"))
    depth, curvature = (read_column(path(name)) for name in ("sulc", "curv"))
    labels = label_names(path("aparc.annot"))
    return Hemisphere(sphere, surface, depth, curvature, np.ones_like(depth), labels)


def read_template(side: str, labels: Path | None = None) -> Hemisphere:
    """Read a hemisphere of fsaverage5, with labels from a file."""
    folder = fsaverage5()
    sphere, surface = (load_mesh(folder / f"{name}_{side}.gii.gz") for name in ("sphere", "white"))
    depth, curvature, thickness = (
        read_column(folder / f"{name}_{side}.gii.gz") for name in ("sulc", "curv", "thick")
    )
    names = label_names(labels) if labels else ()
    return Hemisphere(sphere, surface, depth, curvature, thickness, names)


def label_names(path: Path) -> tuple[str, ...]:
    found = read_labels(str(path))
    return tuple(found.names.get(int(key), "unknown") for key in found.values)


@dataclass(frozen=True)
class Evaluation:
    """Measures of maps from a subject A to a template B, on the cortex of B."""

    a: Hemisphere
    b: Hemisphere
    cortex: BoolArray

    def row(self, name: str, found: Correspondence, seconds: float | None = None) -> list[str]:
        distortion = found.distortion()
        area, shape = distortion.log2_area, distortion.log2_shape
        numbers = [
            self.correlation(found.transfer(self.a.depth), self.b.depth),
            self.correlation(found.transfer(self.a.curvature), self.b.curvature),
            self.dice(found),
            area.mean,
            area.p95,
            area.p98,
            shape.mean,
            shape.p95,
        ]
        return [
            name,
            *(decimals(number, ".3f", "") for number in numbers),
            str(distortion.folded),
            f"{found.round_trip().median:.1g}",
            decimals(seconds, ".0f", ""),
        ]

    def timed_row(self, name: str, find: Callable[[], Correspondence]) -> list[str]:
        """Compute a map by ``find``, and return its row of the table with the processor time."""
        start = process_time()
        found = find()
        return self.row(name, found, process_time() - start)

    def correlation(self, one: FloatArray, other: FloatArray) -> float:
        known = self.cortex & np.isfinite(one) & np.isfinite(other)
        return float(np.corrcoef(one[known], other[known])[0, 1])

    def dice(self, found: Correspondence) -> float:
        """Return the mean Dice coefficient of the labels of the cortex of B; NaN without labels."""
        names = sorted({*self.a.labels, *self.b.labels})
        if not (self.a.labels and self.b.labels):
            return float("nan")
        b_labels, a_labels = (np.searchsorted(names, side.labels) for side in (self.b, self.a))
        transferred = found.transfer_labels(a_labels)
        values = []
        for index, name in enumerate(names):
            one, other = (b_labels == index) & self.cortex, (transferred == index) & self.cortex
            if name.lower() not in _LABELS_OUTSIDE_CORTEX and one.any():
                values.append(2 * (one & other).sum() / (one.sum() + other.sum()))
        return float(np.mean(values))


def through_sphere(registered: TriangleMesh, a: TriangleMesh, b: TriangleMesh) -> Correspondence:
    """Return the map from A to B that a registration by another program defines.

    ``registered`` is the sphere of A after its registration to the sphere of B.
    """
    return Correspondence.through_sphere(a, b, sphere_directions(registered), sphere_directions(b))


def subject_rows(
    subject: Hemisphere, template: Hemisphere, registered: TriangleMesh
) -> Iterator[Cells]:
    """Yield a row for each registration of the subject to the template, on spheres or surfaces."""
    cortex = template.cortex
    evaluation = Evaluation(subject, template, cortex)
    a, b, f, g = subject.sphere, template.sphere, subject.depth, template.depth
    freesurfer_map = through_sphere(registered, a, b)
    yield evaluation.row("FreeSurfer, `sphere.reg`", freesurfer_map)
    given = MapInput(a, b, f[None], g[None], None, cortex.astype(np.float64))
    rotation = initial_map("sphere", given).correspondence
    yield evaluation.row("rotation of the sphere only", rotation)
    on_sphere: Callable[..., Correspondence] = partial(register, a, b, f, g)
    for name, mask in masks(template).items():
        yield evaluation.timed_row(f"`register`, {name}", partial(on_sphere, mask_b=mask))
    on_sphere = partial(on_sphere, mask_b=cortex)
    both = [np.stack([side.depth, side.curvature], 1) for side in (subject, template)]
    cases: dict[str, Callable[[], Correspondence]] = {
        "`register` with the parameters of `match`": partial(on_sphere, parameters=Parameters()),
        **{
            f"`register(max_distortion={bound:g})`": partial(on_sphere, max_distortion=bound)
            for bound in _BOUNDS
        },
        "`register` by depth and curvature": partial(register, a, b, *both, mask_b=cortex),
    }
    for name, find in cases.items():
        yield evaluation.timed_row(name, find)
    a, b = subject.surface, template.surface
    embedded = initial_map("embedding", given._replace(a=a, b=b)).correspondence
    yield evaluation.row("computed spheres (`embedding`), rotated", embedded)
    on_surface = partial(register, a, b, f, g, initial="embedding", mask_b=cortex)
    back = partial(register, b, a, g, f, initial="embedding", mask_a=cortex)
    size, on_white = f"{len(a.vertices):,} vertices", '`register(initial="embedding")`'
    cases = {
        f"{on_white}, white surfaces": on_surface,
        '`register(initial="embedding", max_distortion=2)`, white surfaces': partial(
            on_surface, max_distortion=2
        ),
        f"inverse of {on_white} from template to subject ({size})": lambda: back().inverse(),
    }
    for name, find in cases.items():
        yield evaluation.timed_row(name, find)


def masks(template: Hemisphere) -> dict[str, BoolArray | None]:
    """Return masks of the template's cortex by name; None for a run without a mask."""
    found: dict[str, BoolArray | None] = {"mask thickness > 0": template.cortex}
    if template.labels:
        names = np.char.lower(np.array(template.labels))
        found["mask from labels"] = ~np.isin(names, _LABELS_OUTSIDE_CORTEX)
    return {**found, "no mask": None}


def score_rows(subject: Hemisphere, template: Hemisphere) -> Iterator[Cells]:
    """Yield a row for each mask: scores of the last steps, the selected one in bold."""
    for name, mask in masks(template).items():
        found = register(
            subject.sphere, template.sphere, subject.depth, template.depth, mask_b=mask
        ).match
        scores = [f"{step.sigma:.3g}: {step.score:.4f}" for step in found.path]
        scores[found.step] = f"**{scores[found.step]}**"
        yield [name, *[*_STEPS_SHOWN * ("",), *scores][-_STEPS_SHOWN:]]


def norm_rows(subject: Hemisphere, template: Hemisphere) -> Iterator[Cells]:
    """Yield a row for each norm of fields with which the subject is registered."""
    evaluation = Evaluation(subject, template, template.cortex)
    for changes in _NORMS:
        found = register(
            subject.sphere,
            template.sphere,
            subject.depth,
            template.depth,
            mask_b=template.cortex,
            parameters=MEASURED_PARAMETERS.with_values(**changes),
        )
        p = found.match.parameters
        norm = f"order {p.solver.order}, α = {p.alpha:g}, divergence {p.divergence:g}"
        sigma = f"{found.match.path[found.match.step].sigma:.2g}"
        given = "" if p.sigma is None else " (given)"
        yield evaluation.row(f"{norm}, σ = {sigma}{given}", found)[:-1]


def side_rows(left: Hemisphere, right: Hemisphere) -> Iterator[Cells]:
    """Yield a row for each map from the mirrored right hemisphere to the left hemisphere."""
    evaluation = Evaluation(right, left, left.cortex)
    f, g = right.depth[None], left.depth[None]
    weights_a, weights_b = (side.cortex.astype(np.float64) for side in (right, left))
    given = MapInput(right.sphere, left.sphere, f, g, weights_a, weights_b)
    yield evaluation.row("rotation only", initial_map("sphere:mirror", given).correspondence)
    find = partial(
        register,
        *(right.sphere, left.sphere, right.depth, left.depth),
        initial="sphere:mirror",
        mask_a=right.cortex,
        mask_b=left.cortex,
    )
    yield evaluation.timed_row("`register`", find)


def tables(arguments: argparse.Namespace) -> Mapping[str, Table]:
    subject, left = read_subject(arguments.subject), read_template("left", arguments.labels)
    registered = load_mesh(next(iter(sorted(arguments.subject.rglob("lh.sphere.reg")))))
    return {
        "subject": Table(HEADINGS, subject_rows(subject, left, registered)),
        "scores": Table(("", *_STEPS_SHOWN * ("σ: score",)), score_rows(subject, left)),
        "norms": Table(HEADINGS[:-1], norm_rows(subject, left)),
        "sides": Table(HEADINGS, side_rows(left, read_template("right"))),
    }


if __name__ == "__main__":
    main(
        __doc__,
        tables,
        required={"subject": "folder of a subject in FreeSurfer"},
        labels="labels of the template",
    )
