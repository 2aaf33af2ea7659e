"""A bound of distortion: the closest field that keeps it takes the place of the result."""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import numpy as np

import abfm
from abfm.types import FloatArray
from abfm.workers.control import Control, controlled
from abfm.workers.progress import Step
from abfm.workers.worker import Worker, stateless
from abfm_viewer.computing.background import Jobs, Latest, same
from abfm_viewer.document.document import InitialMap
from abfm_viewer.session.editor import Editor
from abfm_viewer.session.notices import Notices

_ENDED_MESSAGE = "the process that looks for it has ended; try again"


class _Wanted(NamedTuple):
    """A search; its control makes it another one than the same search later."""

    result: abfm.Match
    initial: InitialMap | None
    most: float
    control: Control


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

    def __init__(self, editor: Editor, jobs: Jobs, notices: Notices, at_once: bool = False) -> None:
        self._editor, self._notices = editor, notices
        self._apart = None if at_once else Worker(stateless, _ENDED_MESSAGE)
        self._found: Latest[_Found] = jobs.latest()
        self._wanted: _Wanted | None = None
        self.most = 1.0

    @property
    def busy(self) -> str:
        return "limiting the distortion" if self._wanted else ""

    @property
    def step(self) -> Step | None:
        return self._found.step if self._wanted else None

    def look(self) -> None:
        """Look for such a field on the way of the result."""
        document = self._editor.document
        if document.match is not None:
            self.stop()
            initial = document.initial_map
            self._wanted = _Wanted(document.match, initial, self.most, Control())
            self.update()

    def stop(self) -> None:
        if self._wanted is not None:
            self._wanted.control.cancel(briefly=True)
        self._wanted = None

    def close(self) -> None:
        """End the process; who waits for its answer is told."""
        if self._apart is not None:
            self._apart.close()

    def update(self) -> None:
        """Take in what was found: call once per frame."""
        if (wanted := self._wanted) is None:
            return
        if self._editor.document.match is not wanted.result:
            self.stop()
            return
        found = self._found.ask(wanted, partial(self._search, wanted))
        if found is not None:
            self._wanted = None
            self._show(wanted, found)
        elif same(self._found.key, wanted):
            self._wanted = None
            self._notices.say(f"the distortion stays: {self._found.error}", is_error=True)

    def _search(self, wanted: _Wanted) -> _Found:
        with controlled(wanted.control):
            result, most = wanted.result, wanted.most
            initial = None if wanted.initial is None else wanted.initial.correspondence
            if self._apart is None:
                return _within(None, result, initial, most)
            return self._apart.call(_within, result, initial, most).result()

    def _show(self, wanted: _Wanted, found: _Found) -> None:
        bound = found.match.bound
        if bound is None or not bound.is_kept:
            self._notices.say(f"the distortion stays: {found.why}", is_error=True)
        elif np.array_equal(found.match.fine_velocity, wanted.result.fine_velocity):
            faces = f"{100 * abfm.matching.SHARE:g}% of the faces"
            self._notices.say(f"{faces} keep {wanted.most:g} already")
        else:
            if found.errors is not None:
                vars(found.match)["landmark_errors"] = found.errors
            label = f"limit the distortion to {wanted.most:g}"
            self._editor.change(label, result=found.match, chosen=None)
            headline = found.match.facts.headline
            self._notices.say(f"{headline}; undo returns to the match before")


def _within(
    _: None, result: abfm.Match, initial: abfm.Correspondence | None, most: float
) -> _Found:
    """Find the closest match that keeps the bound, initial map and flow together."""
    if initial is None:
        found = abfm.matching.bounded(result, most)
        return _Found(found, "; ".join(found.facts.warnings), found.landmark_errors)
    both = abfm.registration.within(abfm.Registration(initial, result), most)
    return _Found(both.match, "; ".join(both.notes), both.landmark_errors)
