"""Undo and redo: states of the document with the name of what the user did to get there."""

from dataclasses import dataclass, replace

from abfm_viewer.document.document import Document

LONGEST = 200


@dataclass(frozen=True, eq=False)
class Step:
    """A state that was left, what was done then, and what may still be merged into it."""

    document: Document
    label: str
    merge: str


class History:
    """Every change is a step; changes in a row with the same merge key (a drag, a scrub) are one."""

    def __init__(self, document: Document) -> None:
        self.document = document  # at present; what the user did not do changes it without a step
        self.moves = 0  # what the user did: changes, undo and redo
        self._past: list[Step] = []
        self._future: list[Step] = []

    @property
    def undo_label(self) -> str:
        """What undo would take back; empty if nothing."""
        return self._past[-1].label if self._past else ""

    @property
    def redo_label(self) -> str:
        """What redo would do again; empty if nothing."""
        return self._future[-1].label if self._future else ""

    @property
    def undo_to(self) -> Document | None:
        """The state that undo would return to; None if there is none."""
        return self._past[-1].document if self._past else None

    @property
    def redo_to(self) -> Document | None:
        """The state that redo would return to; None if there is none."""
        return self._future[-1].document if self._future else None

    def change(self, document: Document, label: str, merge: str = "") -> None:
        """Go on to another state."""
        if not (merge and self._past and self._past[-1].merge == merge):
            self._past.append(Step(self.document, label, merge))
            del self._past[:-LONGEST]
        self._future.clear()
        self.document = document
        self.moves += 1

    def seal(self) -> None:
        """Let the next change be a step of its own, whatever its merge key."""
        if self._past:
            self._past[-1] = replace(self._past[-1], merge="")

    def undo(self) -> None:
        """Go back one step, if there is one."""
        self._move(self._past, self._future)

    def redo(self) -> None:
        """Go forward one step, if there is one."""
        self._move(self._future, self._past)

    def _move(self, taken: list[Step], left: list[Step]) -> None:
        if taken:
            step = taken.pop()
            left.append(Step(self.document, step.label, ""))
            self.document = step.document
            self.moves += 1
