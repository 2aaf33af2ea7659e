"""Where the cells of a sheet lie."""

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from abfm_viewer.pictures.sheets import LABEL, MARGIN, TALLEST_PANEL, WIDEST, laid_out

ASPECTS = st.lists(st.lists(st.floats(0.45, 3.8), min_size=1, max_size=8), min_size=1, max_size=5)


@given(ASPECTS, st.integers(0, 3))
def test_cells_keep_apart_inside_the_sheet_and_have_one_height(rows, bars):
    layout = laid_out(rows, bars)
    assert len(layout.bars) == bars
    assert layout.width <= WIDEST + 8  # rounding of each cell's width
    heights = {place.height for row in layout.rows for place in row}
    assert len(heights) == 1
    assert heights.pop() <= TALLEST_PANEL
    for row, aspects in zip(layout.rows, rows, strict=True):
        assert row[0].left >= MARGIN
        assert row[-1].left + row[-1].width <= layout.width - MARGIN + 1
        for left, right in pairwise(row):
            assert left.left + left.width < right.left
        for place, aspect in zip(row, aspects, strict=True):
            assert place.width == pytest.approx(aspect * place.height, abs=1 + 0.5 * aspect)
    for above, below in pairwise(layout.rows):
        assert above[0].top + above[0].height + LABEL < below[0].top
    assert layout.rows[-1][0].top + layout.rows[-1][0].height + LABEL <= layout.height
    for left, top, right, bottom in layout.bars:
        assert (
            layout.rows[-1][0].top + layout.rows[-1][0].height + LABEL
            < top
            < bottom
            < layout.height
        )
        assert 0 < left < right < layout.width
    for one, other in pairwise(layout.bars):
        assert one[2] < other[0]


def test_the_widest_row_fills_the_sheet_unless_panels_would_be_too_tall():
    assert laid_out([[1.0] * 6, [1.0]], 0).width == pytest.approx(WIDEST, abs=6)
    single = laid_out([[1.0]], 0)
    assert single.rows[0][0].height == TALLEST_PANEL
    assert single.width < WIDEST / 2
