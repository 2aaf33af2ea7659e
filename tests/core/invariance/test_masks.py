"""Values at vertices with mask 0 do not change a bit of any result."""

import numpy as np
import pytest
from numpy.testing import assert_array_equal

import abfm
from abfm import Parameters, TriangleMesh
from abfm.functions import quoted
from tests.core.fields import bump
from tests.shapes import icosphere

MESH = icosphere(3)
COUNT = len(MESH.vertices)
HIDDEN = MESH.vertices[:, 0] < -0.4
MASK = np.where(HIDDEN, 0.0, 1.0)
F, G = (bump(MESH, place, 0.25) for place in ([0, 0, 1], [0, 0.6, 0.8]))
BRIEF = Parameters.of(iterations=25, refine=0, levels=1)


def noise(size, seed=0):
    return size * np.random.default_rng(seed).normal(size=COUNT)


REPLACEMENTS = {
    "NaN": np.full(COUNT, np.nan),
    "infinite": np.full(COUNT, -np.inf),
    "huge": np.full(COUNT, 1e300),
    "noise": noise(0.3),
    "large noise": noise(1e3),
    "tiny": np.full(COUNT, 1e-300),
}


def spoiled(values, kind):
    """Return values with other values where the mask is 0."""
    return np.where(HIDDEN, REPLACEMENTS[kind], values)


def assert_same(one, other):
    for name in ("velocity", "source", "target", "advected", "energy_history"):
        assert_array_equal(getattr(one, name), getattr(other, name))
    assert one.verdict == other.verdict
    assert (one.residual, one.verified_residual) == (other.residual, other.verified_residual)


@pytest.fixture(scope="module")
def matched():
    return abfm.match(MESH, F, G, BRIEF, mask=MASK)


@pytest.mark.parametrize("kind", REPLACEMENTS)
def test_match_ignores_values_below_the_mask(matched, kind):
    assert_same(matched, abfm.match(MESH, spoiled(F, kind), spoiled(G, kind), BRIEF, mask=MASK))


def test_refined_match_ignores_values_below_the_mask():
    one, other = (
        abfm.match(MESH, *pair, Parameters.of(iterations=60), mask=MASK)
        for pair in ((F, G), (spoiled(F, "noise"), spoiled(G, "large noise")))
    )
    assert_same(one, other)


def test_hidden_values_of_files_may_be_unknown(matched, tmp_path):
    np.save(tmp_path / "f.npy", spoiled(F, "NaN"))
    spec = f"file:{quoted(str(tmp_path / 'f'))}.npy"
    assert_same(matched, abfm.match(MESH, spec, G, BRIEF, mask=MASK))


def test_visible_values_must_be_finite():
    f = F.copy()
    f[np.flatnonzero(~HIDDEN)[0]] = np.inf
    with pytest.raises(abfm.FunctionError):
        abfm.match(MESH, f, G, BRIEF, mask=MASK)


def test_hidden_values_are_harmonic():
    """Values below the mask are harmonic: the mean of their neighbours, so they add no peaks."""
    problem = abfm.Problem(MESH, spoiled(F, "noise"), G, mask=MASK)
    filled = problem.source[:, 0]
    assert_array_equal(filled[~HIDDEN], F[~HIDDEN])
    around = [filled[MESH.edges[(MESH.edges == v).any(axis=1)]] for v in np.flatnonzero(HIDDEN)]
    for v, ends in zip(np.flatnonzero(HIDDEN), around, strict=True):
        neighbours = ends.sum(axis=1) - filled[v]
        assert neighbours.mean() == pytest.approx(filled[v], abs=1e-12)


@pytest.mark.parametrize("kind", ["NaN", "noise", "huge"])
def test_registration_ignores_values_below_the_mask(kind):
    rough = F + noise(0.1, 1), G + noise(0.1, 2)
    given = {"parameters": BRIEF, "initial": "connectivity", "mask_a": MASK, "mask_b": MASK}
    hidden, other = [spoiled(values, kind) for values in rough], (MESH.vertices, MESH.faces)
    clean, on_a, on_b = (
        abfm.register(MESH, TriangleMesh(*other), f, g, **given)
        for f, g in (rough, (hidden[0], rough[1]), (rough[0], hidden[1]))
    )
    for other in (on_a, on_b):
        assert_same(clean.match, other.match)
        assert_array_equal(clean.functions, other.functions)
        assert clean.notes == other.notes
