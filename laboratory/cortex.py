"""Measure registrations of cortices, next to the maps of FreeSurfer and of the HCP.

    python -m laboratory.cortex --subject sub-001 --template fsaverage5 [--labels lh.aparc.annot]
        [--conte69 FOLDER --published SPHERE.surf.gii] [--write docs/cortex.md]

The subject is a folder of FreeSurfer's (left hemisphere), the template nilearn's folder of
fsaverage5, with labels of the same parcellation; conte69 has its files as BrainSpace has them, and
the published sphere is the one that HCPpipelines has for fs_LR on fsaverage.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from time import process_time
from typing import Any, NamedTuple

import numpy as np

from abfm import Correspondence, Parameters, TriangleMesh, load_mesh, register
from abfm.functions import read_column, read_labels
from abfm.maps.spherical import sphere_directions
from abfm.registration import MEASURED, prepare
from abfm.registration.initial import initial_map
from abfm.registration.initial.given import Given
from abfm.types import BoolArray, FloatArray, IntArray
from laboratory import bounds
from laboratory.common import put_between, told_table

_HEADS = (
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
    "back (edges)",
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
_NO_CORTEX = ("unknown", "corpuscallosum", "medial_wall", "medialwall", "???")
_STEPS_SHOWN = 5
MARKS = ("<!-- table of laboratory.cortex -->", "<!-- end of the table -->")


class Side(NamedTuple):
    """A hemisphere: its sphere, and the surface itself; maps on its vertices."""

    sphere: TriangleMesh
    surface: TriangleMesh
    depth: FloatArray
    curvature: FloatArray
    thickness: FloatArray | None
    labels: tuple[str, ...] | None


@dataclass(frozen=True)
class Judge:
    """Measures a map from the vertices of a template to a subject."""

    a: Side
    b: Side
    cortex: BoolArray  # of B's vertices, on which it is measured

    def row(self, name: str, found: Correspondence, seconds: float | None = None) -> list[str]:
        distortion = found.distortion()
        area, shape = distortion.log2_area, distortion.log2_shape
        numbers = [
            self.alike(found.carry(self.a.depth), self.b.depth),
            self.alike(found.carry(self.a.curvature), self.b.curvature),
            self.dice(found),
            area.mean,
            area.p95,
            area.p98,
            shape.mean,
            shape.p95,
        ]
        cells = ["" if np.isnan(x) else f"{x:.3f}" for x in numbers]
        back = f"{found.there_and_back().median:.1g}"
        time = "" if seconds is None else f"{seconds:.0f}"
        return [name, *cells, str(distortion.folded), back, time]

    def alike(self, one: FloatArray, other: FloatArray) -> float:
        """Return the correlation of two maps on B."""
        known = self.cortex & np.isfinite(one) & np.isfinite(other)
        return float(np.corrcoef(one[known], other[known])[0, 1])

    def dice(self, found: Correspondence) -> float:
        """Return the mean over labels of the Dice coefficient."""
        if self.a.labels is None or self.b.labels is None:
            return float("nan")
        names = sorted({*self.a.labels, *self.b.labels})
        number = {name: index for index, name in enumerate(names)}
        own, other = (np.array([number[n] for n in x]) for x in (self.b.labels, self.a.labels))
        return _dice(own, found.carry_labels(other), self.cortex, number)


def _dice(own: IntArray, carried: IntArray, cortex: BoolArray, number: dict[str, int]) -> float:
    found = []
    for name, index in number.items():
        one, other = (own == index) & cortex, (carried == index) & cortex
        if name.lower() not in _NO_CORTEX and one.any():
            found.append(2 * (one & other).sum() / (one.sum() + other.sum()))
    return float(np.mean(found))


def read_subject(folder: Path) -> Side:
    """Read a subject of FreeSurfer's, the left hemisphere."""

    def place(name: str) -> Path:
        return next(path for path in sorted(folder.rglob(name)))

    depth, curvature = (read_column(place(f"lh.{n}")) for n in ("sulc", "curv"))
    sphere, surface = load_mesh(place("lh.sphere")), load_mesh(place("lh.smoothwm"))
    return Side(sphere, surface, depth, curvature, None, label_names(place("lh.aparc.annot")))


def read_template(folder: Path, side: str, labels: Path | None) -> Side:
    """Read a hemisphere of fsaverage5 as nilearn has it."""
    sphere, surface = (load_mesh(folder / f"{name}_{side}.gii.gz") for name in ("sphere", "white"))
    depth, curvature, thickness = (
        read_column(folder / f"{name}_{side}.gii.gz") for name in ("sulc", "curv", "thick")
    )
    return Side(
        sphere, surface, depth, curvature, thickness, label_names(labels) if labels else None
    )


def label_names(path: Path) -> tuple[str, ...]:
    """Return the name of each vertex' label."""
    found = read_labels(str(path))
    return tuple(found.names.get(int(key), "unknown") for key in found.values)


def subject_rows(subject: Side, template: Side, registered: TriangleMesh) -> Iterator[list[str]]:
    """Yield rows of the subject on the template: on spheres, and on the surfaces themselves."""
    cortex = _cortex(template)
    judge = Judge(subject, template, cortex)
    a, b, f, g = subject.sphere, template.sphere, subject.depth, template.depth
    theirs = Correspondence.through_sphere(
        a, b, sphere_directions(registered), sphere_directions(b)
    )
    yield judge.row("FreeSurfer, `sphere.reg`", theirs)
    given = Given(a, b, f[None], g[None], None, _weights(cortex))
    yield judge.row("rotation of the sphere only", initial_map("sphere", given).correspondence)

    def timed(name: str, find: Callable[[], Correspondence]) -> list[str]:
        start = process_time()
        found = find()
        return judge.row(name, found, process_time() - start)

    for name, mask in masks(template).items():
        yield timed(
            f"`register`, {name}",
            lambda mask=mask: register(a, b, f, g, mask_b=mask),  # type: ignore[misc]
        )
    yield timed(
        "the same with the parameters of `match`",
        lambda: register(a, b, f, g, mask_b=cortex, parameters=Parameters()),
    )
    for most in (1.5, 1.0, 0.6):
        yield timed(
            f"`register(max_distortion={most:g})`",
            lambda most=most: register(a, b, f, g, mask_b=cortex, max_distortion=most),  # type: ignore[misc]
        )
    both = [np.stack([side.depth, side.curvature], 1) for side in (subject, template)]
    yield timed("depth and curvature matched", lambda: register(a, b, *both, mask_b=cortex))
    a, b = subject.surface, template.surface
    given = given._replace(a=a, b=b)
    yield judge.row(
        "spheres made by ourselves, turned", initial_map("embedding", given).correspondence
    )
    yield timed(
        "`register` without spheres, on the template's white surface",
        lambda: register(a, b, f, g, initial="embedding", mask_b=cortex),
    )
    yield timed(
        "the same with `max_distortion=2`",
        lambda: register(a, b, f, g, initial="embedding", mask_b=cortex, max_distortion=2),
    )
    yield timed(
        f"on the subject's own surface, {len(a.vertices):,} vertices, back to the template",
        lambda: register(b, a, g, f, initial="embedding", mask_a=cortex).inverse(),
    )


def masks(template: Side) -> dict[str, BoolArray | None]:
    """Return masks of the cortex of a template by name, the one that is judged on first."""
    found: dict[str, BoolArray | None] = {"mask thickness > 0": _cortex(template)}
    if template.labels is not None:
        found["mask from labels"] = np.array(
            [name.lower() not in _NO_CORTEX for name in template.labels]
        )
    return found | {"no mask": None}


def choice_rows(subject: Side, template: Side) -> Iterator[list[str]]:
    """Yield the scores of the last steps with each mask; the chosen sigma is in bold."""
    for name, mask in masks(template).items():
        found = register(
            subject.sphere, template.sphere, subject.depth, template.depth, mask_b=mask
        ).match
        scores = [f"{step.sigma:.3g}: {step.score:.4f}" for step in found.path]
        scores[found.step] = f"**{scores[found.step]}**"
        yield [name, *scores[-_STEPS_SHOWN:]]


def norm_rows(subject: Side, template: Side) -> Iterator[list[str]]:
    """Yield rows of the subject with other norms of fields, mask thickness > 0."""
    cortex = _cortex(template)
    judge = Judge(subject, template, cortex)
    for changes in _NORMS:
        found = register(
            subject.sphere,
            template.sphere,
            subject.depth,
            template.depth,
            mask_b=cortex,
            parameters=MEASURED.with_values(**changes),
        )
        p = found.match.parameters
        sigma = found.match.path[found.match.step].sigma
        given = "" if p.sigma is None else " (given)"
        name = f"order {p.solver.order}, α = {p.alpha:g}, divergence {p.divergence:g}, "
        yield judge.row(f"{name}σ = {sigma:.2g}{given}", found)[:-1]


def sides_rows(left: Side, right: Side) -> Iterator[list[str]]:
    """Yield rows of the right hemisphere, seen in a mirror, on the left one."""
    cortex, other = _cortex(left), _cortex(right)
    judge = Judge(right, left, cortex)
    given = Given(
        right.sphere,
        left.sphere,
        right.depth[None],
        left.depth[None],
        _weights(other),
        _weights(cortex),
    )
    yield judge.row("rotation only", initial_map("sphere:mirror", given).correspondence)
    start = process_time()
    found = register(
        right.sphere,
        left.sphere,
        right.depth,
        left.depth,
        initial="sphere:mirror",
        mask_a=other,
        mask_b=cortex,
    )
    yield judge.row("`register`", found, process_time() - start)


def read_conte69(folder: Path) -> tuple[TriangleMesh, FloatArray, FloatArray, FloatArray]:
    """Read the sphere of conte69, the left hemisphere, its curvature, thickness, and cortex."""
    sphere = load_mesh(folder / "conte69_32k_lh_sphere.gii")
    curvature, thickness = (
        read_column(folder / f"conte69_32k_{name}.csv", "0")[: len(sphere.vertices)]
        for name in ("curvature", "thickness")
    )
    return (
        sphere,
        curvature,
        thickness,
        read_column(folder / "conte69_32k_lh_mask.csv", "0"),
    )


def conte69_lines(folder: Path, published: Path, template: Side) -> Iterator[list[str]]:
    """Yield rows of conte69 on fsaverage5 by curvature, thickness held out, beside HCP's map."""
    a, curvature, thickness, mask = read_conte69(folder)
    b = template.sphere
    theirs = Correspondence.through_sphere(
        a, b, sphere_directions(load_mesh(published)), sphere_directions(b)
    )
    cortex = _cortex(template) & (theirs.carry(mask) > 0.5)
    judge = Judge(template, template, cortex)
    places = theirs.points.positions
    held_out = template.thickness
    assert held_out is not None

    def row(name: str, found: Correspondence, seconds: float | None = None) -> list[str]:
        off = np.linalg.norm(found.points.positions - places, axis=1)[cortex]
        distortion = found.distortion()
        return [
            name,
            f"{abs(judge.alike(found.carry(curvature), template.curvature)):.3f}",
            f"{judge.alike(found.carry(thickness), held_out):.3f}",
            f"{off.mean():.2f}",
            f"{distortion.log2_area.mean:.3f}",
            f"{distortion.log2_shape.mean:.3f}",
            str(distortion.folded),
            "" if seconds is None else f"{seconds:.0f}",
        ]

    yield row("HCP's published sphere", theirs)
    start = process_time()
    found = register(a, b, curvature, template.curvature, mask_a=mask, mask_b=cortex)
    seconds = process_time() - start
    yield row("rotation only", found.initial)
    yield row("`register`", found, seconds)


def bound_rows(subject: Side, template: Side, folder: Path | None) -> Iterator[list[str]]:
    """Yield rows of what bounds of distortion cost, on spheres that are only turned at first."""
    cortex, b = _cortex(template), template.sphere
    of_subject = prepare(subject.sphere, b, subject.depth, template.depth, mask_b=cortex)
    yield from bounds.rows("the subject, depth", of_subject, lambda _: (1.5, 1.0, 0.6, 0.3, 0.1))
    if folder is not None:
        a, curvature, _, mask = read_conte69(folder)
        other = prepare(a, b, curvature, template.curvature, mask_a=mask, mask_b=cortex)
        yield from bounds.rows("conte69, curvature", other, lambda _: (0.5, 0.3, 0.15, 0.07))


def _cortex(side: Side) -> BoolArray:
    assert side.thickness is not None
    return np.asarray(side.thickness > 0)


def _weights(mask: BoolArray) -> FloatArray:
    return mask.astype(np.float64)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    for name in ("subject", "template"):
        parser.add_argument(f"--{name}", type=Path, required=True)
    for name in ("labels", "conte69", "published", "write"):
        parser.add_argument(f"--{name}", type=Path)
    given = parser.parse_args()
    subject, left = read_subject(given.subject), read_template(given.template, "left", given.labels)
    registered = load_mesh(next(iter(sorted(given.subject.rglob("lh.sphere.reg")))))
    parts = [
        "A subject on fsaverage5, mask thickness > 0 unless another one is named:",
        told_table(_HEADS, subject_rows(subject, left, registered)),
        "The scores of the last steps, as σ: score; the chosen σ is in bold:",
        told_table(("", *_STEPS_SHOWN * ("σ: score",)), choice_rows(subject, left)),
        "Other norms of fields:",
        told_table(_HEADS[:-1], norm_rows(subject, left)),
        "The right hemisphere of fsaverage5 on the left one:",
        told_table(_HEADS, sides_rows(left, read_template(given.template, "right", None))),
    ]
    if given.conte69 and given.published:
        heads = ("", "curvature", "thickness", "mm to HCP's", "mean abs. log₂ J", "mean log₂ R")
        rows = conte69_lines(given.conte69, given.published, left)
        parts += ["conte69 on fsaverage5:", told_table((*heads, "folded", "CPU s"), rows)]
    parts += [
        "Bounds of distortion (`max_distortion`):",
        told_table(bounds.HEADS, bound_rows(subject, left, given.conte69)),
    ]
    if given.write:
        put_between(given.write, MARKS, parts)


if __name__ == "__main__":
    main()
