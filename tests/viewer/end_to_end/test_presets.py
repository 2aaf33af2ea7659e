"""The menu Presets: every figure of the paper opens ready to match."""

from __future__ import annotations

import time

import numpy as np
import pytest

from abfm.experiments import FIGURES, TITLES, experiment_of
from abfm_viewer.automation import Driver
from tests.shapes import icosphere
from tests.viewer.sessions import SIZE


@pytest.fixture(scope="module")
def presets():
    with Driver(icosphere(1), size=SIZE) as driver:
        yield driver


def wait(gui, condition, seconds=60):
    """Wait with few frames: they take the time of what is computed."""
    end = time.monotonic() + seconds
    while not condition(gui.session):
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.1)
        gui.frames(1)


@pytest.mark.parametrize("figure", FIGURES)
def test_a_figure_is_ready_to_match(presets, figure):
    setup = experiment_of(figure).set_up(None, False)
    presets.menu("Presets", f"Figure {figure}: {TITLES[figure]}")
    wait(presets, lambda session: session.notice.text.startswith(f"figure {figure} is ready"))  # is gone after a while
    wait(presets, lambda session: session.mesh.vertices.shape == setup.mesh.vertices.shape and not session.obstacle)
    session = presets.session
    np.testing.assert_array_equal(session.mesh.vertices, setup.mesh.vertices)
    assert session.parameters == setup.parameters
    values = np.stack([session.functions.evaluate(channel.source) for channel in session.channels], axis=1)
    np.testing.assert_allclose(values, setup.source, atol=1e-12)
    values = np.stack([session.functions.evaluate(channel.target) for channel in session.channels], axis=1)
    np.testing.assert_allclose(values, setup.target, atol=1e-12)
    assert not session.unsaved
    assert (session.result is None) == (setup.flow is None)
    if setup.flow is not None:
        np.testing.assert_array_equal(session.result.velocity, setup.flow.velocity)
    assert presets.errors == {}
