"""Surfaces beside the result, with what a user would compare it with."""

from abfm_viewer.panels.context import Context

_BLEND = "A surface with (1 - t/τ) source + t/τ target: nothing moves, it only fades."
_TRANSPORT = "A surface with the Wasserstein interpolation: the mass takes the shortest ways."
_ERROR = "A surface with |target - advected|, on a range of its own."


def draw(context: Context) -> None:
    ui, view = context.ui, context.session.view
    ui.heading("compare with")
    blend = ui.checkbox("linear blend", view.blend, _BLEND)
    ui.beside_if_fits("optimal transport")
    transport = ui.checkbox("optimal transport", view.transport, _TRANSPORT)
    ui.beside_if_fits("error")
    error = ui.checkbox("error", view.error, _ERROR)
    context.session.editor.set_view("compare", blend=blend, transport=transport, error=error)
