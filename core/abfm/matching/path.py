"""The path of a match from smooth to close: the fields that it found on its way, and their cost."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from abfm.mesh import TriangleMesh
from abfm.mesh.subdivision import times_subdivided
from abfm.types import FloatArray

COLUMNS = (
    "sigma",
    "alpha",
    "reach",
    "residual",
    "by flow lines",
    "folded",
    "log2 J",
    "log2 R",
    "log2 J 95%",
    "held out",
    "score",
    "mismatch",
    "refined",
)


_REFINE_MAX = 10  # times: more faces than memory holds


@dataclass(frozen=True, eq=False)
class PathStep:
    """What was found with one sigma; what is unknown is NaN.

    Attributes
    ----------
    sigma, alpha, reach : float
        As in `Parameters`, those of this step.
    velocity : (N, 4^k F, 3) array
        Tangent fields, in the input's length unit per unit of time, on the mesh or on its midpoint
        subdivision made k times.
    residual, verified_residual, folded : float
        As of a `Match`.
    log2_area, log2_shape : float
        Means, by area, of ``|log2 J|`` and ``|log2 R|``, with ``J = s_1 s_2`` and ``R = s_1 / s_2``
        of the stretches of the map along flow lines.
    log2_area_95 : float
        The 95th percentile of ``|log2 J|``, by area.
    held_out : float
        Residual of held-out patches over that of the same patches without motion: below 1 the field
        also improves values that it was not fitted to. NaN if nothing was held out.
    score : float
        Residual of held-out patches by flow lines plus 0.25 times ``log2_area``, both on the
        coarsest mesh. The match is the step with the smallest score; where that step lies between
        two others, its ``held_out`` and score are interpolated. NaN if nothing was held out.
    mismatch : float
        As of a `Match`.
    """

    sigma: float
    alpha: float
    reach: float
    velocity: FloatArray = field(repr=False)
    residual: float
    verified_residual: float = math.nan
    folded: float = math.nan
    log2_area: float = math.nan
    log2_shape: float = math.nan
    log2_area_95: float = math.nan
    held_out: float = math.nan
    score: float = math.nan
    mismatch: float = math.nan

    def refined(self, mesh: TriangleMesh) -> int:
        """Return how often the mesh is subdivided on which its fields are."""
        return times_subdivided(self.velocity.shape[1], mesh)


NUMBERS = [name for name in PathStep.__dataclass_fields__ if name != "velocity"]


def choice_text(path: Sequence[PathStep], step: int) -> str:
    """Return the sigma that was chosen by scores, and the scores of it and of its neighbours.

    Empty if nothing was held out, or if another step has a smaller score.
    """
    scores = np.array([each.score for each in path])
    if not scores[step] <= np.nanmin(scores, initial=np.inf):
        return ""
    near = [n for n in (step - 1, step + 1) if 0 <= n < len(path) and np.isfinite(scores[n])]
    beside = " and ".join(f"{scores[n]:.4f} at {path[n].sigma:.3g}" for n in near)
    own = f"sigma {path[step].sigma:.3g} has the smallest held-out score, {scores[step]:.4f}"
    return f"{own} ({beside})" if beside else own


def path_table(path: Sequence[PathStep], mesh: TriangleMesh) -> list[str]:
    """Return a path as lines of CSV, a header of `COLUMNS` first; `refined` are k of the mesh."""
    rows = [
        [*(f"{getattr(each, name):.6g}" for name in NUMBERS), str(each.refined(mesh))]
        for each in path
    ]
    return [",".join(row) for row in ([*COLUMNS], *rows)]


def path_arrays(path: Sequence[PathStep], own: int, mesh: TriangleMesh) -> dict[str, Any]:
    """Return what files hold of a path besides the fields of its ``own`` step: a row of numbers a
    step, and the others' fields side by side in single precision, in lengths of the mesh. If the
    steps have different numbers of fields, these numbers and the fields one after another.
    """
    rows = np.array([[*(getattr(e, name) for name in NUMBERS), e.refined(mesh)] for e in path])
    # what a step that went astray left may be beyond all numbers
    rows[~np.isfinite(rows)] = np.nan
    arrays: dict[str, Any] = {"path_steps": rows, "path_step": own}
    others = [each.velocity for number, each in enumerate(path) if number != own]
    counts = [len(each.velocity) for each in path]
    if len(set(counts)) > 1:
        arrays["path_fields"] = np.array(counts)
        others = [fields.reshape(1, -1, 3) for fields in others]
    if others:
        arrays["path_velocity"] = _single(np.concatenate(others, axis=1), mesh)
    return arrays


def as_stored(velocity: FloatArray, mesh: TriangleMesh) -> FloatArray:
    """Return fields (N, 4^k F, 3) as files keep those of steps that are not the match's own."""
    return _double(_single(velocity, mesh), mesh)


def _double(fields: NDArray[Any], mesh: TriangleMesh) -> FloatArray:
    return fields.astype(np.float64) * mesh.length_scale


def _single(velocity: FloatArray, mesh: TriangleMesh) -> NDArray[np.float32]:
    return (velocity / mesh.length_scale).astype(np.float32)


def path_of(
    arrays: Mapping[str, NDArray[Any]], velocity: FloatArray, mesh: TriangleMesh
) -> tuple[tuple[PathStep, ...], int]:
    """Return the path of `path_arrays` and the number of its own step, whose fields are given;
    ValueError if they do not fit.
    """
    missing = {"path_steps", "path_step"} - arrays.keys()
    if missing:
        raise ValueError(f"it lacks {' and '.join(sorted(missing))}")
    rows, own = arrays["path_steps"], int(arrays["path_step"])
    levels = rows[:, -1]
    if not (np.isin(levels, np.arange(_REFINE_MAX + 1))).all():
        raise ValueError(f"path_steps were refined {levels} times; expected whole numbers")
    if own >= len(rows):
        raise ValueError(f"path_step is {own}; expected a number below {len(rows)}")
    refined = times_subdivided(velocity.shape[1], mesh)
    if levels[own] != refined:
        raise ValueError(
            f"path_steps say that step {own} was refined {levels[own]:g} times; its field was "
            f"{refined} times"
        )
    counts = arrays.get("path_fields", np.full(len(rows), len(velocity)))
    if counts[own] != len(velocity):
        raise ValueError(
            f"path_fields say that step {own} has {counts[own]} fields; it has {len(velocity)}"
        )
    side = 1 if "path_fields" in arrays else len(velocity)
    sizes = len(mesh.faces) * 4 ** levels.astype(np.int64) * counts // side
    sizes[own] = 0
    expected = (side, int(sizes.sum()), 3)
    fields = arrays.get("path_velocity", np.zeros((side, 0, 3)))
    if fields.shape != expected:
        raise ValueError(f"path_velocity has shape {fields.shape}; expected {expected}")
    parts = np.split(fields, np.cumsum(sizes)[:-1], axis=1)
    path = (
        PathStep(
            velocity=velocity if step == own else _double(part.reshape(count, -1, 3), mesh),
            **dict(zip(NUMBERS, map(float, row), strict=False)),
        )
        for step, (row, part, count) in enumerate(zip(rows, parts, counts, strict=True))
    )
    return tuple(path), own
