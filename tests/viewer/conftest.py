"""Fixtures for tests of the viewer: a session on a sphere, and the app on an egg."""

import ctypes
import inspect
import sys
import threading
from dataclasses import replace

import pytest

from abfm_viewer.automation import Driver
from abfm_viewer.computing.background import Jobs
from abfm_viewer.files.state_folder import StateFolder
from abfm_viewer.scene import pacing
from abfm_viewer.scene.opengl import ps
from abfm_viewer.session.session import Session
from abfm_viewer.session.session_files import SessionFiles
from abfm_viewer.shown import quantities
from abfm_viewer.window import window
from tests.shapes import icosphere
from tests.viewer.sessions import EGG, ENDLESS, SIZE, opened, restart, until

_RASTERIZER_DISCARD = 0x8C89  # of OpenGL


@pytest.fixture(scope="session", autouse=True)
def _frames_without_pixels():
    """Compute the pixels of a frame only for pictures and clicks, as they take most of its time."""
    if sys.platform != "linux":
        yield
        return
    opengl = ctypes.CDLL("libGL.so.1")

    def between(before, after, draw):
        def drawn(*given, **options):
            before(_RASTERIZER_DISCARD)
            try:
                return draw(*given, **options)
            finally:
                after(_RASTERIZER_DISCARD)

        return drawn

    with pytest.MonkeyPatch.context() as patch:
        frame = window.Window.tick
        patch.setattr(window.Window, "tick", between(opengl.glEnable, opengl.glDisable, frame))
        for name in ("screenshot_to_buffer", "pick"):
            draw = getattr(ps, name)
            patch.setattr(ps, name, between(opengl.glDisable, opengl.glEnable, draw))
        yield


@pytest.fixture(autouse=True)
def _few_frames(monkeypatch):
    """Draw a third of the frames of the app, to leave time for background work.

    Screenshots have one sample per pixel, because smooth ones take 1 s.
    """
    monkeypatch.setattr(window, "_SECONDS_PER_FRAME", 1 / 10)
    monkeypatch.setattr(pacing, "SCREENSHOT_SAMPLES_MAX", 1)


@pytest.fixture
def session():
    session = opened()
    yield session
    session.close()


@pytest.fixture
def jobs():
    jobs = Jobs()
    yield jobs
    jobs.close()


@pytest.fixture
def endless():
    """Return a session whose runs continue until they are cancelled."""
    session = opened(ENDLESS)
    yield session
    session.close()


@pytest.fixture
def gui(tmp_path, request):
    """Return the app on an egg with default functions; a module may define its WINDOW size."""
    with Driver(EGG, size=getattr(request.module, "WINDOW", SIZE)) as gui:
        gui.window.dialogs.start_in(tmp_path)
        # tests need a constant time
        gui.session.editor.amend(view=replace(gui.session.view, flow_after_match=False))
        yield gui
        assert not gui.errors


@pytest.fixture
def walk(request, monkeypatch):
    """Return a function that takes the steps of a tour.

    Each step starts with the document of the first step, perhaps with other values. The parameters
    of a step are the fixtures that it needs. Patches by `monkeypatch` end with the step.
    """
    first = []

    def take(gui, *steps, **values):
        first.append(gui.session.document)
        for step in steps:
            restart(gui, replace(first[0], **values))
            with monkeypatch.context() as patched:
                _, *names = inspect.signature(step).parameters
                given = {name: request.getfixturevalue(name) for name in names}
                patches = {"monkeypatch": patched} if "monkeypatch" in given else {}
                step(gui, **given | patches)

    return take


class Desk:
    """A session with the parts of the window that open files and show questions to the user."""

    def __init__(self, session, folder):
        self.session = session
        self.state = StateFolder(folder)
        self.questions = []
        self.files = SessionFiles(
            session, self.state, lambda *question: self.questions.append(question)
        )

    def wait(self, condition):
        until(condition, self)

    def update(self):
        """Update the session and its files, as the window does in every frame."""
        self.session.update()
        self.files.update()

    def settle(self):
        """Wait until nothing is opened, computed or written."""
        for _ in range(3):  # each update may collect results and start further work
            self.update()
            self.wait(
                lambda: (
                    not self.session.busy and not self.files.saving and self.session.channels != ()
                )
            )

    def open(self, path):
        self.files.open(path)
        self.settle()


@pytest.fixture
def desk(tmp_path):
    """Return a `Desk` on a small sphere whose functions are computed."""
    desk = Desk(Session(icosphere(2), "sphere.off"), tmp_path / "state")
    desk.settle()
    yield desk
    desk.files.close()
    desk.session.close()


@pytest.fixture
def held(monkeypatch):
    """Return a function that blocks calls of a module's function.

    Calls whose arguments satisfy the condition set the first returned event, and wait until the
    test sets the second one.
    """

    def hold(module, name, condition=lambda *_: True):
        begun, may_end, compute = threading.Event(), threading.Event(), getattr(module, name)

        def wait_and_compute(*arguments, **options):
            if condition(*arguments):
                begun.set()
                assert may_end.wait(30)
            return compute(*arguments, **options)

        monkeypatch.setattr(module, name, wait_and_compute)
        return begun, may_end

    return hold


@pytest.fixture
def coarse_streaks(monkeypatch):
    """Use few texels for textures of streaks, because the time is proportional to their number."""
    for name in ("TEXELS", "_TEXELS_OF_PICTURES"):
        monkeypatch.setattr(quantities, name, 512)
    monkeypatch.setattr("abfm_viewer.pictures.panels._TEXELS", 512)
