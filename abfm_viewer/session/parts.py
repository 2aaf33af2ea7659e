"""The objects of which a session consists, for use by the classes in `work.py`."""

from typing import Any

from abfm import TriangleMesh
from abfm_viewer.computing.background import Jobs
from abfm_viewer.computing.matching import Matching
from abfm_viewer.computing.run import Process, Run
from abfm_viewer.document.document import Document, Surface, View
from abfm_viewer.document.kinds import MatchDocument
from abfm_viewer.session.bound import Bound
from abfm_viewer.session.editor import Editor
from abfm_viewer.session.functions import DocumentFunctions
from abfm_viewer.session.initial_maps import InitialMaps
from abfm_viewer.session.loading import Loading
from abfm_viewer.session.notices import Notices
from abfm_viewer.session.path_steps import PathSteps
from abfm_viewer.session.player import Player
from abfm_viewer.session.saving.saves import Saves
from abfm_viewer.session.sequence_match import SequenceMatch


class Parts:
    """The objects of a session, such as editor, functions, solver and player."""

    def __init__(self, mesh: TriangleMesh, name: str, at_once: bool) -> None:
        self.jobs = Jobs(at_once)
        self.at_once = at_once
        self.editor = Editor(MatchDocument((Surface(mesh, name),)))
        self.functions = DocumentFunctions(at_once)
        self._process = Process()  # for initial maps
        map_process = None if at_once else self._process
        self.initial_maps = InitialMaps(self.jobs, self.functions, map_process)
        self.notices = Notices(lambda: self.editor.action_count)
        self.loading = Loading(self.jobs, self.notices)
        self.saves = Saves(self.editor)
        self.steps = PathSteps(self.editor, self.jobs, self.notices)
        self.solver: Run[Any] = Run(Process())
        self.matching = Matching(self.solver)
        self.sequence_match = SequenceMatch(self.solver)
        self.bound = Bound(self.editor, self.notices, self.solver.process)
        self.player = Player()
        self.dragging = False  # whether the user drags; all changes are then one step of undo
        self.draws_quickly = False  # whether this machine can draw quickly; set by the window

    @property
    def document(self) -> Document:
        return self.editor.document

    @property
    def view(self) -> View:
        return self.document.view

    def close(self) -> None:
        for part in (self.solver, self.functions, self._process, self.jobs):
            part.close()
