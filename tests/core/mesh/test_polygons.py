"""Polygons of more than three corners become triangles that lie in them."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from abfm.errors import MeshError
from abfm.mesh import load_mesh
from abfm.mesh.readers import contents as readers
from abfm.mesh.readers.contents import split_polygons
from tests.mesh_writers import write

seeds = st.integers(0, 2**32 - 1)


def split(points, *rows):
    sizes = np.array([len(row) for row in rows])
    corners = np.concatenate(rows).astype(np.int64)
    return split_polygons(np.asarray(points, dtype=np.float64), sizes, corners)


def area_vectors(points, faces):
    a, b, c = np.moveaxis(points[faces], 1, 0)
    return np.cross(b - a, c - a) / 2


def star(random, count):
    """A jagged polygon (n, 2) around the origin, counterclockwise, that begins anywhere."""
    angle = 2 * np.pi / count * (np.arange(count) + random.uniform(0, 0.9, count))
    radius = random.uniform(0.1, 1, count)
    points = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)
    return np.roll(points, random.integers(count), axis=0)


def untangled(random, count):
    """A simple polygon (n, 2) through random points: sides are exchanged until none cross."""
    points = random.uniform(-1, 1, (count, 2))
    changed = True
    while changed:
        changed = False
        for i in range(count - 1):
            for j in range(i + 2, count - (i == 0)):
                a, b, c, d = points[i], points[i + 1], points[j], points[(j + 1) % count]
                now, then = (((a, b), (c, d)), ((a, c), (b, d)))
                lengths = [sum(np.linalg.norm(p - q) for p, q in pairs) for pairs in (now, then)]
                if lengths[1] < lengths[0] - 1e-12:
                    points[i + 1 : j + 1] = points[i + 1 : j + 1][::-1].copy()
                    changed = True
    x, y = points.T
    return points if x @ np.roll(y, -1) > y @ np.roll(x, -1) else points[::-1].copy()


def turned(random, plane):
    """A plane polygon anywhere in space."""
    frame, _ = np.linalg.qr(random.normal(size=(3, 3)))
    return plane @ frame[:2] + random.normal(size=3)


@pytest.mark.parametrize("make", [star, untangled])
@given(seed=seeds, count=st.integers(4, 25))
def test_triangles_cover_a_simple_polygon_once(make, seed, count):
    """None looks away, and areas add up to its own: they neither overlap nor leave anything out."""
    random = np.random.default_rng(seed)
    plane = make(random, count)
    points = turned(random, plane)
    contents = split(points, np.arange(count))
    areas = area_vectors(points, contents.faces)
    area = np.linalg.norm(areas.sum(axis=0))
    x, y = plane.T
    assert len(contents.faces) == count - 2
    assert (areas @ (areas.sum(axis=0) / area)).min() > -1e-12
    assert area == pytest.approx((x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2)
    np.testing.assert_allclose(np.linalg.norm(areas, axis=1).sum(), area, rtol=1e-9)
    assert len(contents.messages) == 1


@given(seed=seeds, count=st.integers(4, 40))
def test_convex_polygons_are_fans(seed, count):
    random = np.random.default_rng(seed)
    angle = np.cumsum(random.uniform(0.2, 1, count))
    angle *= 2 * np.pi / (angle[-1] + 0.2)
    points = turned(random, np.stack([np.cos(angle), np.sin(angle)], axis=1))
    fan = [[0, k, k + 1] for k in range(1, count - 1)]
    assert split(points, np.arange(count)).faces.tolist() == fan


@pytest.mark.parametrize("shift", range(4))
def test_a_concave_quad_is_cut_through_its_dent(shift):
    dart = np.array([[0.0, 0, 0], [3, -1, 0], [1, 0, 0], [3, 1, 0]])  # the dent is corner 2
    row = np.roll(np.arange(4), shift)
    faces = split(dart, row).faces
    assert all({0, 2} <= set(face) for face in faces.tolist())
    assert np.linalg.norm(area_vectors(dart, faces), axis=1).sum() == pytest.approx(1)


def test_a_corner_on_a_straight_side_makes_no_flat_triangle():
    """The fan around corner 0 would have one: 0, 1 and 2 lie on a line."""
    points = [[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [2, 2, 0], [0, 2, 0]]
    areas = np.linalg.norm(area_vectors(np.array(points), split(points, range(5)).faces), axis=1)
    assert areas.min() > 0.1
    assert areas.sum() == pytest.approx(4)


def test_the_others_keep_their_fans_and_places():
    points = [[0.0, 0, 0], [3, -1, 0], [1, 0, 0], [3, 1, 0], [4, 0, 0], [4, 4, 0]]
    contents = split(points, [0, 4, 5], [1, 2, 3, 0], [2, 1, 4, 3], [3, 4, 5])
    assert contents.faces[0].tolist() == [0, 4, 5]
    assert {0, 2} <= set(contents.faces[1]) & set(contents.faces[2])
    assert contents.faces[3:].tolist() == [[2, 1, 4], [2, 4, 3], [3, 4, 5]]


def test_what_crosses_itself_is_a_fan_with_a_warning():
    """Winds twice around its middle: a pentagram."""
    angle = 4 * np.pi * np.arange(5) / 5 + 0.1
    points = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    contents = split(points, range(5))
    assert contents.faces.tolist() == [[0, 1, 2], [0, 2, 3], [0, 3, 4]]
    told = "warning: 1 of them cross themselves (for example face 0, counting from 0)"
    assert contents.messages[1].startswith(told)


@pytest.mark.parametrize("bound", ["_MOST_CORNERS", "_MOST_WORK"])
def test_polygons_that_would_take_for_ever_are_refused(tmp_path, monkeypatch, bound):
    monkeypatch.setattr(readers, bound, 9)
    monkeypatch.setattr(readers, "_WORK_OF_A_CORNER", 1)
    points = star(np.random.default_rng(0), 10).tolist()
    lines = ["OFF 10 1 0", *(f"{x!r} {y!r} 0" for x, y in points), "10 0 1 2 3 4 5 6 7 8 9"]
    with pytest.raises(MeshError, match=r"10 corners.*split polygons into triangles"):
        load_mesh(write(tmp_path, "a.off", "\n".join(lines)))
