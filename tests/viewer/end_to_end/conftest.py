"""Fixtures: the app on a small mesh, driven by mouse and keyboard events."""

import pytest

from tests.spare_processes import reused_processes
from tests.viewer.sessions import ENDLESS, SHORT, begin, drawn_texts, match


@pytest.fixture(scope="module", autouse=True)
def _recorded(request):
    with request.config.pluginmanager.get_plugin("widget coverage").recording():
        yield


@pytest.fixture(scope="module", autouse=True)
def _shared_processes():
    with reused_processes():
        yield


@pytest.fixture
def matched(gui):
    gui.session.editor.amend(parameters=SHORT)
    match(gui)
    return gui


@pytest.fixture
def running(gui):
    """Return the app during a run that continues until it is cancelled."""
    gui.session.editor.amend(parameters=ENDLESS)
    begin(gui)
    return gui


@pytest.fixture
def notes(gui, monkeypatch):
    """Return a function that draws a frame and returns its texts and their tones."""
    return drawn_texts(gui, monkeypatch, "note")
