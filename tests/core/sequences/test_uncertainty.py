from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import abfm
from abfm.calculus.operators import face_areas, face_frames, gradient
from abfm.sequences import defaults
from abfm.sequences.uncertainty import _data_tensors, _Integrals
from tests.core.sequences.known_motions import SPHERE, coordinates, rotating_pattern

SETTINGS = defaults(sigma=0.3, alpha=1.0, order=1)


@cache
def solved(noise=0.0):
    frames, expected = rotating_pattern(SPHERE, 0.1, 4)
    rng = np.random.default_rng(0)
    given = frames + noise * frames.std() * rng.standard_normal(frames.shape)
    parameters = defaults(sigma=0.9 if noise > 0.2 else 0.3, alpha=1.0, order=1)
    return abfm.sequence(SPHERE, given, parameters=parameters), expected


@cache
def with_a_bump():
    """Return a sequence of a bump on the equator that rotates about z; elsewhere it is flat."""
    angles = 0.1 * np.arange(4)
    places = np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=1)
    return abfm.sequence(SPHERE, np.exp(8 * (places @ SPHERE.vertices.T - 1)), parameters=SETTINGS)


@pytest.mark.parametrize("noise", [0.0, 0.1, 0.3])
def test_errors_are_about_as_large_as_the_uncertainty(noise):
    found, expected = solved(noise)
    errors = np.linalg.norm(found.velocity - expected, axis=2)
    assert 0.2 < np.median(errors / found.uncertainty) < 1.5
    assert (errors < 3 * found.uncertainty).mean() > 0.9
    # rank correlation of errors and uncertainty
    order = np.argsort(found.uncertainty.ravel())
    low, high = np.array_split(errors.ravel()[order], 2)
    assert np.median(high) > np.median(low)


def test_uncertainty_grows_with_noise_and_fewer_frames():
    low, medium, high = (solved(noise)[0].speed_uncertainty.mean() for noise in (0.0, 0.1, 0.3))
    assert low < medium < high < np.inf
    separate = replace(solved(0.3)[0], gamma=0.0)
    assert separate.speed_uncertainty.mean() > high


def test_flat_places_are_not_determined():
    found = with_a_bump()
    middles = SPHERE.vertices[SPHERE.faces].mean(axis=1)
    near, far = middles[:, 0] > 0.9, middles[:, 0] < 0
    assert np.median(found.determined[:, near]) > 0.8
    assert np.median(found.determined[:, far]) < 0.02
    assert found.uncertainty[:, far].min() > 2 * np.median(found.uncertainty[:, near])
    # the uncertainty of undetermined places is about the speed of determined ones
    truth = 0.1 * np.hypot(middles[:, 0], middles[:, 1])
    assert np.median(found.uncertainty[0, far]) > 0.3 * np.median(truth[far])


def test_motion_along_contours_is_less_determined():
    z = SPHERE.vertices[:, 2]
    frames = np.stack([np.sin(5 * np.tanh(np.arctanh(0.999 * z) - 0.04 * t)) for t in range(3)])
    found = abfm.sequence(SPHERE, frames, parameters=SETTINGS)
    slopes = (gradient(SPHERE) @ frames[1]).reshape(-1, 2)
    sizes = np.linalg.norm(slopes, axis=1, keepdims=True)
    steep = sizes[:, 0] > np.median(sizes)
    across = slopes / sizes
    along = np.stack([-across[:, 1], across[:, 0]], axis=1)
    by_axis = [
        np.sqrt(np.einsum("fx,fxy,fy->f", axis, found.covariances[1], axis)[steep])
        for axis in (across, along)
    ]
    assert np.median(by_axis[1] / by_axis[0]) > 1.5


def test_more_channels_determine_all_directions():
    frames, _ = rotating_pattern(SPHERE, 0.1, 3, coordinates)
    assert abfm.sequence(SPHERE, frames, parameters=SETTINGS).determined.min() > 0.7


def test_covariances_are_tensors_of_the_tangent_plane():
    found = solved(0.1)[0]
    covariances = found.covariances
    assert covariances.shape == (3, len(SPHERE.faces), 2, 2)
    assert_allclose(covariances, covariances.swapaxes(2, 3))
    assert np.linalg.eigvalsh(covariances).min() > 0
    order = np.random.default_rng(1).permutation(len(SPHERE.vertices))
    mesh = abfm.TriangleMesh(SPHERE.vertices[order], np.argsort(order)[SPHERE.faces])
    there = replace(found, _frames=replace(found._frames, mesh=mesh, values=found.frames[:, order]))
    turned = np.einsum("fax,fby->fabxy", face_frames(mesh), face_frames(SPHERE))
    turned = np.einsum("fabxx->fab", turned)
    expected = np.einsum("fab,ifbc,fdc->ifad", turned, covariances, turned)
    assert_allclose(there.covariances, expected, rtol=1e-6, atol=1e-12)


def test_constant_frames_are_uncertain_and_equal_ones_certain():
    constant = abfm.sequence(SPHERE, np.ones((3, len(SPHERE.vertices))), parameters=SETTINGS)
    assert np.isinf(constant.uncertainty).all()
    assert_array_equal(constant.determined, 0)
    still = np.repeat(rotating_pattern(SPHERE, 0.1, 1)[0], 3, axis=0)
    found = abfm.sequence(SPHERE, still, parameters=SETTINGS)
    assert_array_equal(found.uncertainty, 0)
    assert found.speed_determined.min() > 0.9


def test_masked_places_are_not_determined():
    hidden = SPHERE.vertices[:, 0] > 0.5
    frames = solved()[0].frames[:, :, 0]
    found = abfm.sequence(SPHERE, frames, parameters=SETTINGS, mask=~hidden)
    middles = SPHERE.vertices[SPHERE.faces].mean(axis=1)
    assert found.determined[:, middles[:, 0] > 0.85].max() < 0.5
    assert np.median(found.determined[:, middles[:, 0] < 0]) > 0.8


def test_integrals_equal_those_of_the_plane():
    """The number of determined modes and the scatter equal integrals over modes of the plane.

    For one interval, the norm of order 1, data of precision d, and K = 4 pi V, these are
    ``d / (4 pi) log((1 + K + d) / (1 + d))`` and ``d / (4 pi) (1 / (1 + d) - 1 / (1 + K + d))``.
    """
    found = replace(solved()[0], gamma=0.0)
    integrals, k = _Integrals.of(found), 4 * np.pi * len(SPHERE.vertices)
    for d in (1e-9, 0.3, 50.0, 1e7):
        expected = d / (4 * np.pi) * np.log((1 + k + d) / (1 + d))
        assert integrals.modes(np.array([[d]]))[0, 0] == pytest.approx(expected, rel=1e-2)
        square = d / (4 * np.pi) * (1 / (1 + d) - 1 / (1 + k + d))
        assert integrals.scatter(np.array([[d]]))[0, 0] == pytest.approx(square, rel=1e-2)


def test_shares_equal_those_of_the_linear_problem():
    """The integral of ``tr D`` over the surface is ``int |grad f|^2 / sigma^2``."""
    found = solved()[0]
    eigenvalues, _ = _data_tensors(found, np.arange(len(found)))
    areas = face_areas(SPHERE.normalized())
    traces = np.einsum("f,ifk->i", areas, eigenvalues)
    mesh, sigma = SPHERE.normalized(), 0.3 * found._frames.deviation
    for i, trace in enumerate(traces):
        slopes = (gradient(mesh) @ found.frames[i + 1, :, 0]).reshape(-1, 2)
        assert trace == pytest.approx(areas @ (slopes**2).sum(axis=1) / sigma**2, rel=0.1)
