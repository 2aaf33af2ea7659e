"""Surfaces beside the result, with what a user would compare it with."""

from abfm_viewer.panels.context import Context


def draw(context: Context) -> None:
    ui, session, view = context.ui, context.session, context.session.view
    ui.heading("compare with")
    tip = "A surface with (1 - t/τ) source + t/τ target: nothing moves, it only fades."
    blend = ui.checkbox("linear blend", view.blend, tip)
    ui.beside_if_fits("optimal transport")
    tip = "A surface with the Wasserstein interpolation of source and target: their mass takes the shortest ways."
    transport = ui.checkbox("optimal transport", view.transport, tip)
    ui.beside_if_fits("error")
    error = ui.checkbox("error", view.error, "A surface with |target - advected|, on a range of its own.")
    session.set_view("compare", blend=blend, transport=transport, error=error)
