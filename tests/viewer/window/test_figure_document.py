"""The figures of the paper as documents."""

from __future__ import annotations

from abfm_viewer.document.document import View
from abfm_viewer.window.figure_document import figure_document


def test_a_figure_keeps_the_theme_and_forgets_the_rest_of_the_view():
    document, _ = figure_document(
        7, View(theme="dark", blend=True, transport=True, animate=True, coloring="checker")
    )
    view = document.view
    assert view.theme == "dark"
    assert (view.blend, view.transport, view.animate) == (False, False, False)
    assert view.coloring == "function"
