"""The field: how it is drawn, and what it is made of."""

from abfm_viewer.document.document import CLICK_TOOLS, FIELD_PARTS, Coloring
from abfm_viewer.panels.context import Context

_COLORINGS: tuple[Coloring, ...] = ("function", "speed", "divergence", "curl")
_ELSE = "a map"


def draw(context: Context) -> None:
    ui, session = context.ui, context.session
    view, quantities = session.view, context.shown.quantities
    if context.shown.flow.state is None:
        ui.note("There is a field after, and during, a match.")
    shown = view.coloring if view.coloring in _COLORINGS else _ELSE
    choices = (*_COLORINGS, _ELSE) if shown == _ELSE else _COLORINGS
    chosen = ui.combo("color by", shown, choices, "What the advected surface shows.")
    if chosen != shown and chosen != _ELSE:
        session.set_view(f"color by {chosen}", coloring=chosen)
    tip = (
        "The whole field, or a part of its Helmholtz-Hodge decomposition: without curl, without divergence, or both. "
        "Or the smoothest field that commutes with it (seconds), or the source's gradient, carried along its flow."
    )
    part = ui.combo("part", view.part, FIELD_PARTS, tip)
    session.set_view(f"show the {part} field", part=part)
    arrows = ui.checkbox("arrows", view.arrows, "The field as arrows on the advected surface.")
    session.set_view("switch arrows", arrows=arrows)
    if view.arrows:
        length = ui.number("length", view.arrow_length, 0.01, 0.4, "Of the longest, as a fraction of sqrt(area).")
        if length is not None and length > 0:
            session.set_view("arrows' length", "length", arrow_length=min(max(length, 0.001), 10.0))
        density = ui.number("density", view.arrow_density, 0, 1, "How many arrows there are.")
        if density is not None:
            session.set_view("arrows' density", "density", arrow_density=min(max(density, 0.0), 1.0))
    tip = "Lines of the field all over the surface: line integral convolution. A second or two after a match."
    session.set_view("switch streaks", streaks=ui.checkbox("streaks", view.streaks, tip))
    with ui.disabled(not view.streaks):
        fade = ui.checkbox("fade with speed", view.fade, "Less contrast of the streaks where the field is slower.")
        animate = ui.checkbox("animate", view.animate, "Streaks move along the field, here and in movies.")
    session.set_view("switch fading", fade=fade)
    session.set_view("switch animation", animate=animate)
    ui.note("A click on a surface starts:")
    tips = ("Nothing.", "A flow line through the point.", "Following where the point goes over time.")
    session.set_view("choose what a click does", tool=ui.radio(CLICK_TOOLS, view.tool, tips))
    if session.document.lines:
        ui.note(f"{len(session.document.lines)} flow lines")
        ui.beside_if_fits("Clear lines")
        if ui.button("Clear lines", "Remove all flow lines."):
            session.change("clear lines", lines=())
    field = quantities.field()
    if view.part == "commuting" and quantities.finding:
        ui.note("The field that commutes is being computed.")
    elif field is not None:
        ui.note(f"largest speed {float(field.speed.max()):.4g}, in {field.unit}")
        if field.note:
            ui.note(field.note)
        for name, share in field.shares.items():
            ui.note(f"{name}: {100 * share:.1f}% of the squared norm")
    if quantities.error:
        ui.note(quantities.error, "failure")
