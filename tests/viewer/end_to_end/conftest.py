"""The app on a small mesh, driven by mouse and keyboard events."""

from __future__ import annotations

from dataclasses import replace

import pytest

from tests.viewer.sessions import ENDLESS


@pytest.fixture(scope="module", autouse=True)
def _recorded(request):
    with request.config.pluginmanager.get_plugin("widget coverage").recording():
        yield


@pytest.fixture
def matched(gui):
    """The app after a short run."""
    gui.session.editor.amend(
        parameters=replace(gui.session.parameters, iterations=20, cooling_stages=1)
    )
    gui.click("Match")
    gui.wait(lambda s: s.solver.finished)
    return gui


@pytest.fixture
def running(gui):
    """The app during a run that does not end by itself."""
    gui.session.editor.amend(parameters=ENDLESS)
    gui.click("Match")
    gui.wait(lambda s: s.solver.snapshot is not None)
    return gui
