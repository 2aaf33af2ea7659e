"""Linear optical flow: what is linear in it, units, and where it holds."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from abfm import AbfmError, TriangleMesh
from abfm.baselines import horn_schunck
from tests.core.sequences.films import SPHERE, coordinates, off, turning
from tests.core.surfaces import last_order
from tests.messages import raises
from tests.shapes import icosphere


def test_small_rotations_are_found_and_better_on_finer_meshes():
    errors = []
    for level in (2, 3, 4):
        mesh = icosphere(level)
        frames, wanted = turning(mesh, 0.01, 2, coordinates)
        field = horn_schunck(mesh, *frames, smoothness=1e-6)
        errors.append(off(mesh, field, wanted, frames[0]))
    assert last_order(errors) > 1.0
    assert errors[2] < 0.05


def test_large_ones_are_not():
    near, far = (
        off(SPHERE, horn_schunck(SPHERE, *frames, smoothness=1e-6), wanted, frames[0])
        for frames, wanted in (turning(SPHERE, angle, 2, coordinates) for angle in (0.05, 1.2))
    )
    assert far > 2 * near


def test_lengths_time_and_values_are_only_units():
    frames, _ = turning(SPHERE, 0.02, 2)
    usual = horn_schunck(SPHERE, *frames)
    large = TriangleMesh(50 * SPHERE.vertices, SPHERE.faces)
    assert_allclose(horn_schunck(large, *frames), 50 * usual, rtol=1e-6, atol=1e-9)
    assert_allclose(horn_schunck(SPHERE, *frames, 0.25), 4 * usual, rtol=1e-9)
    assert_allclose(horn_schunck(SPHERE, *(1e3 * frames - 5)), usual, rtol=1e-5, atol=1e-9)
    assert_allclose(horn_schunck(SPHERE, *frames[::-1]), -usual, rtol=1e-9, atol=1e-12)


def test_channels_add_up():
    frames, _ = turning(SPHERE, 0.01, 2)
    one = horn_schunck(SPHERE, *frames, smoothness=0.1)
    twice = horn_schunck(SPHERE, *np.stack([frames, frames], axis=-1), smoothness=0.2)
    assert_allclose(twice, one, rtol=1e-6, atol=1e-12)


def test_still_frames_have_no_motion():
    f = SPHERE.vertices[:, 0]
    assert_allclose(horn_schunck(SPHERE, f, f), 0, atol=1e-15)
    assert_allclose(horn_schunck(SPHERE, 0 * f, 0 * f), 0, atol=1e-15)


@pytest.mark.parametrize(
    ("given", "named"),
    [
        ({"duration": 0}, ("duration", 0)),
        ({"smoothness": np.nan}, ("smoothness",)),
        ({"g": np.zeros((642, 2))}, ()),
    ],
)
def test_what_does_not_fit_is_told(given, named):
    values = {"f": np.zeros(642), "g": np.zeros(642)} | given
    with raises(AbfmError, *named):
        horn_schunck(SPHERE, **values)
