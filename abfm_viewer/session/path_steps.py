"""Steps of the continuation of a match, which can be shown in place of the result."""

from __future__ import annotations

from functools import partial

import abfm
from abfm_viewer.computing.background import Jobs, Latest, same
from abfm_viewer.session.editor import Editor
from abfm_viewer.session.notices import Notices


class PathSteps:
    """Shows earlier steps of the continuation, from large to small sigma, in place of the result.

    Each shown step is a step of undo. A step that was shown before is taken from the history, with
    its computed facts.
    """

    def __init__(self, editor: Editor, jobs: Jobs, notices: Notices) -> None:
        self._editor, self._notices = editor, notices
        self._found: Latest[abfm.Match] = jobs.latest()
        self._wanted: tuple[abfm.Match, int] | None = None  # result at the request, and step

    @property
    def busy(self) -> str:
        return f"computing step {self._wanted[1] + 1}" if self._wanted else ""

    @property
    def shown(self) -> int:
        """Number of the step that is shown or is being computed to be shown; 0 without a result."""
        result = self._editor.document.match
        return self._wanted[1] if self._wanted else result.step if result else 0

    @property
    def solver_step(self) -> int | None:
        """Number of the step that the solver chose; None without a result."""
        document = self._editor.draft
        if document.solver_step is None and document.result:
            return document.result.step
        return document.solver_step

    def show(self, step: int) -> None:
        """Show step number ``step`` of the continuation, or the nearest one that exists."""
        if result := self._editor.document.match:
            self._wanted = result, min(max(step, 0), len(result.path) - 1)
            self.update()

    def stop(self) -> None:
        self._wanted = None

    def update(self) -> None:
        if self._wanted is None:
            return
        document, (requested_of, step) = self._editor.document, self._wanted
        result = document.match
        if result is None or result.path is not requested_of.path or result.step == step:
            self._wanted = None
            return
        found, key = self._from_history(step), (requested_of.path, step)
        if found is None:
            found = self._found.request(key, partial(requested_of.at_step, step))
        if found is not None:
            self._wanted = None
            solver_step = None if step == self.solver_step else self.solver_step
            label = f"show step {step + 1} of the path"
            self._editor.change(label, result=found, solver_step=solver_step)
        elif same(self._found.key, key):
            self._wanted = None
            self._notices.show(f"step {step + 1}: {self._found.error}", is_error=True)

    def _from_history(self, step: int) -> abfm.Match | None:
        result = self._editor.document.match
        for document in self._editor.documents:
            other = document.match
            if result and other and (other.path is result.path) and other.step == step:
                return other
        return None
