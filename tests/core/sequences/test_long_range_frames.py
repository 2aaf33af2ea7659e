"""Which of several fields between two frames is taken: a pattern of period 90 degrees that turns
back by 20, or on by 70.
"""

import numpy as np
import pytest

from abfm.calculus.vector_fields import to_frame
from abfm.sequences import defaults
from abfm.sequences.frames import check_frames
from abfm.sequences.solving import solve
from abfm.sequences.solving.interval import Interval
from tests.shapes import icosphere

SPHERE = icosphere(4)


def pattern(points, degrees):
    x, y, _ = points.T
    return np.cos(4 * (np.arctan2(y, x) - np.radians(degrees))) * (x**2 + y**2) ** 2


def turn(mesh, degrees):
    """The field (F, 2) that turns the sphere, made of unit area, by so much in a unit of time."""
    centres = mesh.vertices[mesh.faces].mean(axis=1)
    return to_frame(mesh, np.radians(degrees) * np.cross([0.0, 0.0, 1.0], centres))


class Turned:
    """A solver of which the first interval is known, and points of fields of the second."""

    def __init__(self):
        frames = np.array([pattern(SPHERE.vertices, degrees) for degrees in (0, 20, 0)])
        rng = np.random.default_rng(0)
        frames += 0.02 * frames.std() * rng.standard_normal(frames.shape)  # it is measured
        film = check_frames(SPHERE, frames, None, None, None)
        self.solver = solve.SequenceSolver(film, defaults(order=1, alpha=1, sigma=0.3), 0.0)
        interval, mesh = self.solver._interval(1, [0]), self.solver.energy(1).mesh
        sigma = self.solver._sigmas(1)[0]
        fields = [turn(mesh, degrees) for degrees in (0, -20, 70)]
        self.still, self.back, self.on = (interval.minimise(sigma, field, 0) for field in fields)
        self.solver.fields[0] = turn(mesh, 20)

    def found(self, monkeypatch, from_no_motion):
        """Solve where the field before leads to no motion, and what looks further turns on."""
        patch = monkeypatch.setattr
        patch(Interval, "find", lambda *given: from_no_motion if given[-1] is None else self.still)
        patch(solve, "long_range_field", lambda energy: self.on.field)
        points = {id(self.on.field): self.on}
        patch(Interval, "go_on", lambda self_, sigma, x, *_: points.get(id(x), self.still))
        return self.solver.initial_point(1)


@pytest.fixture
def turned():
    return Turned()


def test_what_is_near_is_looked_for_anew_before_what_is_far_is_taken(turned, monkeypatch):
    assert turned.back.energy < 2 * turned.on.energy < turned.still.energy
    assert turned.found(monkeypatch, turned.back) is turned.back
    assert turned.solver.failed_searches == 0


def test_what_is_far_is_taken_where_nothing_near_comes_as_close(turned, monkeypatch):
    assert turned.found(monkeypatch, turned.still) is turned.on
    assert turned.solver.failed_searches == 0


def test_what_is_far_is_not_taken_where_flow_lines_do_not_carry_it_there(turned, monkeypatch):
    source = turned.solver.energy(1).functions.source
    monkeypatch.setattr(
        solve, "advection_defect", lambda energy, field: turned.on.at.advected - source
    )
    assert turned.found(monkeypatch, turned.still) is turned.still
    assert turned.solver.failed_searches == 1
