"""What a project's parts must be to fit together."""

from __future__ import annotations

import numpy as np

import abfm
from abfm_viewer.appearance.colormaps import NAMES
from abfm_viewer.document.document import FARTHEST, NEAREST, Document, Front, View


def terms_from_files(spec: str) -> list[str]:
    """The terms of a function that read files, in their text form: what a project must hold the
    values of.

    A text that is no spec is a `FunctionError`.
    """

    def reads_files(term: abfm.functions.Spec) -> bool:
        if isinstance(term, abfm.functions.Permuted):
            return not term.is_detected or reads_files(term.function)
        return isinstance(term, abfm.functions.ValuesFile) or (
            isinstance(term, abfm.functions.Sum) and any(map(reads_files, term.terms))
        )

    tree = abfm.functions.parse(spec)
    terms = tree.terms if isinstance(tree, abfm.functions.Sum) else (tree,)
    return [str(term) for term in terms if reads_files(term)]


_VIEW_BOUNDS: dict[str, tuple[float, float]] = {
    "ui_scale": (0, 10),
    "arrow_length": (0, 10),
    "arrow_density": (0, 1),
    "isoline_count": (1, 1000),
}
_ABOVE_0 = ("ui_scale", "arrow_length")


def check(document: Document) -> None:
    """Refuse a document that does not fit together, by a `ValueError` that says why."""
    for number, run in enumerate(document.runs):
        rows = run.stages.size
        inside = all(0 <= row <= rows for row in run.restarts)
        _require(inside, f"run {number} of {rows} rows restarts outside them")
    for function in document.functions:
        terms_from_files(function.spec)
    for weight in (channel.weight for channel in document.channels):
        _require(0 <= weight < np.inf, f"a channel has the weight {weight}; expected 0 or more")
    _within("channel", document.channel, 0, max(len(document.channels), 1) - 1)
    _require(document.bump >= 0, f"bump is {document.bump}; expected 0 or more")
    _within("time", document.time, 0, document.end)
    F = len(document.surface().mesh.faces)
    for point in document.lines + document.points:
        inside = min(point.barycentric) >= -1e-9 and abs(sum(point.barycentric) - 1) <= 1e-9
        _require(0 <= point.face < F, f"a point lies on face {point.face}; expected 0 to {F - 1}")
        _require(inside, f"a point has weights {point.barycentric}; expected 0 or more, with sum 1")
    _check_view(document.view, document.surface().front)


def _check_view(view: View, front: Front | None) -> None:
    colormaps = ("automatic", *NAMES)
    expected = " or ".join(colormaps)
    _require(view.colormap in colormaps, f"colormap is {view.colormap!r}; expected {expected}")
    for name, (low, high) in _VIEW_BOUNDS.items():
        value = getattr(view, name)
        if name in _ABOVE_0:
            _require(0 < value <= high, f"{name} is {value}; expected above 0 to {high:g}")
        _within(name, value, low, high)
    if view.look is not None:
        _within("zoom", view.look.zoom, FARTHEST, NEAREST)
    for one in (front, view.look.front if view.look else None):
        axes = np.eye(3)[:2] if one is None else np.array([one.direction, one.up])
        is_upright = bool(np.allclose(axes @ axes.T, np.eye(2), atol=1e-6))
        _require(is_upright, f"front is {one}; expected two unit vectors at a right angle")


def _within(name: str, value: float, low: float, high: float) -> None:
    _require(low <= value <= high, f"{name} is {value}; expected {low} to {high}")


def _require(fits: bool, problem: str) -> None:
    if not fits:
        raise ValueError(problem)
