import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from abfm import FunctionError
from abfm.reading.labels import Labels
from abfm_viewer.document.label_map import LabelMap
from tests.messages import raises
from tests.shapes import icosphere, with_loose_vertex

BALL = icosphere(0)
KEYS = np.repeat([7, -1, 40], 4)
RED = (1.0, 0.0, 0.0, 1.0)


def test_vertices_have_the_colors_of_their_labels():
    labels = Labels(KEYS, {7: "insula", 40: "cuneus", 50: "nowhere"}, {7: RED})
    found = LabelMap.of("a.annot", BALL, labels)
    assert found.keys == (-1, 7, 40, 50)
    assert found.names == ("", "insula", "cuneus", "nowhere")
    colors = found.linear_colors(found.values)
    assert_allclose(colors[:4], np.tile([1, 0, 0], (4, 1)))
    assert np.ptp(colors[4]) == 0  # a label without a name is grey
    assert len(np.unique(colors, axis=0)) == 3
    again = found.labels(KEYS[::-1])
    assert (again.names, again.colors[7]) == (labels.names, RED)
    assert_array_equal(again.values, KEYS[::-1])


def test_labels_of_the_file_are_restricted_to_the_mesh():
    loose = with_loose_vertex(BALL)
    keys = np.full(13, 99)
    keys[loose.vertex_ids] = KEYS
    assert_array_equal(LabelMap.of("a", loose, Labels(keys)).values, KEYS)
    with raises(FunctionError, 3, 12):
        LabelMap.of("a", BALL, Labels(KEYS[:3]))


@given(st.lists(st.integers(-(2**40), 2**40), min_size=12, max_size=12))
def test_colors_of_labels_are_distinct(keys):
    found = LabelMap.of("a", BALL, Labels(np.array(keys)))
    colors = found.linear_colors(found.values)
    assert ((colors >= 0) & (colors <= 1)).all()
    _, first = np.unique(keys, return_inverse=True)
    _, second = np.unique(colors, axis=0, return_inverse=True)
    assert len(np.unique(np.stack([first, second.ravel()]), axis=1).T) == len(set(keys))
