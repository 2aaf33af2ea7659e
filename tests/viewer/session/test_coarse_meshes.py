"""The coarser meshes that a match begins on are made while the user looks at the mesh."""

from __future__ import annotations

import pytest

from abfm_viewer.computing.match_apart import MatchApart
from abfm_viewer.document.document import Document, Surface
from abfm_viewer.session.session import Session
from tests.viewer.sessions import PAIR, SPHERE, opened, until


@pytest.fixture
def asked(monkeypatch):
    """For which meshes and numbers of levels they were made."""
    asked = []
    monkeypatch.setattr(
        MatchApart, "prepare", lambda _, mesh, parameters: asked.append((mesh, parameters.levels))
    )
    return asked


def test_they_are_made_once_for_a_mesh_and_a_number_of_levels(asked):
    session = opened()
    until(lambda: asked, session)
    for changes in ({"sigma": 0.1}, {"levels": 2}):
        session.editor.set_parameter(**changes)
        until(lambda: not session._coarse_meshes.busy)
        for _ in range(3):
            session.update()
            until(lambda: not session._coarse_meshes.busy)
    assert asked == [(SPHERE, 0), (SPHERE, 2)]
    session.close()


def test_pictures_off_the_screen_need_none(asked):
    session = Session(SPHERE, "sphere", at_once=True)
    session.restore(Document((Surface(SPHERE, "sphere"),), channels=(PAIR,)), {}, None)
    session.update()
    assert not session.obstacle
    session.update()
    assert asked == []
    session.close()
