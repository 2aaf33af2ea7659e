"""A film's match whose process ends before it does."""

import os
import signal
from dataclasses import replace

import numpy as np
import pytest

import abfm
from abfm.sequences import defaults
from abfm.sequences.frames import checked
from abfm_viewer.document.document import Document, Surface
from abfm_viewer.document.film import Film, FilmSettings
from abfm_viewer.session.film_match import FilmMatch
from tests.viewer.sessions import SPHERE, until

TURNED = [SPHERE.vertices[:, 0] * np.cos(a) + SPHERE.vertices[:, 1] * np.sin(a) for a in range(24)]
FRAMES = np.array([np.exp(2 * each) for each in TURNED])
DOCUMENT = Document(
    (Surface(SPHERE, "sphere"),),
    film=Film("waves", checked(SPHERE, FRAMES, None, None, None)),
    settings=FilmSettings(sigma=0.3, gamma=0.5),
)


@pytest.fixture(scope="module")
def whole():
    return abfm.sequence(SPHERE, FRAMES, None, defaults(sigma=0.3), 0.5)


def kill(match, last=None):
    """Kill the process of a match, another one than the last, once it has found a field."""
    before = match.found(DOCUMENT)
    until(lambda: match._worker.pid not in (None, last) and match.found(DOCUMENT) > before)
    os.kill(pid := match._worker.pid, signal.SIGKILL)
    return pid


def ended(match):
    """What a run has come to."""
    until(lambda: match._work.done())
    return match.collect()[1]


def test_a_run_goes_on_where_its_process_ended(whole):
    match = FilmMatch()
    match.start(DOCUMENT)
    kill(match)
    found = ended(match)
    np.testing.assert_allclose(found.velocity, whole.velocity, atol=1e-12)
    assert found.confirmed == whole.confirmed == 23
    match.close()


def test_what_a_run_found_that_failed_is_there_for_the_next_one(whole):
    match = FilmMatch()
    match.start(DOCUMENT)
    last = None
    for _ in range(3):
        last = kill(match, last)
    fast = match.fast(DOCUMENT)
    assert "ended 3 times" in ended(match)
    assert match.found(DOCUMENT) == 0
    other = replace(DOCUMENT, settings=FilmSettings(sigma=0.3))
    match.start(DOCUMENT)
    assert match.found(DOCUMENT) >= 3
    assert match.fast(DOCUMENT) >= fast > 0
    np.testing.assert_allclose(ended(match).velocity, whole.velocity, atol=1e-12)
    match.start(other)
    assert match.found(other) == 0
    match.cancel()
    assert ended(match).gamma == 1
    match.close()
