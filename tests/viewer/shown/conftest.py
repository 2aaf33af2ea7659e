"""Fixtures for tests of shown quantities: a session after its match, which no test changes."""

import pytest

from abfm_viewer.shown.shown import Shown
from tests.viewer.sessions import matched, opened, until


@pytest.fixture(scope="module")
def of_the_module():
    session = matched(opened())
    yield session
    session.close()


@pytest.fixture
def session(of_the_module):
    document = of_the_module.document
    yield of_the_module
    of_the_module.editor.document = document
    until(lambda: not of_the_module.obstacle, of_the_module)


@pytest.fixture
def watched():
    made = []

    def watch(session):
        made.append(Shown(session))
        return made[-1]

    yield watch
    for shown in made:
        shown.close()


@pytest.fixture
def shown(session, watched):
    return watched(session)
