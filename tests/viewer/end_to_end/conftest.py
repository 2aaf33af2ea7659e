"""The app on a small mesh, driven by mouse and keyboard events, and a record of which widgets the tests used."""

from __future__ import annotations

from dataclasses import replace

import pytest

from abfm_viewer.automation import Driver
from abfm_viewer.automation.widget_search import WidgetSearch
from abfm_viewer.widgets.toolkit import Ui
from tests.shapes import ellipsoid
from tests.viewer.end_to_end.widget_coverage import Coverage
from tests.viewer.sessions import ENDLESS

EGG = ellipsoid(3, 1.0, 0.7, 0.55)
SIZE = (860, 600)  # drawing takes as long as there are pixels


@pytest.fixture(scope="session", autouse=True)
def coverage():
    """What the window showed and what was used of it, over all tests of this folder."""
    record = Coverage()
    find, end_frame = WidgetSearch.find, Ui.end_frame

    def recorded_find(self, *args, **options):
        widget = find(self, *args, **options)
        record.use(widget)
        return widget

    def recorded_end_frame(self):
        end_frame(self)
        record.see(self.widgets)

    patch = pytest.MonkeyPatch()
    patch.setattr(WidgetSearch, "find", recorded_find)
    patch.setattr(Ui, "end_frame", recorded_end_frame)
    yield record
    patch.undo()


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
