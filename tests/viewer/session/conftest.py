"""What tests of sessions share: one with files, on a small sphere."""

from __future__ import annotations

import pytest

from abfm_viewer.session.session import Session
from tests.shapes import icosphere
from tests.viewer.desk import Desk


@pytest.fixture
def desk(tmp_path):
    """A session on a small sphere whose functions are known."""
    desk = Desk(Session(icosphere(2), "sphere.off"), tmp_path / "state")
    desk.settle()
    yield desk
    desk.files.close()
    desk.session.close()
