"""What a launch that ended badly left: it is offered, and stays or goes as the user says."""

from __future__ import annotations

from contextlib import nullcontext
from types import SimpleNamespace

import pytest

from abfm_viewer.automation import Driver, driver
from abfm_viewer.files.project import save_project
from tests.shapes import icosphere
from tests.viewer.sessions import SIZE, opened


@pytest.mark.parametrize(("answer", "is_kept"), [("Later", True), ("Discard", False)])
def test_a_copy_is_kept_or_discarded(tmp_path, monkeypatch, answer, is_kept):
    session = opened()
    copy = tmp_path / "autosave-999999999.abfm"  # more than processes are counted to
    save_project(copy, session.document, {})
    session.close()
    monkeypatch.setattr(driver, "tempfile", SimpleNamespace(TemporaryDirectory=lambda: nullcontext(str(tmp_path))))
    with Driver(icosphere(1), size=SIZE) as gui:
        gui.wait(lambda _: gui.window.dialogs.is_asking("Recover unsaved work?"))
        gui.click(answer)
        gui.wait(lambda _: not gui.window.dialogs.is_open)
        assert copy.exists() == is_kept
        assert gui.session.document.name == "mesh"
        assert not gui.errors
