"""A bound of distortion: the closest field that keeps it takes the place of the result."""

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
    """The closest match, why no match keeps the bound, and how far it leaves landmarks, which takes
    too long where that is shown.
    """

    match: abfm.Match
    why: str
    errors: FloatArray | None


class Bound:
    """Looks for fields whose maps change areas and shapes of 99% of the faces by no more than
    ``most``, as |log2 J| and |log2 R|, in a process, one at a time.
    """

    def __init__(self, editor: Editor, notices: Notices, process: Process) -> None:
        self._editor, self._notices, self._process = editor, notices, process
        self._run: Run[_Found] | None = None
        self._result: abfm.Match | None = None  # of which the field is wanted
        self.maximum = 1.0

    @property
    def busy(self) -> str:
        return "limiting the distortion" if self._run else ""

    @property
    def step(self) -> Step | None:
        return self._run.step if self._run else None

    def start(self) -> None:
        """Look for such a field on the way of the result."""
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
        """Take in what was found: call once per frame."""
        if self._run is not None and self._editor.document.match is not self._result:
            self.stop()
        elif self._run is not None:
            self._run.collect()

    def _show(self, result: abfm.Match, most: float, found: _Found | None) -> None:
        why = self._run.reason if self._run else ""
        self._run = self._result = None
        bound = found.match.bound if found else None
        if found is None or bound is None or not bound.is_kept:
            self._notices.show(
                f"the distortion stays: {found.why if found else why}", is_error=True
            )
        elif np.array_equal(found.match.fine_velocity, result.fine_velocity):
            faces = f"{100 * abfm.matching.BOUNDED_SHARE:g}% of the faces"
            self._notices.show(f"{faces} keep {most:g} already")
        else:
            if found.errors is not None:
                vars(found.match)["landmark_errors"] = found.errors
            label = f"limit the distortion to {most:g}"
            self._editor.change(label, result=found.match, solver_step=None)
            headline = found.match.facts.headline
            self._notices.show(f"{headline}; undo returns to the match before")


def _within(
    _: object, result: abfm.Match, initial: abfm.Correspondence | None, most: float
) -> _Found:
    """Find the closest match that keeps the bound, initial map and flow together."""
    if initial is None:
        found = abfm.matching.limit_distortion(result, most)
        return _Found(found, "; ".join(found.facts.warnings), found.landmark_errors)
    both = abfm.registration.limit_distortion(abfm.Registration(initial, result), most)
    return _Found(both.match, "; ".join(both.notes), both.landmark_errors)
