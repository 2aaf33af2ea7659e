"""An edited document with what is told about it, what is being opened in its place, and what of it is in files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from abfm import AbfmError, TriangleMesh
from abfm_viewer.computing.background import Jobs
from abfm_viewer.document.document import Document
from abfm_viewer.files.origin import Origin
from abfm_viewer.session.editing import Editing
from abfm_viewer.session.kept import Kept
from abfm_viewer.session.loading import Load, Loading
from abfm_viewer.session.notices import Card, Entry, Notice, Notices, WaysOut

OPENING, RUN = "opening", "run"
"""What cards are about."""


class Housekeeping(Editing):
    """Everything about a document but its functions, its solver and its player."""

    def __init__(self, document: Document, jobs: Jobs) -> None:
        super().__init__(document)
        self._kept = Kept(document)
        self._notices = Notices()
        self._loading = Loading(jobs)

    # Files

    @property
    def path(self) -> Path | None:
        """The project file that Save writes; None before there is one."""
        return self.path_of(self.mesh)

    def path_of(self, mesh: TriangleMesh) -> Path | None:
        """The same for another mesh of the history."""
        origin = self._kept.origin(mesh)
        return origin.path if origin else None

    def origin_of(self, mesh: TriangleMesh) -> Origin | None:
        """The same file as it was when it was last read or written here."""
        return self._kept.origin(mesh)

    @property
    def title(self) -> str:
        """What is open, as windows and the menu bar call it: with a star where something of it is in no file."""
        name = self.path.name if self.path else self.document.name
        return f"{'* ' if self.unsaved else ''}{name}"

    def has_new_result(self, document: Document) -> bool:
        """Whether a document has a result that is in no file."""
        return self._kept.has_new_result(document)

    @property
    def unsaved(self) -> bool:
        """Whether something of the document is in no file."""
        return self._kept.differs(self.document)

    @property
    def unsaved_documents(self) -> tuple[Document, ...]:
        """What would be lost if the session ended now: this document, and others that it left for another mesh."""
        return self._kept.unsaved(self.document)

    def left(self, mesh: TriangleMesh) -> Document | None:
        """What `mark_saved` is to be told of a mesh when it is being saved."""
        return self._kept.left(mesh)

    def mark_saved(self, document: Document, origin: Origin, left: Document | None = None) -> None:
        """Remember that a document was written to a file, and so is what was `left` of its mesh at that time."""
        self._kept.keep(document, origin, left)
        self.say(f"saved {origin.path}")

    # What is told

    @property
    def notice(self) -> Notice:
        """The latest thing that was told, for a while."""
        return self._notices.latest

    @property
    def cards(self) -> tuple[Card, ...]:
        """Problems that stay in view until they are dismissed or mended, the latest first."""
        return self._notices.cards

    @property
    def log(self) -> Sequence[Entry]:
        """Everything that was told, the oldest first."""
        return self._notices.log

    def say(self, text: str, is_error: bool = False, about: str = "", remedies: WaysOut | None = None) -> None:
        """Tell something; an error also as a card with its remedies, until `mend` is called for what it is about."""
        self._notices.say(text, is_error, self.history.moves, about, remedies)

    def offered(self, card: Card) -> WaysOut:
        """What can be done about a card's problem, unless a newer card offers the same."""
        return self._notices.offered(card)

    def dismiss(self, card: Card) -> None:
        self._notices.dismiss(card)

    def mend(self, about: str) -> None:
        """Take the cards about something away: it is in order now."""
        self._notices.mend(about)

    # What is being opened

    def load(self, load: Load) -> None:
        """Read something in the background; what reading it gives is called by `update`. Errors become cards."""
        self.say(f"{load.what} ...")
        self._loading.begin(load)

    @property
    def loading(self) -> Load | None:
        """What is being read; None if nothing is."""
        return self._loading.now

    @property
    def opening(self) -> str:
        """What is about to take the document's place, so that a match would be lost; empty if nothing."""
        return self.loading.what if self.loading and self.loading.replaces else ""

    def cancel_loading(self) -> None:
        """Go on without what is being read."""
        if (load := self.loading) is not None:
            self._loading.cancel()
            self.say(f"{load.what} was cancelled")

    def _finish_loading(self) -> None:
        if (taken := self._loading.taken()) is None:
            return
        load, show, problem = taken
        if show is not None:
            self._notices.clear()
            self._notices.mend(OPENING)
            try:
                show()
            except AbfmError as error:
                problem = str(error)
        if problem:
            self.say(problem, is_error=True, about=OPENING, remedies=load.remedies)
