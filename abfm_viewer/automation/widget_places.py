"""Where on a widget the mouse must be."""

from __future__ import annotations

from abfm_viewer.automation.input_events import Place
from abfm_viewer.widgets.slider_scale import share_of
from abfm_viewer.widgets.widget_record import Widget

_GRAB_PADDING = 2.0  # pixels, ImGui's own


def middle(widget: Widget, share: float = 0.5) -> Place:
    """A point at half a widget's height, and at a share of its width."""
    left, top, right, bottom = widget.rect
    return left + share * (right - left), (top + bottom) / 2


def handle(widget: Widget) -> Place:
    """Where to click: the rectangles of some kinds hold their labels, too, of which the end may be out of view."""
    left, top, _, bottom = widget.rect
    if widget.kind == "checkbox":
        return left + (bottom - top) / 2, (top + bottom) / 2
    return middle(widget, 0.3 if widget.kind in ("box", "combo") else 0.5)


def slider_place(widget: Widget, value: float) -> Place:
    """Where on a slider a value is; the grab's half width is left free at both ends, as ImGui does."""
    share = share_of(value, widget.low, widget.high, widget.log)
    left, _, right, _ = widget.rect
    inset = widget.grab / 2 + _GRAB_PADDING
    return left + inset + share * (right - left - 2 * inset), middle(widget)[1]
