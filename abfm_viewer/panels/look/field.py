"""The flow on the advected surface: which part of the field, as arrows and as streaks."""

from abfm_viewer.document.document import FIELD_PARTS
from abfm_viewer.panels.context import Context
from abfm_viewer.widgets.slider_range import Range

_PART = (
    "The whole field, or a part of its Helmholtz-Hodge decomposition: without curl, without "
    "divergence, or both. Or the smoothest field that commutes with it (seconds), or the "
    "source's gradient, carried along its flow."
)
_ARROWS = "The field as arrows on the advected surface."
_LENGTH = "Of the longest, as a fraction of sqrt(area)."
_STREAKS = "Lines all over the surface: line integral convolution, seconds after a match."
_FADE = "Less contrast of the streaks where the field is slower."
_ANIMATE = "Streaks move along the field, here and in movies."


def draw(context: Context) -> None:
    ui, view, set_view = context.ui, context.session.view, context.session.editor.set_view
    ui.heading("flow")
    part = ui.combo("part", view.part, FIELD_PARTS, _PART)
    set_view(f"show the {part} field", part=part)
    set_view("switch arrows", arrows=ui.checkbox("arrows", view.arrows, _ARROWS))
    with ui.disabled(not view.arrows):
        length = ui.number("length", view.arrow_length, Range(0.01, 0.4), _LENGTH)
        tip = "How many arrows there are."
        density = ui.number("density", view.arrow_density, Range(0, 1), tip)
    if length is not None and length > 0:
        set_view("arrows' length", "length", arrow_length=min(max(length, 0.001), 10.0))
    if density is not None:
        set_view("arrows' density", "density", arrow_density=min(max(density, 0.0), 1.0))
    set_view("switch streaks", streaks=ui.checkbox("streaks", view.streaks, _STREAKS))
    with ui.disabled(not view.streaks):
        ui.beside_if_fits("fade with speed")
        fade = ui.checkbox("fade with speed", view.fade, _FADE)
        ui.beside_if_fits("animate")
        animate = ui.checkbox("animate", view.animate, _ANIMATE)
    set_view("switch fading", fade=fade)
    set_view("switch animation", animate=animate)
