"""Pairs of shapes with known correspondence, and the errors of maps between them."""

import numpy as np
import pytest

from abfm import PointMap, TriangleMesh
from abfm.mesh.shapes import five_limbs
from laboratory import initial_maps, shape_pairs
from laboratory.shape_pairs import ISOMETRIC, pair_of_same_faces
from tests.shapes import icosphere

BALL = icosphere(4)


def test_paths_agree_with_great_circles():
    found = shape_pairs.distances_over_surface(BALL, np.array([0, 7]))
    cosines = BALL.vertices[[0, 7]] @ BALL.vertices.T
    exact = np.arccos(np.clip(cosines, -1, 1))
    is_away = exact > 0.2
    ratios = found[is_away] / exact[is_away]
    assert ratios.min() > 0.995
    assert ratios.max() < 1.05
    assert ratios.mean() < 1.02


def test_clean_closes_holes_and_keeps_numbers():
    hole = (BALL.faces == 5).any(axis=1)
    faces = np.vstack([BALL.faces[~hole], BALL.faces[~hole][:2, [1, 2, 0]]])
    mesh = shape_pairs.clean(BALL.vertices, faces)
    assert not mesh.boundary_loops
    assert mesh.genus == 0
    kept = mesh.vertex_ids < len(BALL.vertices)
    np.testing.assert_array_equal(mesh.vertices[kept], BALL.vertices[mesh.vertex_ids[kept]])
    assert set(range(len(BALL.vertices))) - set(mesh.vertex_ids) == {5}


def test_pair_of_same_faces_knows_where_points_are():
    """The truth between a shape and itself, moved, is the closest point before it moved."""
    whole = five_limbs(2000)
    turned = TriangleMesh(whole.vertices[:, [1, 2, 0]] * 2 + 1, whole.faces)
    pair = pair_of_same_faces("limbs", ISOMETRIC, (whole, turned), counts=(1200, 1000))
    assert len(pair.a.faces) != len(pair.b.faces)
    back = ((pair.b.vertices - 1) / 2)[:, [2, 0, 1]]
    right = PointMap.project(pair.b, pair.a, back)
    assert pair.error(right) < 0.02
    assert pair.error(PointMap.project(pair.b, pair.a, back * [-1, 1, 1])) > 0.2
    marks = pair.landmarks
    where = ((marks.b.positions - 1) / 2)[:, [2, 0, 1]]
    assert len(where) == 5
    np.testing.assert_allclose(marks.a.positions, where, atol=0.05 * whole.length_scale)


def test_marks_are_read(tmp_path):
    path = tmp_path / "marks.yml"
    path.write_text('markers:\n  - "2653:1316"  # left paw\n  - "20:14"\n')
    np.testing.assert_array_equal(shape_pairs.read_marks(path), [[2653, 1316], [20, 14]])


def test_summary_counts_choices_close_to_the_best():
    def row(default, best):
        errors = (default, best, np.nan, 0.5, 0.5, 0.1, np.nan)
        return initial_maps.Row("", ISOMETRIC, ("spectral", ""), errors, (0, 0, 1))

    means, medians, close = initial_maps.summary([row(0.11, 0.1), row(0.3, 0.1), row(0.1, 0.1)])
    assert len(means) == len(medians) == len(close) == len(initial_maps.HEADS)
    assert (means[2], medians[2], close[2]) == ("0.1700", "0.1100", "2 of 3")


@pytest.mark.parametrize("count", [1, 4])
def test_row_has_a_cell_for_each_head(count):
    errors = (0.1,) * (2 + len(initial_maps.CANDIDATES)) + (np.nan,)
    cells = initial_maps.Row("a", "b", ("c", "d"), errors, (count, 0, 2.6)).cells()
    assert len(cells) == len(initial_maps.HEADS)
    assert cells[-3:] == [str(count), "0", "3"]
    assert cells[-4] == "–"
