"""Shares of fields that data determine: analytic cases, and invariances of those of a match."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.testing import assert_allclose

import abfm
from abfm.calculus.vector_fields import to_frame
from abfm.matching.judging.determined import determined_shares
from tests.shapes import icosphere

LEFT = np.linspace(0, 1, 21)
X, Y = (side.ravel() for side in np.meshgrid(LEFT, LEFT))
WAVE = 40 * np.sin(8 * np.pi * X)
ACROSS, ALONG = np.array([0.1, 0.0, 0.0]), np.array([0.0, 0.1, 0.0])


@cache
def square():
    corner = (np.arange(20)[:, None] * 21 + np.arange(20)).ravel()
    faces = np.concatenate([corner[:, None] + [0, 1, 22], corner[:, None] + [0, 22, 21]])
    return abfm.TriangleMesh(np.stack([X, Y, 0 * X], axis=1), faces)


def shares(motion, *channels, mask=None):
    mesh = square()
    moved = to_frame(mesh, np.tile(motion, (len(mesh.faces), 1)))[None]
    functions = np.stack(channels, axis=1)[None, None]
    return determined_shares(mesh, moved, functions, mask)[0]


def test_flat_functions_determine_nothing():
    assert_allclose(shares(ACROSS, np.full(len(X), 3.0)), 0, atol=1e-9)


def test_plane_wave_determines_the_normal_component():
    slopes = np.abs(np.cos(8 * np.pi * X)[square().faces].mean(axis=1)) > 0.5
    assert shares(ACROSS, WAVE)[slopes].min() > 0.99
    assert_allclose(shares(ALONG, WAVE), 0, atol=1e-9)
    half = shares(ACROSS + ALONG, WAVE)
    assert_allclose(half[slopes], 0.5, atol=0.01)


def test_two_independent_channels_determine_all():
    for motion in (ACROSS, ALONG, ACROSS - ALONG):
        assert shares(motion, 100 * X, 100 * Y).min() > 0.98


def test_share_has_the_closed_form():
    """With slope k along the motion, the share is d / (1 + d) where d = (k L)^2."""
    assert_allclose(shares(ACROSS, 20 * X), 4 / 5)
    assert_allclose(shares(ACROSS, 20 * X, 40 * X), 20 / 21)


def test_masked_functions_determine_nothing():
    mask = (X < 0.5).astype(float)
    found = shares(ACROSS, 100 * X, mask=mask)
    middles = X[square().faces].mean(axis=1)
    assert_allclose(found[middles > 0.6], 0, atol=1e-9)
    assert found[middles < 0.4].min() > 0.98


SPHERE = icosphere(2)


@cache
def solved():
    f, g = (np.exp(8 * (SPHERE.vertices @ at - 1)) for at in ([1, 0, 0], [0.92, 0.39, 0]))
    return abfm.match(SPHERE, f, g, abfm.Parameters(sigma=0.1))


def changed(factor=1.0, scale=1.0, is_turned=False, is_renumbered=False):
    """Return the solved match in other units, turned in space, or with other numbers."""
    match, rng = solved(), np.random.default_rng(1)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    turn = turn * np.sign(np.linalg.det(turn)) if is_turned else np.eye(3)
    count = len(SPHERE.vertices)
    order = rng.permutation(count) if is_renumbered else np.arange(count)
    mesh = abfm.TriangleMesh(
        scale * SPHERE.vertices[order] @ turn.T, np.argsort(order)[SPHERE.faces]
    )
    functions = (factor * side[order] for side in (match.source, match.target))
    return replace(
        match,
        problem=abfm.Problem(mesh, *functions, match.parameters),
        fine_velocity=scale * match.fine_velocity @ turn.T,
        advected=factor * match.advected[order],
    )


def test_shares_of_a_match_are_near_its_functions():
    found, middles = solved().determined[0], SPHERE.vertices[SPHERE.faces].mean(axis=1)
    assert found.shape == (len(SPHERE.faces),)
    assert np.median(found[middles[:, 0] > 0.8]) > 0.9
    assert np.median(found[middles[:, 0] < 0]) < 0.02


@pytest.mark.parametrize(
    "change",
    [{"factor": -1000.0}, {"scale": 20.0}, {"is_turned": True}, {"is_renumbered": True}],
    ids=["values", "lengths", "turned", "renumbered"],
)
def test_shares_do_not_depend_on_units_or_numbers(change):
    assert_allclose(changed(**change).determined, solved().determined, atol=1e-7)


def test_landmarks_determine_the_motion_near_them():
    landmarks = np.array([[0, 40], [12, 12]])
    found = abfm.match(abfm.Problem(SPHERE, None, None, landmarks=landmarks)).determined[0]
    middles = SPHERE.vertices[SPHERE.faces].mean(axis=1)
    distances = np.linalg.norm(middles - SPHERE.vertices[12], axis=1)
    near, far = found[distances.argmin()], found[distances.argmax()]
    assert near > 0.8
    assert far < 0.1
