"""The flow on the advected surface: which part of the field, as arrows and as streaks."""

from abfm_viewer.document.document import FIELD_PARTS
from abfm_viewer.panels.context import Context


def draw(context: Context) -> None:
    ui, session = context.ui, context.session
    view = session.view
    ui.heading("flow")
    tip = (
        "The whole field, or a part of its Helmholtz-Hodge decomposition: without curl, without divergence, or both. "
        "Or the smoothest field that commutes with it (seconds), or the source's gradient, carried along its flow."
    )
    part = ui.combo("part", view.part, FIELD_PARTS, tip)
    session.set_view(f"show the {part} field", part=part)
    arrows = ui.checkbox("arrows", view.arrows, "The field as arrows on the advected surface.")
    session.set_view("switch arrows", arrows=arrows)
    with ui.disabled(not view.arrows):
        length = ui.number("length", view.arrow_length, 0.01, 0.4, "Of the longest, as a fraction of sqrt(area).")
        density = ui.number(
            "density",
            view.arrow_density,
            0,
            1,
            "How many arrows there are.",
        )
    if length is not None and length > 0:
        session.set_view("arrows' length", "length", arrow_length=min(max(length, 0.001), 10.0))
    if density is not None:
        session.set_view("arrows' density", "density", arrow_density=min(max(density, 0.0), 1.0))
    tip = "Lines of the field all over the surface: line integral convolution. A second or two after a match."
    session.set_view("switch streaks", streaks=ui.checkbox("streaks", view.streaks, tip))
    with ui.disabled(not view.streaks):
        ui.beside_if_fits("fade with speed")
        fade = ui.checkbox("fade with speed", view.fade, "Less contrast of the streaks where the field is slower.")
        ui.beside_if_fits("animate")
        animate = ui.checkbox("animate", view.animate, "Streaks move along the field, here and in movies.")
    session.set_view("switch fading", fade=fade)
    session.set_view("switch animation", animate=animate)
