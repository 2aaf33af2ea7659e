"""The figures of the paper as documents."""

from __future__ import annotations

from abfm_viewer.document import View
from abfm_viewer.presets import figure_document


def test_a_figure_keeps_the_theme_and_forgets_the_rest_of_the_view():
    document, _ = figure_document(7, View(theme="dark", blend=True, coloring="checker"))
    assert document.view.theme == "dark"
    assert not document.view.blend
    assert document.view.coloring == "function"
