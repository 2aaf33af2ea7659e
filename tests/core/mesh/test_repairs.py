"""Merging of vertices, cleaning of faces, and the choice of components, with their messages."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from abfm.errors import AbfmWarning, MeshError, ParameterError
from abfm.io import results
from abfm.mesh import TriangleMesh
from abfm.mesh.face_sizes import twice_areas
from abfm.mesh.subdivision import subdivided
from tests.messages import check_message, raises
from tests.shapes import disc, hemisphere, icosphere, open_cylinder, square, tetrahedron, torus

SPHERE = icosphere(1)
SHAPES = [SPHERE, torus(6, 5), square(3), open_cylinder(5, 2)]
shapes = st.sampled_from(SHAPES)
seeds = st.integers(0, 2**32 - 1)


def split(mesh, rng, jitter=0.0):
    """Return vertices, each with up to three copies in random order, faces, and the originals."""
    corners = np.stack([mesh.faces.ravel(), rng.integers(0, 3, mesh.faces.size)], axis=1)
    pairs, faces = np.unique(corners, axis=0, return_inverse=True)
    order = rng.permutation(len(pairs))
    was = pairs[order, 0]
    noise = rng.uniform(-1, 1, (len(was), 3)) * jitter
    return mesh.vertices[was] + noise, np.argsort(order)[faces.reshape(-1, 3)], was


def area(mesh):
    return twice_areas(mesh.vertices, mesh.faces).sum() / 2


def same_topology(mesh, other):
    names = ("genus", "is_closed", "euler_characteristic")
    loops = [len(each.boundary_loops) for each in (mesh, other)]
    return loops[0] == loops[1] and all(getattr(mesh, n) == getattr(other, n) for n in names)


@given(shape=shapes, seed=seeds, jitter=st.sampled_from([0.0, 1e-7]), power=st.integers(-9, 9))
def test_merging_undoes_splitting(shape, seed, jitter, power):
    vertices, faces, was = split(shape, np.random.default_rng(seed), jitter)
    mesh = TriangleMesh(vertices * 10.0**power, faces, merge=True)
    assert len(mesh.vertices) == len(shape.vertices)
    assert_array_equal(was[mesh.vertex_ids][mesh.faces], shape.faces)
    assert_array_equal(mesh.vertices, vertices[mesh.vertex_ids] * 10.0**power)
    first = np.unique(was, return_index=True)[1]
    assert_array_equal(mesh.vertex_ids, np.sort(first))
    assert_allclose(area(mesh), area(shape) * 100.0**power, rtol=1e-5)
    assert same_topology(mesh, shape)
    rows = np.argsort(was[mesh.vertex_ids])[was]
    assert_array_equal(mesh.local_vertices(np.arange(len(was))), rows)
    assert [mesh.local_vertex(k) for k in range(len(was))] == rows.tolist()
    values = np.random.default_rng(seed).normal(size=(len(shape.vertices), 2))[was]
    assert_array_equal(mesh.on_file(mesh.restrict(values)), values)
    again = TriangleMesh(mesh.vertices, mesh.faces, merge=True)
    assert_array_equal(again.faces, mesh.faces)
    assert len(again.copies) == 0


@given(shape=shapes)
def test_valid_mesh_is_not_changed(shape):
    mesh = TriangleMesh(shape.vertices, shape.faces, merge=True, clean=True, largest_component=True)
    assert mesh.messages == ()
    assert mesh.digest == TriangleMesh(shape.vertices, shape.faces).digest


def test_merging_is_reported():
    vertices = np.concatenate([SPHERE.vertices[:1], SPHERE.vertices, SPHERE.vertices[[3]]])
    faces = SPHERE.faces + 1
    faces[np.argwhere(faces == 4)[0][0], np.argwhere(faces == 4)[0][1]] = 43
    mesh = TriangleMesh(vertices, faces, merge=True)
    check_message(mesh.messages[0], 1, 0)
    check_message(mesh.messages[1], 1, 43, 4)
    assert mesh.vertex_ids.tolist() == list(range(1, 43))
    found = mesh.on_file(np.arange(42.0))[[0, 4, 43]]
    assert found.tolist() == pytest.approx([np.nan, 3, 3], nan_ok=True)


def test_large_merge_distance_is_refused():
    shortest = float(np.linalg.norm(np.diff(SPHERE.vertices[SPHERE.edges], axis=1), axis=2).min())
    with raises(MeshError, 0.6):
        TriangleMesh(SPHERE.vertices, SPHERE.faces, merge=0.6)
    with raises(MeshError):
        TriangleMesh(SPHERE.vertices, SPHERE.faces, merge=0.7, clean=True)
    merged = TriangleMesh(SPHERE.vertices, SPHERE.faces, merge=0.99 * shortest)
    assert len(merged.vertices) == 42
    for wrong in (0.0, -1.0, np.inf, np.nan, "near"):
        with raises(ParameterError):
            TriangleMesh(SPHERE.vertices, SPHERE.faces, merge=wrong)
    with raises(ParameterError, "left"):
        TriangleMesh(SPHERE.vertices, SPHERE.faces, hemisphere="left")


def test_short_edges_are_not_merged_by_default():
    """An edge of length 1e-7 collapses only with `clean`."""
    vertices = disc(2).vertices.copy()
    vertices[1] = [1e-7, 0, 0]
    assert len(TriangleMesh(vertices, disc(2).faces, merge=True).copies) == 0
    cleaned = TriangleMesh(vertices, disc(2).faces, merge=True, clean=True)
    assert cleaned.copies.tolist() == [[1, 0]]
    assert len(cleaned.boundary_loops) == 1


def test_dense_vertices_are_refused_early():
    rng = np.random.default_rng(0)
    vertices = np.concatenate([rng.uniform(size=(20_000, 3)) * 1e-8, [[1, 0, 0], [0, 1, 0]]])
    faces = [[k, 20_000, 20_001] for k in range(20_000)]
    with raises(MeshError, "merge"):
        TriangleMesh(vertices, faces, merge=True)


def test_values_that_differ_between_copies_are_reported():
    vertices, faces, was = split(SPHERE, np.random.default_rng(0))
    mesh = TriangleMesh(vertices, faces, merge=True)
    values = was.astype(float)
    values[mesh.copies[:3, 0]] += [1.0, np.nan, 1e-9]
    with pytest.warns(AbfmWarning) as caught:
        kept = mesh.restrict(values)
    check_message(str(caught[0].message), 2, len(mesh.copies), *mesh.copies[0])
    assert_array_equal(kept, was[mesh.vertex_ids])
    values[:] = np.nan
    assert np.isnan(mesh.restrict(values)).all()  # no warning for these values


def test_copies_are_stored_in_files():
    vertices, faces, _ = split(SPHERE, np.random.default_rng(1))
    mesh = TriangleMesh(vertices, faces, merge=True)
    read = results.mesh_of(results.mesh_arrays(mesh))
    assert_array_equal(read.copies, mesh.copies)
    assert read.digest != results.mesh_of(results.mesh_arrays(SPHERE)).digest
    assert subdivided(mesh).local_vertex(mesh.copies[0, 0]) == mesh.local_vertex(mesh.copies[0, 0])
    for wrong in ([[0, 10**6]], mesh.copies[::-1], mesh.copies[:, ::-1]):
        with raises(ValueError):
            results.mesh_of(results.mesh_arrays(mesh) | {"copies": np.array(wrong)})


def with_repeated(mesh, rng):
    """Return faces of which some repeat, flipped or not, and some have a vertex twice."""
    repeats = mesh.faces[rng.integers(0, len(mesh.faces), 4)]
    repeats[::2] = repeats[::2, ::-1]
    twice = mesh.faces[:2][:, [0, 1, 0]]
    return rng.permutation(np.concatenate([mesh.faces, repeats, twice]))


@given(shape=shapes, seed=seeds)
def test_repeated_and_degenerate_faces_are_removed(shape, seed):
    faces = with_repeated(shape, np.random.default_rng(seed))
    mesh = TriangleMesh(shape.vertices, faces, clean=True)
    assert len(mesh.faces) == len(shape.faces)
    assert same_topology(mesh, shape)
    assert area(mesh) == pytest.approx(area(shape))
    kept = np.sort(faces[mesh.face_ids], axis=1)
    assert_array_equal(kept, np.sort(mesh.vertex_ids[mesh.faces], axis=1))
    assert "removed" in mesh.messages[0]


@given(shape=shapes, seed=seeds, count=st.integers(1, 3))
def test_faces_without_area_leave_no_hole(shape, seed, count):
    """Removed faces without area leave no hole between the faces that they connected.

    They connect a vertex in the middle of an edge to the face on its other side.
    """
    rng = np.random.default_rng(seed)
    inner = np.flatnonzero(~shape.is_boundary_edge)
    edge = rng.choice(inner)
    face = shape.edge_faces[edge, 0]
    corner = int(np.flatnonzero(shape.face_edges[face] == edge)[0])
    apex, a, b = np.roll(shape.faces[face], -corner)
    new = len(shape.vertices) + np.arange(count)
    chain = [a, *new, b]
    shares = np.linspace(0, 1, count + 2)[1:-1, None]
    middles = shape.vertices[a] * (1 - shares) + shape.vertices[b] * shares
    fan = [[apex, p, q] for p, q in pairwise(chain)]
    flat = [[a, q, p] for p, q in pairwise(chain[1:])]
    faces = np.concatenate([np.delete(shape.faces, face, axis=0), fan, flat])
    vertices = np.concatenate([shape.vertices, middles])
    mesh = TriangleMesh(vertices, rng.permutation(faces), clean=True)
    assert same_topology(mesh, shape)
    assert area(mesh) == pytest.approx(area(shape))
    assert len(mesh.vertices) == len(vertices)
    assert len(mesh.faces) == len(shape.faces) + 2 * count
    assert (np.diff(mesh.face_ids) >= 0).all()


def test_faces_without_area_are_reported():
    corners = [[0, 0, 0], [2, 0, 0], [1, 1, 0], [1, -1, 0], [1, 0, 0]]
    faces = [[0, 4, 2], [4, 1, 2], [0, 1, 4], [1, 0, 3]]
    with raises(MeshError, 1, 2, "--clean") as caught:
        TriangleMesh(corners, faces)
    mesh = TriangleMesh(corners, faces, **caught.value.remedies[0].options)
    check_message(mesh.messages[0], 1, 2)
    assert area(mesh) == 2
    assert mesh.face_ids.tolist() == [0, 1, 3, 3]
    assert len(mesh.boundary_loops) == 1


def test_pole_of_many_vertices_is_merged():
    cylinder = open_cylinder(8, 3)
    vertices = cylinder.vertices.copy()
    top = vertices[:, 2] == vertices[:, 2].max()
    vertices[top] = [0, 0, 3]
    mesh = TriangleMesh(vertices, cylinder.faces, clean=True)
    assert len(mesh.vertices) == len(vertices) - 7
    assert len(mesh.faces) == len(cylinder.faces) - 8
    assert len(mesh.boundary_loops) == 1
    check_message(mesh.messages[0], 7)
    check_message(mesh.messages[1], 8)
    values = np.arange(float(len(vertices)))
    values[top] = 5
    assert_array_equal(mesh.on_file(mesh.restrict(values)), values)


def fin(mesh, doubled):
    """Return the mesh with a small face attached to an edge, or with two opposite ones."""
    a, b = mesh.edges[0]
    tip = len(mesh.vertices)
    vertices = np.concatenate([mesh.vertices, [1.2 * mesh.vertices[[a, b]].mean(axis=0)]])
    faces = [[a, b, tip], [b, a, tip]][: 1 + doubled]
    return vertices, np.concatenate([faces, mesh.faces])


@pytest.mark.parametrize("doubled", [False, True])
def test_attached_sheets_are_removed(doubled):
    vertices, faces = fin(SPHERE, doubled)
    with raises(MeshError, "--clean"):
        TriangleMesh(vertices, faces)
    mesh = TriangleMesh(vertices, faces, clean=True)
    assert_array_equal(mesh.vertices, SPHERE.vertices)
    assert_array_equal(mesh.faces, SPHERE.faces)
    check_message(mesh.messages[0], 1 + doubled, 0)


def test_unsafe_cleaning_is_refused():
    """A wall inside a surface could belong to either side; a doubled sheet keeps one side."""
    half, wall = hemisphere(4), disc(4)
    parts = [half.vertices, half.vertices * [1, 1, -1], wall.vertices]
    starts = np.cumsum([0, *map(len, parts)])
    faces = [half.faces, half.faces[:, ::-1] + starts[1], wall.faces + starts[2]]
    with raises(MeshError, 24, "--clean", "Repair non Manifold Edges"):
        TriangleMesh(np.concatenate(parts), np.concatenate(faces), merge=True, clean=True)
    doubled = np.concatenate([disc(2).faces, disc(2).faces[:, ::-1]])
    mesh = TriangleMesh(disc(2).vertices, doubled, clean=True)
    assert_array_equal(mesh.faces, disc(2).faces)
    with raises(MeshError):
        TriangleMesh([[0, 0, 0], [1, 0, 0], [2, 0, 0]], [[0, 1, 2]], clean=True)


def hemispheres(swapped, axis=0):
    left = SPHERE.vertices * (1 + 0.1 * SPHERE.vertices[:, [2]])
    two = [left - 1.1 * np.eye(3)[axis], left * [-1, 1, 1] + 1.1 * np.eye(3)[axis]]
    vertices = np.concatenate(two[::-1] if swapped else two)
    return vertices, np.concatenate([SPHERE.faces, SPHERE.faces + 42])


@pytest.mark.parametrize("swapped", [False, True])
def test_hemisphere_is_chosen_by_x(swapped):
    vertices, faces = hemispheres(swapped)
    with raises(MeshError, 2, "--hemisphere") as caught:
        TriangleMesh(vertices, faces)
    assert [each.button for each in caught.value.remedies] == ["Left", "Right"]
    for remedy, sign in zip(caught.value.remedies, (-1, 1), strict=True):
        mesh = TriangleMesh(vertices, faces, **remedy.options)
        assert len(mesh.vertices) == 42
        assert np.sign(mesh.vertices[:, 0].mean()) == sign
        values = mesh.on_file(mesh.restrict(vertices[:, 0]))
        assert_array_equal(np.isnan(values), np.sign(vertices[:, 0]) != sign)
        check_message(mesh.messages[0], 42, 84)
    vertices, faces = hemispheres(swapped, axis=2)
    with raises(MeshError):
        TriangleMesh(vertices, faces, hemisphere="L")
    assert "L" not in TriangleMesh(SPHERE.vertices, SPHERE.faces, hemisphere="L").messages[0]


@pytest.mark.parametrize("scale", [1.0, 1.05])
def test_hemispheres_at_one_place_have_the_file_order(scale):
    """Spheres of both hemispheres at one place are left and right in the order of the file."""
    both = SPHERE.vertices, scale * SPHERE.vertices
    vertices, faces = np.concatenate(both), np.concatenate([SPHERE.faces, SPHERE.faces + 42])
    with raises(MeshError, 2, "--hemisphere L", "first", "--hemisphere R", "second") as caught:
        TriangleMesh(vertices, faces)
    assert [each.button for each in caught.value.remedies] == ["Left", "Right"]
    for remedy, expected in zip(caught.value.remedies, both, strict=True):
        mesh = TriangleMesh(vertices, faces, **remedy.options)
        assert_array_equal(mesh.vertices, expected)
        check_message(mesh.messages[0], 42, 84, "Workbench")


@pytest.mark.parametrize("shift", [0.0, 3.0])
def test_specks_belong_to_a_hemisphere(shift):
    """A small component near the middle of the left hemisphere is kept with either hemisphere."""
    speck, right = 0.02 * SPHERE.vertices, 1.05 * SPHERE.vertices + [shift, 0, 0]
    vertices = np.concatenate([SPHERE.vertices, speck, right, speck + 0.1])
    faces = np.concatenate([SPHERE.faces + 42 * number for number in range(4)])
    with raises(MeshError, 4, "--hemisphere L", "--hemisphere R", "--largest-component") as caught:
        TriangleMesh(vertices, faces)
    buttons = [each.button for each in caught.value.remedies]
    assert buttons == ["Left, largest component", "Right, largest component"]
    for remedy, expected in zip(caught.value.remedies, (SPHERE.vertices, right), strict=True):
        assert_array_equal(TriangleMesh(vertices, faces, **remedy.options).vertices, expected)


def test_interleaved_components_are_not_hemispheres():
    """Components whose vertex numbers alternate are not taken as hemispheres."""
    vertices = np.repeat(SPHERE.vertices, 2, axis=0)
    faces = np.concatenate([2 * SPHERE.faces, 2 * SPHERE.faces + 1])
    with raises(MeshError, 2, "--largest-component") as caught:
        TriangleMesh(vertices, faces)
    assert [each.options for each in caught.value.remedies] == [{"largest_component": True}]
    with raises(MeshError, "left", "file"):
        TriangleMesh(vertices, faces, hemisphere="L")


def test_surface_without_extent_has_no_hemispheres():
    """A surface whose vertices all have one position, as in some FreeSurfer files, is refused."""
    with raises(MeshError, 2):
        TriangleMesh(np.full((5, 3), 0.3), [[0, 1, 3], [1, 3, 4], [2, 2, 2]])


def test_remaining_defect_is_reported():
    one = tetrahedron()
    other = TriangleMesh(one.vertices * [1, 1, -1] + [0, 0, 4], one.faces[:, ::-1])
    vertices = np.concatenate([one.vertices, one.vertices + np.array([0, 0, 9])])
    edge = np.concatenate([one.faces, one.faces + 4])
    edge = np.where(edge == 4, 0, np.where(edge == 5, 1, edge))  # shares vertices 0 and 1
    vertices = np.concatenate([vertices, 0.1 * other.vertices + 30])
    with raises(MeshError, 2, "--clean", "--largest-component", 4):
        TriangleMesh(vertices, np.concatenate([edge, other.faces + 8]))


def test_seam_of_a_connected_surface_is_reported():
    """A cylinder whose sides have equal positions but one common vertex has a message."""
    mesh = open_cylinder(6, 4)
    ring = np.flatnonzero(np.isclose(mesh.vertices[:, 1], 0) & (mesh.vertices[:, 0] > 0))[:-1]
    copies = len(mesh.vertices) + np.arange(len(ring))
    beyond = (mesh.vertices[mesh.faces][..., 1].mean(axis=1) < 0)[:, None]
    renamed = np.arange(len(mesh.vertices))
    renamed[ring] = copies
    faces = np.where(beyond, renamed[mesh.faces], mesh.faces)
    vertices = np.concatenate([mesh.vertices, mesh.vertices[ring]])
    check_message(TriangleMesh(vertices, faces).messages[0], len(ring), "--merge")
    assert same_topology(TriangleMesh(vertices, faces, merge=True), mesh)
