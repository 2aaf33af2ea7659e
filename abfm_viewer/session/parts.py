"""The parts of a session, which its work uses."""

from __future__ import annotations

from abfm import TriangleMesh
from abfm.workers.worker import Worker, stateless
from abfm_viewer.computing.background import Jobs
from abfm_viewer.computing.solver import Solver
from abfm_viewer.document.document import Document, Surface, View
from abfm_viewer.document.kinds import MatchDocument
from abfm_viewer.session.bound import Bound
from abfm_viewer.session.editor import Editor
from abfm_viewer.session.film_match import FilmMatch
from abfm_viewer.session.functions import DocumentFunctions
from abfm_viewer.session.initial_maps import InitialMaps
from abfm_viewer.session.loading import Loading
from abfm_viewer.session.notices import Notices
from abfm_viewer.session.path_steps import PathSteps
from abfm_viewer.session.player import Player
from abfm_viewer.session.saving.saves import Saves

_ENDED_MESSAGE = "the process that computes has ended; try again"


class Parts:
    """Parts of a session with a mesh; see `Session`."""

    def __init__(self, mesh: TriangleMesh, name: str, at_once: bool) -> None:
        self.jobs = Jobs(at_once)
        self.at_once = at_once
        self.editor = Editor(MatchDocument((Surface(mesh, name),)))
        self.functions = DocumentFunctions(self.jobs)
        # for calls that hold the interpreter for long
        self._process = None if at_once else Worker(stateless, _ENDED_MESSAGE)
        self.initial_maps = InitialMaps(self.jobs, self.functions, self._process)
        self.notices = Notices(lambda: self.editor.moves)
        self.loading = Loading(self.jobs, self.notices)
        self.saves = Saves(self.editor)
        self.steps = PathSteps(self.editor, self.jobs, self.notices)
        self.bound = Bound(self.editor, self.jobs, self.notices, at_once)
        self.solver = Solver()
        self.film_match = FilmMatch()
        self.player = Player()
        self.dragging = self.draws_quickly = False

    @property
    def document(self) -> Document:
        return self.editor.document

    @property
    def view(self) -> View:
        return self.document.view

    def close(self) -> None:
        for part in (self.solver, self.film_match, self.functions, self.bound):
            part.close()
        if self._process is not None:
            self._process.close()
        self.jobs.close()
