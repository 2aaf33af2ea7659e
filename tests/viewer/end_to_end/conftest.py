"""The app on a small mesh, driven by mouse and keyboard events."""

from __future__ import annotations

from dataclasses import replace

import pytest

from abfm_viewer.automation import Driver
from tests.shapes import ellipsoid
from tests.viewer.sessions import ENDLESS

EGG = ellipsoid(3, 1.0, 0.7, 0.55)
SIZE = (640, 480)  # drawing takes as long as there are pixels


@pytest.fixture(scope="module", autouse=True)
def _recorded(request):
    with request.config.pluginmanager.get_plugin("widget coverage").recording():
        yield


@pytest.fixture
def gui(tmp_path):
    """The app on an egg with its default functions."""
    with Driver(EGG, size=SIZE) as gui:
        gui.window.dialogs.folder = tmp_path
        yield gui
        assert not gui.errors


@pytest.fixture
def matched(gui):
    """The app after a short run."""
    gui.session.amend(parameters=replace(gui.session.parameters, iterations=20, cooling_stages=1))
    gui.click("Match")
    gui.wait(lambda s: s.solver.finished)
    return gui


@pytest.fixture
def running(gui):
    """The app during a run that does not end by itself."""
    gui.session.amend(parameters=ENDLESS)
    gui.click("Match")
    gui.wait(lambda s: s.solver.snapshot is not None)
    return gui
