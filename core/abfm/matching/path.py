"""The path of a match: the fields of all steps of its continuation, with their measurements."""

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
    *("sigma", "alpha", "reach", "residual", "by flow lines", "folded"),
    *("log2 J", "log2 R", "log2 J 95%", "held out", "score", "mismatch", "refined"),
)


_REFINE_MAX = 10  # after more subdivisions, a mesh exceeds any memory


@dataclass(frozen=True, eq=False)
class PathStep:
    """One step of the continuation: a field, its sigma and its measurements (NaN if unknown).

    Attributes
    ----------
    sigma, alpha, reach : float
        Values of these parameters in this step (see `Parameters`).
    velocity : (N, 4^k F, 3) array
        Tangent fields, in the input's length unit per unit of time, on the mesh or on its midpoint
        subdivision made k times.
    residual, verified_residual, folded : float
        See `Match`.
    log2_area, log2_shape : float
        Area-weighted means of ``|log2 J|`` and ``|log2 R|``, with ``J = s_1 s_2`` and
        ``R = s_1 / s_2``. The stretches s_1 and s_2 are those of the map along flow lines.
    log2_area_95 : float
        Area-weighted 95th percentile of ``|log2 J|``.
    held_out : float
        Cross-validation residual: that on patches of the surface that were excluded from the fit,
        relative to their residual without motion. NaN if no patches were excluded.
    score : float
        Residual of these patches along flow lines plus 0.25 times ``log2_area``, both on the
        coarsest mesh. The match is the step with the smallest score. If sigma was interpolated
        between two steps, ``held_out`` and the score are interpolated as well.
    mismatch : float
        See `Match`.
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
        """Return how many times ``mesh`` is subdivided for the fields of this step."""
        return times_subdivided(self.velocity.shape[1], mesh)


NUMBERS = [name for name in PathStep.__dataclass_fields__ if name != "velocity"]


def choice_text(path: Sequence[PathStep], step: int) -> str:
    """Return a phrase with the selected sigma, its score, and the larger scores of its neighbours.

    The phrase is empty if no patches were held out (`PathStep.held_out`), or if another step has a
    smaller score.
    """
    scores = np.array([each.score for each in path])
    if not scores[step] <= np.nanmin(scores, initial=np.inf):
        return ""
    nearby = [n for n in (step - 1, step + 1) if 0 <= n < len(path) and np.isfinite(scores[n])]
    others = " and ".join(f"{scores[n]:.4f} at {path[n].sigma:.3g}" for n in nearby)
    text = f"sigma {path[step].sigma:.3g} has the smallest held-out score, {scores[step]:.4f}"
    return f"{text} ({others})" if others else text


def path_table(path: Sequence[PathStep], mesh: TriangleMesh) -> list[str]:
    """Return a path as lines of CSV: the header `COLUMNS`, then one line for each step.

    The last column is the number of subdivisions from ``mesh`` to the mesh of the step's fields.
    """
    rows = [
        [*(f"{getattr(each, name):.6g}" for name in NUMBERS), str(each.refined(mesh))]
        for each in path
    ]
    return [",".join(row) for row in ([*COLUMNS], *rows)]


def path_arrays(path: Sequence[PathStep], selected: int, mesh: TriangleMesh) -> dict[str, Any]:
    """Return the arrays of a path for a file, without the fields of the ``selected`` step.

    The arrays are a row of numbers for each step, and the fields of the other steps. These fields
    are divided by the length scale of the mesh, rounded to single precision, and concatenated along
    the faces. If the number N of consecutive fields differs between steps, these numbers are stored
    as well, and all fields are concatenated.
    """
    rows = np.array([[*(getattr(e, name) for name in NUMBERS), e.refined(mesh)] for e in path])
    # a step that diverged may have infinite measurements
    rows[~np.isfinite(rows)] = np.nan
    arrays: dict[str, Any] = {"path_steps": rows, "path_step": selected}
    others = [each.velocity for number, each in enumerate(path) if number != selected]
    counts = [len(each.velocity) for each in path]
    if len(set(counts)) > 1:
        arrays["path_fields"] = np.array(counts)
        others = [fields.reshape(1, -1, 3) for fields in others]
    if others:
        arrays["path_velocity"] = _single(np.concatenate(others, axis=1), mesh)
    return arrays


def as_stored(velocity: FloatArray, mesh: TriangleMesh) -> FloatArray:
    """Round fields (N, 4^k F, 3) to the precision in which files store all but one step."""
    return _double(_single(velocity, mesh), mesh)


def _double(fields: NDArray[Any], mesh: TriangleMesh) -> FloatArray:
    return fields.astype(np.float64) * mesh.length_scale


def _single(velocity: FloatArray, mesh: TriangleMesh) -> NDArray[np.float32]:
    return (velocity / mesh.length_scale).astype(np.float32)


def path_of(
    arrays: Mapping[str, NDArray[Any]], velocity: FloatArray, mesh: TriangleMesh
) -> tuple[tuple[PathStep, ...], int]:
    """Return the path from stored `path_arrays`, and the index of its selected step.

    Files store the fields of the selected step separately, as ``velocity``. Raise ValueError if the
    arrays are inconsistent.
    """
    missing = {"path_steps", "path_step"} - arrays.keys()
    if missing:
        raise ValueError(f"the file has no array {' and '.join(sorted(missing))}")
    rows, selected = arrays["path_steps"], int(arrays["path_step"])
    levels = rows[:, -1]
    if not (np.isin(levels, np.arange(_REFINE_MAX + 1))).all():
        raise ValueError(
            f"path_steps have subdivision counts {levels}; expected integers up to {_REFINE_MAX}"
        )
    if selected >= len(rows):
        raise ValueError(f"path_step is {selected}; expected a number below {len(rows)}")
    refined = times_subdivided(velocity.shape[1], mesh)
    if levels[selected] != refined:
        raise ValueError(
            f"the number of subdivisions of step {selected} is {levels[selected]:g} in path_steps, "
            f"but {refined} in its field"
        )
    counts = arrays.get("path_fields", np.full(len(rows), len(velocity)))
    if counts[selected] != len(velocity):
        raise ValueError(
            f"the number of fields of step {selected} is {counts[selected]} in path_fields, but "
            f"the step has {len(velocity)}"
        )
    side = 1 if "path_fields" in arrays else len(velocity)
    sizes = len(mesh.faces) * 4 ** levels.astype(np.int64) * counts // side
    sizes[selected] = 0
    expected = (side, int(sizes.sum()), 3)
    fields = arrays.get("path_velocity", np.zeros((side, 0, 3)))
    if fields.shape != expected:
        raise ValueError(f"path_velocity has shape {fields.shape}; expected {expected}")
    parts = np.split(fields, np.cumsum(sizes)[:-1], axis=1)
    path = (
        PathStep(
            velocity=velocity if step == selected else _double(part.reshape(count, -1, 3), mesh),
            **dict(zip(NUMBERS, map(float, row), strict=False)),
        )
        for step, (row, part, count) in enumerate(zip(rows, parts, counts, strict=True))
    )
    return tuple(path), selected
