"""The result beside what a user would compare it with, in pictures and numbers."""

import numpy as np

from abfm_viewer.document.verdict_words import numbers
from abfm_viewer.panels.context import Context


def draw(context: Context) -> None:
    ui, session, view = context.ui, context.session, context.session.view
    tip = "A surface with (1 - t/tau) source + t/tau target: nothing moves, it only fades."
    blend = ui.checkbox("linear blend", view.blend, tip)
    tip = "A surface with the Wasserstein interpolation of source and target: their mass takes the shortest ways."
    transport = ui.checkbox("optimal transport", view.transport, tip)
    error = ui.checkbox("error", view.error, "A surface with |target - advected|, on a range of its own.")
    session.set_view("compare", blend=blend, transport=transport, error=error)
    if transport and context.shown.mass_transport.error:
        ui.note(f"No optimal transport: {context.shown.mass_transport.error}.", "failure")
    target, advected = session.values("target"), context.shown.flow.advected()
    if target is None or advected is None:
        return
    difference = np.abs(target - advected)
    worst = int(np.argmax(difference))
    ui.note(
        f"At time {session.time:.4g} the error is at most {difference[worst]:.4g}, at vertex "
        f"{session.mesh.vertex_ids[worst]}; on average {float(difference.mean()):.4g}."
    )
    if session.result is not None and not session.outdated:
        ui.note(f"Mismatch at tau: {numbers(session.result)}; relative to the target in L2.")
