"""What a project's parts must be to fit together."""

from __future__ import annotations

import numpy as np

import abfm
from abfm_viewer.appearance.colormaps import NAMES
from abfm_viewer.document.document import EXTRAPOLATION, FARTHEST, NEAREST, Document, Front


def terms_from_files(spec: str) -> list[str]:
    """The terms of a function that read files, in their text form: what a project must hold the values of.

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


def check(document: Document) -> None:
    """Refuse a document that does not fit together or could not be drawn, by a `ValueError` that says why."""
    for number, run in enumerate(document.runs):
        rows = run.stages.size
        _require(all(0 <= row <= rows for row in run.restarts), f"run {number} of {rows} rows restarts outside them")
    for channel in document.channels:
        terms_from_files(channel.source)
        terms_from_files(channel.target)
        _require(0 <= channel.weight < np.inf, f"a channel has the weight {channel.weight}; expected 0 or more")
    if document.mask:
        terms_from_files(document.mask)
    count, end = max(len(document.channels), 1), EXTRAPOLATION * document.parameters.tau
    _require(0 <= document.channel < count, f"channel is {document.channel}; expected 0 to {count - 1}")
    _require(document.bump >= 0, f"bump is {document.bump}; expected 0 or more")
    _require(0 <= document.time <= end, f"time is {document.time}; expected 0 to {end}")
    F = len(document.mesh.faces)
    for point in document.lines + document.points:
        inside = min(point.barycentric) >= -1e-9 and abs(sum(point.barycentric) - 1) <= 1e-9
        _require(0 <= point.face < F, f"a point lies on face {point.face}; expected 0 to {F - 1}")
        _require(inside, f"a point has weights {point.barycentric}; expected 0 or more, with sum 1")
    view, colormaps = document.view, ("automatic", *NAMES)
    _require(view.colormap in colormaps, f"colormap is {view.colormap!r}; expected {' or '.join(colormaps)}")
    _require(0 < view.ui_scale <= 10, f"ui_scale is {view.ui_scale}; expected above 0 to 10")
    _require(0 < view.arrow_length <= 10, f"arrow_length is {view.arrow_length}; expected above 0 to 10")
    _require(0 <= view.arrow_density <= 1, f"arrow_density is {view.arrow_density}; expected 0 to 1")
    _require(0 < view.isoline_count <= 1000, f"isoline_count is {view.isoline_count}; expected 1 to 1000")
    for front in (view.front, view.look.front if view.look else None):
        _require(front is None or _is_upright(front), f"front is {front}; expected two unit vectors at a right angle")
    if view.look is not None:
        zoom = view.look.zoom
        _require(FARTHEST <= zoom <= NEAREST, f"zoom is {zoom}; expected {FARTHEST:g} to {NEAREST:g}")


def _is_upright(front: Front) -> bool:
    axes = np.array([front.direction, front.up])
    return bool(np.allclose(axes @ axes.T, np.eye(2), atol=1e-6))


def _require(fits: bool, problem: str) -> None:
    if not fits:
        raise ValueError(problem)
