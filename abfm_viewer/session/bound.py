"""Search for a field of small residual whose distortion stays below a bound."""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import numpy as np

import abfm
from abfm.types import FloatArray
from abfm.workers.progress import Step
from abfm_viewer.computing.run import Process, Run
from abfm_viewer.session.editor import Editor
from abfm_viewer.session.notices import Notices


class _Found(NamedTuple):
    match: abfm.Match
    reason: str  # why there is no match within the bound
    errors: FloatArray | None  # errors of landmarks, computed here because they are slow


class Bound:
    """Searches, in a subprocess, for a match with less distortion than the current result.

    There is at most one search at a time. If it finds a match whose distortion is at most
    `maximum`, this replaces the result of the document. Otherwise a message gives the reason.
    """

    def __init__(self, editor: Editor, notices: Notices, process: Process) -> None:
        self._editor, self._notices, self._process = editor, notices, process
        self._run: Run[_Found] | None = None
        self._result: abfm.Match | None = None  # the result when the search started
        self.maximum = 1.0  # bound for |log2 J| and |log2 R| on 99% of the faces

    @property
    def busy(self) -> str:
        return "limiting the distortion" if self._run else ""

    @property
    def step(self) -> Step | None:
        return self._run.overall.step if self._run else None

    def start(self) -> None:
        document = self._editor.document
        if (result := document.match) is not None:
            self.stop()
            initial = document.initial_map and document.initial_map.correspondence
            self._run, self._result = Run(self._process), result
            work = partial(self._run.call, _within, result, initial, self.maximum)
            self._run.start(work, partial(self._show, result, self.maximum))

    def stop(self) -> None:
        if self._run is not None:
            self._run.cancel(skip_checks=True)
        self._run = self._result = None

    def update(self) -> None:
        if self._run is not None and self._editor.document.match is not self._result:
            self.stop()
        elif self._run is not None:
            self._run.collect()

    def _show(self, result: abfm.Match, maximum: float, found: _Found | None) -> None:
        reason = self._run.reason if self._run else ""
        self._run = self._result = None
        bound = found.match.bound if found else None
        if found is None or bound is None or not bound.is_satisfied:
            reason = found.reason if found else reason
            self._notices.show(f"the distortion was not limited: {reason}", is_error=True)
        elif np.array_equal(found.match.fine_velocity, result.fine_velocity):
            faces = f"{100 * abfm.matching.BOUNDED_SHARE:g}% of the faces"
            self._notices.show(f"{faces} are within the bound {maximum:g} already")
        else:
            if found.errors is not None:
                vars(found.match)["landmark_errors"] = found.errors
            label = f"limit the distortion to {maximum:g}"
            self._editor.change(label, result=found.match, solver_step=None)
            headline = found.match.facts.headline
            self._notices.show(f"{headline}; Undo restores the previous match")


def _within(
    _: object, result: abfm.Match, initial: abfm.Correspondence | None, maximum: float
) -> _Found:
    """Return the match of smallest residual whose distortion is at most ``maximum``.

    If none is found, return ``result``, the given match, and the reason. ``initial`` is the initial
    map from surface A to B; None for one surface.
    """
    if initial is None:
        found = abfm.matching.limit_distortion(result, maximum)
        return _Found(found, "; ".join(found.facts.warnings), found.landmark_errors)
    both = abfm.registration.limit_distortion(abfm.Registration(initial, result), maximum)
    return _Found(both.match, "; ".join(both.notes), both.landmark_errors)
