"""What tests of the viewer share: a session on a sphere, and the app on an egg."""

import ctypes
import inspect
import sys
import threading
from dataclasses import replace

import pytest

from abfm_viewer.automation import Driver
from abfm_viewer.computing.background import Jobs
from abfm_viewer.files.state_folder import StateFolder
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
    """Compute pixels only for pictures and clicks: without a graphics card they take most of the
    time of a frame, and no test looks at those of other frames.
    """
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
    """While tests wait, half as many frames are drawn as in the app: they take the time of what
    is waited for.
    """
    monkeypatch.setattr(window, "_SECONDS_PER_FRAME", 1 / 15)


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
    """A session whose runs go on until they are told otherwise."""
    session = opened(ENDLESS)
    yield session
    session.close()


@pytest.fixture
def gui(tmp_path, request):
    """The app on an egg with its default functions, in a small window unless a file of tests has
    its own WINDOW.
    """
    with Driver(EGG, size=getattr(request.module, "WINDOW", SIZE)) as gui:
        gui.window.dialogs.folder = tmp_path
        # tests look at what stands still
        gui.session.editor.amend(view=replace(gui.session.view, flow_after_match=False))
        yield gui
        assert not gui.errors


@pytest.fixture
def walk(request, monkeypatch):
    """Take the steps of a tour: each begins with the document of the first one, perhaps with other
    values, and names the fixtures that it needs; what it patches ends with it.
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
    """A session with its files and the questions that were asked."""

    def __init__(self, session, folder):
        self.session = session
        self.state = StateFolder(folder)
        self.questions = []
        self.files = SessionFiles(
            session, self.state, lambda *question: self.questions.append(question)
        )

    def wait(self, condition):
        """Update until something holds."""
        until(condition, self)

    def update(self):
        """What the window does in every frame."""
        self.session.update()
        self.files.update()

    def settle(self):
        """Wait until nothing is opened, computed or written."""
        for _ in range(3):  # what ended since the last update is taken in by the next one
            self.update()
            self.wait(
                lambda: (
                    not self.session.busy and not self.files.saving and self.session.channels != ()
                )
            )

    def open(self, path):
        """Open a file and wait."""
        self.files.open(path)
        self.settle()


@pytest.fixture
def desk(tmp_path):
    """A session with files on a small sphere whose functions are known."""
    desk = Desk(Session(icosphere(2), "sphere.off"), tmp_path / "state")
    desk.settle()
    yield desk
    desk.files.close()
    desk.session.close()


@pytest.fixture
def held(monkeypatch):
    """Hold a module's function up where its arguments are such: events begun, and may end."""

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
    """Textures of streaks with as many texels as small pictures have pixels: they take as long
    as there are texels.
    """
    for name in ("TEXELS", "_TEXELS_OF_PICTURES"):
        monkeypatch.setattr(quantities, name, 512)
    monkeypatch.setattr("abfm_viewer.pictures.panels._TEXELS", 512)
