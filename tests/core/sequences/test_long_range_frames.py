"""The choice between short-range and long-range fields.

A pattern with a period of 90 degrees rotates back by 20 or forward by 70 degrees.
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


def rotation(mesh, degrees):
    """Return the field (F, 2) that rotates the sphere of unit area by an angle per unit of time."""
    centres = mesh.vertices[mesh.faces].mean(axis=1)
    return to_frame(mesh, np.radians(degrees) * np.cross([0.0, 0.0, 1.0], centres))


class RotatedPattern:
    """A solver with a known first interval, and fields of the second interval."""

    def __init__(self):
        frames = np.array([pattern(SPHERE.vertices, degrees) for degrees in (0, 20, 0)])
        rng = np.random.default_rng(0)
        # with noise, the functions count as measured ones
        frames += 0.02 * frames.std() * rng.standard_normal(frames.shape)
        checked = check_frames(SPHERE, frames, None, None, None)
        self.solver = solve.SequenceSolver(checked, defaults(order=1, alpha=1, sigma=0.3), 0.0)
        interval, mesh = self.solver._interval(1, [0]), self.solver.energy(1).mesh
        sigma = self.solver._sigmas(1)[0]
        fields = [rotation(mesh, degrees) for degrees in (0, -20, 70)]
        self.still, self.back, self.on = (interval.minimise(sigma, field, 0) for field in fields)
        self.solver.fields[0] = rotation(mesh, 20)

    def found(self, monkeypatch, from_no_motion):
        """Return the initial point of the second interval, with a simulated search.

        Without a start the result is the given field; in the search it is `on`, else
        `still`.
        """
        patch = monkeypatch.setattr
        patch(
            Interval,
            "minimise_by_cooling",
            lambda *given: from_no_motion if given[-1] is None else self.still,
        )
        patch(solve, "long_range_field", lambda energy: self.on.field)
        points = {id(self.on.field): self.on}
        patch(Interval, "minimise", lambda self_, sigma, x, *_: points.get(id(x), self.still))
        return self.solver.initial_point(1)


@pytest.fixture
def rotated():
    return RotatedPattern()


def test_long_range_is_used_without_short_range_solution(rotated, monkeypatch):
    assert rotated.back.energy < 2 * rotated.on.energy < rotated.still.energy
    assert rotated.found(monkeypatch, rotated.back) is rotated.back
    assert rotated.found(monkeypatch, rotated.still) is rotated.on
    assert rotated.solver.failed_searches == 0


def test_long_range_without_flow_line_support_is_rejected(rotated, monkeypatch):
    source = rotated.solver.energy(1).functions.source
    monkeypatch.setattr(
        solve, "advection_defect", lambda energy, field: rotated.on.at.advected - source
    )
    assert rotated.found(monkeypatch, rotated.still) is rotated.still
    assert rotated.solver.failed_searches == 1
