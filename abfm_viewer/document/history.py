"""Undo and redo: states of the document with the name of what the user did to get there."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from abfm_viewer.document.document import Document

LONGEST, LARGEST = 200, 500_000_000
"""How many steps undo goes back, and bytes of the meshes and results to which it leads, besides
those of the latest step."""


class Step(NamedTuple):
    """A state that was left, what was done then, and what may still be merged into it."""

    document: Document
    label: str
    merge: str
    looks: bool  # whether it was done to look at the surfaces in another way


class History:
    """Every change is a step; changes in a row with the same merge key (a drag, a scrub) are one.

    How the surfaces are seen goes back only with a step that changed it: what the mouse turned
    meanwhile stays. What the user did not do changes `document` without a step; `moves` counts what
    the user did: changes, undo and redo.
    """

    def __init__(self, document: Document) -> None:
        self.document = document
        self.moves = 0
        self.past: list[Step] = []
        self.future: list[Step] = []

    @property
    def documents(self) -> list[Document]:
        return [self.document, *(step.document for step in (*self.past, *self.future))]

    @property
    def undo_label(self) -> str:
        return self.past[-1].label if self.past else ""

    @property
    def redo_label(self) -> str:
        return self.future[-1].label if self.future else ""

    def change(self, document: Document, label: str, merge: str = "") -> None:
        if not (merge and self.past and self.past[-1].merge == merge):
            looks = _look_differs(self.document, document)
            self.past.append(Step(self.document, label, merge, looks))
            del self.past[: -self._kept_steps()]
        self.future.clear()
        self.document = document
        self.moves += 1

    def seal(self) -> None:
        """Let the next change be a step of its own, whatever its merge key."""
        if self.past:
            self.past[-1] = self.past[-1]._replace(merge="")

    def undo(self) -> None:
        self._move(self.past, self.future)

    def redo(self) -> None:
        self._move(self.future, self.past)

    def _kept_steps(self) -> int:
        """Count the steps to take back: always the latest, others as far as there is room."""
        counted, room = set(_large_parts(self.document)), LARGEST
        for count, step in enumerate(reversed(self.past)):
            parts = _large_parts(step.document)
            room -= sum(parts[key] for key in parts.keys() - counted)
            counted |= parts.keys()
            if count == LONGEST or (count and room < 0):
                return count
        return len(self.past)

    def _move(self, taken: list[Step], left: list[Step]) -> None:
        if taken:
            step, now = taken.pop(), self.document
            left.append(step._replace(document=now, merge=""))
            self.document = step.document
            if not step.looks and _look_differs(now, step.document):
                seen = replace(step.document.view, look=now.view.look, large=now.view.large)
                self.document = replace(step.document, view=seen)
            self.moves += 1


def _large_parts(document: Document) -> dict[int, int]:
    """Bytes of the arrays of meshes and results, by the identity of these."""
    held = [*(surface.mesh for surface in document.surfaces), document.result]
    return {
        id(part): sum(
            array.nbytes for array in vars(part).values() if isinstance(array, np.ndarray)
        )
        for part in held
        if part is not None
    }


def _look_differs(before: Document, after: Document) -> bool:
    """Return whether a step changes how surfaces are seen, which undo takes back then alone."""
    one, other = before.view, after.view
    is_other = before.identity is not after.identity
    return is_other or one.look is not other.look or one.large != other.large
