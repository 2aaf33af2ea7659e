"""Clusters of vertices on meshes with slivers: partitions, rates, advection, energy, matches."""

from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import sparse
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import expm_multiply
from scipy.spatial.transform import Rotation

import abfm
from abfm.assets import asset_path
from abfm.calculus.operators import l2_norm, vertex_areas
from abfm.calculus.vector_fields import directional_derivative, to_ambient, to_frame
from abfm.flow.clusters import RATE_RATIO_MAX, cluster_rates, vertex_clusters
from abfm.flow.derivative import clustered_pattern, derivative_pattern
from abfm.flow.exponential import ExponentialFlow, Workspace, counted_row_products
from abfm.matching.objective.matching_energy import MatchingEnergy
from abfm.matching.solving.levels import Levels
from abfm.mesh import TriangleMesh, load_mesh
from abfm.mesh.subdivision import refined
from abfm.parameters import PAPER
from tests.core.fields import bump, wavy_field
from tests.core.surfaces import moved, renumbered
from tests.core.verification import near, taylor_order
from tests.shapes import hemisphere, icosphere, square, torus


def edge_graph(mesh, chosen=...):
    """Return the adjacency matrix of the vertices along chosen edges."""
    a, b = mesh.edges[chosen].T
    entries = np.ones(2 * len(a)), (np.append(a, b), np.append(b, a))
    return sparse.csr_array(entries, shape=(len(mesh.vertices),) * 2)


def knotted(mesh, count, gap, seed=0):
    """Return the mesh with slivers: two rings of neighbours are drawn to some vertices."""
    rng = np.random.default_rng(seed)
    size = 0.02 * mesh.length_scale / np.sqrt(len(mesh.vertices))
    vertices = mesh.vertices + size * rng.normal(size=mesh.vertices.shape)
    near = edge_graph(mesh) + sparse.eye_array(len(vertices), format="csr")
    free = near @ (near @ mesh.is_boundary_vertex) == 0
    for _ in range(count):
        i = rng.choice(np.flatnonzero(free))
        reached = np.arange(len(free)) == i
        for ring in range(1, 6):
            reached = near @ reached > 0
            if ring == 2:
                vertices[reached] = vertices[i] + gap * (vertices[reached] - vertices[i])
        free &= ~reached
    return TriangleMesh(vertices, mesh.faces)


def seamed(n, gap):
    """Return a square of n x n cells with three lines of vertices close to each other."""
    lines = square(n).vertices.reshape(n + 1, n + 1, 3).copy()
    middle = slice(n // 2 - 1, n // 2 + 2)
    lines[middle] = lines[n // 2] + gap * (lines[middle] - lines[n // 2])
    return TriangleMesh(lines.reshape(-1, 3), square(n).faces)


EVEN = {"sphere": icosphere(3), "torus": torus(40, 16), "square": square(16), "half": hemisphere(7)}
UNEVEN = {
    "knots": knotted(icosphere(3), 4, 0.01),
    "knot, boundary": knotted(square(12), 1, 0.1),
    "seam": seamed(12, 0.03),
    "human": knotted(load_mesh(asset_path("human_A.off")), 0, 1),
}
uneven = pytest.mark.parametrize("name", UNEVEN)


def singles(mesh):
    return np.arange(len(mesh.vertices))


def some_clusters(mesh, kind):
    """Return clusters: those of the mesh, random ones, or each vertex separately."""
    drawn = np.random.default_rng(0).integers(len(mesh.vertices) // 3, size=len(mesh.vertices))
    some = np.unique(drawn, return_inverse=True)[1]
    return {"joined": vertex_clusters(mesh), "random": some, "single": singles(mesh)}[kind]


def check_partition(mesh):
    """Check that labels are consecutive, clusters connected, and no rate is above the limit.

    Each cluster of several vertices contains a vertex whose own rate is above it.
    """
    clusters = vertex_clusters(mesh)
    counts = np.bincount(clusters)
    assert 1 <= counts.min() < counts.max()
    inside = np.equal(*clusters[mesh.edges].T)
    assert connected_components(edge_graph(mesh, inside))[0] == len(counts)
    rates = cluster_rates(mesh, singles(mesh))
    most = RATE_RATIO_MAX * np.median(rates)
    assert cluster_rates(mesh, clusters).max() <= most < rates.max()
    assert (np.bincount(clusters, rates > most)[counts > 1] > 0).all()


@pytest.mark.parametrize(
    "mesh", [*UNEVEN.values(), load_mesh(asset_path("human_fine_A.off"))], ids=[*UNEVEN, "fine"]
)
def test_clusters_are_connected_and_have_small_rates(mesh):
    check_partition(mesh)


def test_vertices_inside_subdivided_slivers_are_joined():
    """Clusters of subdivided slivers have rates below 5 times the median, not above 50 times."""
    mesh = refined(load_mesh(asset_path("human_A.off")), 2)
    rates = cluster_rates(mesh, singles(mesh))
    assert rates.max() > 50 * np.median(rates)
    assert cluster_rates(mesh, vertex_clusters(mesh)).max() < 5 * np.median(rates)


@settings(max_examples=15)
@given(gap=st.floats(1e-4, 0.1), count=st.integers(1, 5), seed=st.integers(0, 2**20))
def test_clusters_of_random_slivers_are_valid(gap, count, seed):
    mesh = knotted(icosphere(3), count, gap, seed)
    check_partition(mesh)
    median = np.median(cluster_rates(mesh, vertex_clusters(mesh)))
    assert gap * cluster_rates(mesh, singles(mesh)).max() > 0.5 * median


@uneven
@settings(max_examples=8)
@given(
    turn=st.tuples(*[st.floats(-3, 3)] * 3), scale=st.floats(1e-3, 1e3), seed=st.integers(0, 2**20)
)
def test_clusters_do_not_depend_on_units_or_numbering(name, turn, scale, seed):
    mesh = UNEVEN[name]
    expected, rates = vertex_clusters(mesh), cluster_rates(mesh, vertex_clusters(mesh))
    larger = moved(mesh, Rotation.from_rotvec(turn).as_matrix(), scale)
    other, vertices, _ = renumbered(mesh, seed)
    for found, same, unit in ((larger, expected, scale), (other, expected[vertices], 1)):
        pairs = np.unique(np.stack([vertex_clusters(found), same]), axis=1)
        assert pairs.shape[1] == pairs[0].max() + 1 == pairs[1].max() + 1
        np.testing.assert_allclose(unit * cluster_rates(found, same), rates, rtol=1e-5)


def clustered_operator(mesh, clusters, v):
    """Return ``P`` (clusters to vertices), ``R`` (means over clusters) and ``R D_v P``."""
    P = sparse.csr_array((np.ones(len(clusters)), (singles(mesh), clusters)))
    weighted = P.T @ sparse.diags_array(vertex_areas(mesh))
    R = sparse.diags_array(1 / weighted.sum(axis=1)) @ weighted
    return P, R, R @ directional_derivative(mesh, v) @ P


def fields(mesh, count):
    found = np.stack([to_frame(mesh, wavy_field(mesh, seed)) for seed in range(count)])
    return 0.05 * found / mesh.length_scale


@pytest.mark.parametrize("kind", ["single", "joined", "random"])
def test_rates_bound_the_rows_of_the_operator(kind):
    """A rate is at least the absolute row sum of the operator, for any directions of the field.

    Its summands are norms of the entries for both axes, since entries are linear in the field.
    """
    mesh = knotted(square(9), 1, 0.05)
    clusters = some_clusters(mesh, kind)
    found, expected = cluster_rates(mesh, clusters), 0
    for axes in np.eye(2 * len(mesh.faces)).reshape(-1, 2, len(mesh.faces), 2):
        expected += np.hypot(
            *(clustered_operator(mesh, clusters, v)[2].toarray() for v in axes)
        ).sum(axis=1)
    np.testing.assert_allclose(found, expected, rtol=1e-10)
    for angles in np.random.default_rng(1).uniform(0, 2 * np.pi, (20, len(mesh.faces))):
        D = clustered_operator(mesh, clusters, np.stack([np.cos(angles), np.sin(angles)], axis=1))[
            2
        ]
        assert (abs(D).sum(axis=1) <= found * (1 + 1e-12)).all()


@uneven
@pytest.mark.parametrize("kind", ["single", "joined", "random"])
def test_pattern_equals_the_sparse_operator(name, kind, monkeypatch):
    mesh = TriangleMesh(UNEVEN[name].vertices, UNEVEN[name].faces)
    clusters = some_clusters(mesh, kind)
    monkeypatch.setattr("abfm.flow.derivative.vertex_clusters", lambda _: clusters)
    pattern = derivative_pattern(mesh) if kind == "single" else clustered_pattern(mesh)
    v, w = (to_frame(mesh, wavy_field(mesh, seed)) for seed in (0, 1))
    P, R, D = clustered_operator(mesh, clusters, v)
    values, largest, starts = pattern.values(v), abs(D).max(), 7 * pattern.indptr.astype(int)
    # cluster numbers in the order of the pattern
    places = pattern.rank[np.unique(clusters, return_index=True)[1]]
    for entries, matrix in ((values, D), (pattern.transposed(values), D.T)):
        built = sparse.csr_array((entries.ravel(), pattern.indices.ravel(), starts))
        assert abs(built[places][:, places] - matrix).max() < 1e-12 * largest
    assert np.abs(pattern.product(values, np.ones(D.shape[0]))).max() < 1e-12 * largest

    rng = np.random.default_rng(0)
    f, x, entries = (rng.normal(size=size) for size in (len(clusters), D.shape[0], values.shape))
    near(pattern.product(values, x)[places], D @ x[places], 1e-11 * largest)
    near(pattern.restricted(f)[places], R @ f, 1e-12)
    np.testing.assert_array_equal(pattern.extended(x), P @ x[places])
    assert pattern.restricted(f) @ x == pytest.approx(f @ pattern.extended_dual(x), rel=1e-10)
    assert pattern.extended(x) @ f == pytest.approx(x @ pattern.restricted_dual(f), rel=1e-10)
    pattern.add_chain_rule(entries, gradient := np.zeros_like(v))
    assert (gradient * w).sum() == pytest.approx((entries * pattern.values(w)).sum(), rel=1e-9)


@uneven
@pytest.mark.parametrize("t", [0.0, 1.0, -3.0])
def test_clustered_flow_equals_exponential_of_scipy(name, t):
    mesh = UNEVEN[name].normalized()
    v, f = fields(mesh, 2)[1], bump(mesh, mesh.vertices[5], 0.2)
    P, R, D = clustered_operator(mesh, vertex_clusters(mesh), v)
    flow = ExponentialFlow(clustered_pattern(mesh), v, Workspace(D.shape[0]))
    trajectory = flow.forward(f, t, keep=True)
    expected = [P @ expm_multiply(-s * D, R @ f) for s in (t / 2, t)]
    within = 1e-8 * np.abs(expected).max()
    near(trajectory.end, expected[1], within)
    near(flow.span(f, np.array([t / 2, t])), expected, within)
    mu = np.random.default_rng(1).normal(size=len(f))
    dual = flow.backward(trajectory, mu, np.zeros_like(v))
    assert dual @ f == pytest.approx(mu @ trajectory.end, rel=1e-8)
    assert flow.forward(np.ones(len(f)), t).end == pytest.approx(1, abs=1e-9)


def energy(mesh, channels=1, **changes):
    """Return an energy; several channels have a mask and weights."""
    at = np.array([0, 40, 80])[:channels]
    f, g = (np.stack([bump(mesh, mesh.vertices[i], 0.2) for i in at + k], axis=1) for k in (0, 17))
    defaults = {**PAPER, "alpha": 0.05, "beta": 0.01, "sigma": 0.1, "tau": 1.3}
    p = abfm.Parameters.of(**{**defaults, **changes})
    if channels == 1:
        return MatchingEnergy(mesh, f, g, p)
    mask = 0.1 + np.random.default_rng(0).random(len(mesh.vertices))
    return MatchingEnergy(mesh, f, g, p, mask=mask, weights=[1.0, 0.0, 2.5])


@uneven
@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("segments", [1, 3])
@pytest.mark.parametrize("reach", [0.0, 0.4])
def test_gradient_is_exact(name, channels, segments, reach):
    E = energy(UNEVEN[name], channels, segments=segments).clustered()
    v = fields(UNEVEN[name], segments)

    def evaluate(x):
        found = E.objective(0.2, reach).evaluate(x)
        return found.energy, found.gradient

    assert taylor_order(evaluate, v, 1e-4 * np.random.default_rng(1).normal(size=v.shape)) >= 1.9


@uneven
def test_energy_equals_that_of_the_clustered_flow(name):
    """The energy has the mismatch of the clustered flow by SciPy, with the norms of the mesh."""
    plain, v = energy(UNEVEN[name], 3, segments=2), fields(UNEVEN[name], 2)
    E, clusters = plain.clustered(), vertex_clusters(plain.mesh)
    state = plain.functions.source.T
    for one in v:
        P, R, D = clustered_operator(E.mesh, clusters, one)
        state = P @ expm_multiply(-0.5 * E.parameters.tau * D, R @ state)
    found = E.objective(0.2).evaluate(v)
    near(found.advected, state.T, 1e-8 * np.abs(state).max())
    energies, _ = plain.measure(0.0).energies_and_derivative(found.advected, 0.2)
    assert found.mismatch == pytest.approx(sum(energies), rel=1e-12)
    assert found.regularity == plain.objective(0.2).evaluate(v).regularity
    assert (E.discretisation.size, plain.discretisation.size) == (clusters.max() + 1, len(clusters))


@pytest.mark.parametrize("name", EVEN)
def test_even_meshes_have_no_clusters(name):
    assert vertex_clusters(EVEN[name]) is None
    plain, v = energy(EVEN[name], 3, segments=2), fields(EVEN[name], 2)
    one, other = (E.objective(0.2).evaluate(v) for E in (plain, plain.clustered()))
    assert (one.energy, one.regularity) == (other.energy, other.regularity)
    np.testing.assert_array_equal(one.advected, other.advected)
    np.testing.assert_array_equal(one.gradient, other.gradient)


KNOTS = UNEVEN["knots"]
VERTEX_COUNT, CLUSTER_COUNT = len(KNOTS.vertices), vertex_clusters(KNOTS).max() + 1
F, G = (bump(KNOTS, [np.cos(angle), np.sin(angle), 0], 0.2) for angle in (0.0, 0.6))


@cache
def matched(end=None, **changes):
    """Return a match, (level, levels, vertices) of its iterates, and the count of row products.

    With ``end``, the match is cancelled at this iteration.
    """
    seen, control = [], abfm.workers.Control()

    def note(i):
        seen.append((i.level, i.levels, i.vertices))
        if i.iteration == end:
            control.cancel()

    p = abfm.Parameters.of(**changes)
    with counted_row_products() as products:
        found = abfm.match(KNOTS, F, G, p, on_iteration=note, control=control)
    return found, seen, products.count


def test_match_starts_with_clusters():
    (found, *record), (again, *other) = matched(), matched.__wrapped__()
    assert record == other
    np.testing.assert_array_equal(again.velocity, found.velocity)
    seen, products = record
    assert seen == sorted(seen)
    assert (seen[0], seen[-1]) == (
        (0, 2, CLUSTER_COUNT),
        (0, 2, CLUSTER_COUNT),
    )  # no finer level is needed
    assert set(matched(goal=0.01, refine=0)[1]) == {(0, 2, CLUSTER_COUNT), (1, 2, VERTEX_COUNT)}
    cut = matched(end=12)[0]
    assert (cut.stop_reason, len(cut.energy_history)) == ("cancelled", 13)
    for match in (found, cut):
        error = l2_norm(KNOTS, abfm.advect(KNOTS, match.velocity[0], F, 1.0) - G)
        assert match.mismatch == pytest.approx(error / l2_norm(KNOTS, G), rel=1e-4)
    plain, _, more = matched(levels=1)
    assert max(found.residual, plain.residual) < 0.05
    assert products < 0.5 * more


@pytest.mark.parametrize(
    "changes", [{"levels": 1}, {"gradient": "bracket"}, {"method": "linearised"}]
)
def test_some_matches_have_no_clusters(changes):
    assert {of_one[1:] for of_one in matched(iterations=3, **changes)[1]} == {(1, VERTEX_COUNT)}


def test_clusters_are_a_level_before_the_mesh():
    E, x = MatchingEnergy(KNOTS, F, G, abfm.Parameters.of(levels=2)), fields(KNOTS, 1)
    found = Levels.of_mesh(E).with_coarser().all
    assert [level.energy.discretisation.size for level in found] == [
        VERTEX_COUNT // 4,
        CLUSTER_COUNT,
        VERTEX_COUNT,
    ]
    assert found[1].fields_to_finer(x) is x
    near(found[1].fields_from_finer(to_ambient(E.mesh, x)), x, 1e-12)
    few, many = (level.energy.flow(x).exponent for level in found[1:])
    iterations = [level.affordable_iterations(1000, x) for level in found]
    assert iterations == [1000, 1000, int(2000 * few / many)]
    assert found[2].affordable_iterations(1000, 0 * x) == 1000
    assert found[2].affordable_iterations(2, x) == 2
