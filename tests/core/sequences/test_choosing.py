import numpy as np
import pytest

import abfm
from abfm import AbfmError, Parameters, TriangleMesh
from abfm.sequences import SequenceCheckpoint, SequenceParameters, defaults
from abfm.sequences.solving.choosing import NORMS, Norm, norms
from tests.core.sequences.known_motions import rotating_pattern
from tests.messages import raises
from tests.shapes import icosphere

BALL = icosphere(2)
FRAMES = rotating_pattern(BALL, 0.1, 3)[0]


@pytest.fixture(scope="module")
def found():
    return abfm.sequence(BALL, FRAMES)


def choice(sequence):
    return sequence.parameters.order, sequence.parameters.alpha, sequence.sigma


def test_smooth_motion_gets_the_smoother_norm(found):
    assert choice(found)[0] == 2
    assert found.parameters.automatic == ("alpha", "order")
    assert found.parameters.sigma is None
    assert "chosen by held-out data: alpha, order, sigma" in found.settings
    match = found[0].problem.parameters
    assert (match.solver.order, match.alpha) == choice(found)[:2]
    assert type(match) is Parameters


@pytest.mark.parametrize(
    ("length", "value", "shift", "time"), [(7, 1, 0, 1), (1, 1e4, -5, 1), (1, 1, 0, 250)]
)
def test_units_do_not_change_the_choice(found, length, value, shift, time):
    mesh = TriangleMesh(length * BALL.vertices, BALL.faces)
    other = abfm.sequence(mesh, value * FRAMES + shift, time * np.arange(3.0))
    assert choice(other) == choice(found)


def test_given_values_are_used():
    assert norms(defaults()) == list(NORMS)
    assert norms(defaults(order=1)) == [Norm(1, 1.0)]
    assert norms(defaults(alpha=0.5)) == [Norm(2, 0.5), Norm(1, 0.5)]
    assert norms(defaults(order=2, alpha=0.5)) == [Norm(2, 0.5)]
    assert defaults(alpha=None, order=None, sigma=None) == defaults()
    given_norm = abfm.sequence(BALL, FRAMES, parameters=defaults(alpha=0.5, sigma=0.3))
    assert given_norm.parameters.alpha == 0.5
    assert given_norm.sigma == 0.3
    assert given_norm.parameters.automatic == ("order",)


def test_only_the_norm_can_be_automatic():
    with raises(AbfmError, "beta"):
        SequenceParameters(automatic=("beta",))


def test_resumed_run_keeps_the_choice(found, tmp_path):
    class KilledError(Exception):
        pass

    def kill(interval):
        raise KilledError

    class AtOnce(SequenceCheckpoint):
        def save(self, solver, force=True):
            super().save(solver)

    with pytest.raises(KilledError):
        abfm.sequence(
            BALL,
            FRAMES,
            checkpoint=AtOnce(tmp_path / "s.npz"),
            on_interval=lambda i: kill(i) if i else None,
        )
    tasks = set()
    with abfm.workers.progress.reporting_steps(lambda step: tasks.add(step and step.task)):
        again = abfm.sequence(BALL, FRAMES, checkpoint=SequenceCheckpoint(tmp_path / "s.npz"))
    assert "choosing sigma" not in tasks
    assert again.parameters == found.parameters
    np.testing.assert_array_equal(again.velocity, found.velocity)
