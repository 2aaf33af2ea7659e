"""Tour of the window: cards next to the parts that they explain, one after another."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple

import polyscope.imgui as imgui

from abfm_viewer.document.keyboard import hint
from abfm_viewer.panels.context import Context
from abfm_viewer.widgets import placement
from abfm_viewer.widgets.containers import card
from abfm_viewer.widgets.widget_record import Rect

SCENE = "surfaces"
PANEL = "panel"
VERDICT = "verdict"
TIME_BAR = "time bar"
_WIDTH = 300
_GAP = 26  # between a card and its target; contains the arrow
_ARROW = 9


class _Stop(NamedTuple):
    """A card, and the parts of the window that it explains.

    The targets are parts of the window, or labels of widgets in a section. The tour continues when
    ``state`` returns another value, or without it after a click on the targets.
    """

    title: str
    text: str
    targets: tuple[str, ...]
    section: str = ""
    tab: str = ""  # that is opened first
    state: Callable[[Context], object] | None = None


_STOPS = (
    _Stop(
        "The surfaces",
        "Drag a surface to turn it, and use the wheel to zoom. The source flows to the target; "
        "the surface between them shows the present time.",
        (SCENE,),
        state=lambda context: context.session.view.viewpoint,
    ),
    _Stop(
        "Two functions",
        "Choose a family for the source and the target, or hold Shift and click on a surface to "
        "place a Gaussian.",
        ("family", "vertex map", "spec"),
        section="source",
        tab="Functions",
        state=lambda context: context.session.document.channels,
    ),
    _Stop(
        "Match them",
        "Press this button. The solver finds a flow that moves the source to the target. A small "
        "mesh takes seconds.",
        ("Match", "Match again", "Continue", "Match all frames"),
        state=lambda context: context.session.result,
    ),
    _Stop(
        "Read the verdict",
        "The verdict appears here, with its reason and buttons that improve the match. The button "
        "? explains it.",
        (VERDICT,),
        state=lambda context: context.dialogs.is_open,
    ),
    _Stop("Play the flow", "Press Play, or drag the slider from 0 to τ.", (TIME_BAR,)),
    _Stop(
        "Change the look",
        "The tab Look has colours, arrows, streaks, comparisons and numbers.",
        ("Look",),
        section="steps",
    ),
    _Stop(
        "Export",
        "The tab Export writes pictures, movies, results and pages for a browser.",
        ("Export",),
        section="steps",
    ),
    _Stop(
        "Find everything",
        f"{hint('search')} searches all actions, and {hint('shortcuts')} lists the keys. The menu "
        "Help has both, and this tour.",
        ("Help",),
        state=lambda context: context.dialogs.is_open,
    ),
)


class Tour:
    """The state of the tour; `draw` draws the present card."""

    def __init__(self, context: Context) -> None:
        self._context = context
        self._number: int | None = None
        self._before: object = None
        self._parts: Mapping[str, Rect] = {}
        # the card and its target in the latest frame
        self.place: Rect = (0.0, 0.0, 0.0, 0.0)
        self.target: Rect = (0.0, 0.0, 0.0, 0.0)

    @property
    def title(self) -> str:
        """Title of the present card; empty if there is none."""
        return "" if self._number is None else _STOPS[self._number].title

    def start(self) -> None:
        self._context.preferences.change(tour_seen=True)
        self._go_to(0)

    def start_once(self, is_asked: bool) -> None:
        """Start the tour unless the user has seen it, or ``is_asked`` to do other things."""
        if not (is_asked or self._context.preferences.get("tour_seen")):
            self.start()

    def draw(self, parts: Mapping[str, Rect]) -> None:
        """Draw the card and the frame around its target, unless a dialog is open."""
        if (number := self._number) is None:
            return
        stop, ui = _STOPS[number], self._context.ui
        left, _, right, _ = parts[PANEL]
        ends = (each.rect[1] for each in ui.record.drawn if each.kind == "tab")
        bottom = min(ends, default=parts[PANEL][3]) - imgui.GetStyle().ItemSpacing[1]
        verdict = left, bottom - ui.heights.get("state", 0.0), right, bottom
        self._parts = {**parts, VERDICT: verdict}
        target = self.target = self._target(stop)
        if not self._context.dialogs.is_open:
            self._draw_card(stop, target)
        is_clicked = imgui.IsMouseReleased(0) and _is_in(target, imgui.GetMousePos())
        changed = stop.state(self._context) is not self._before if stop.state else is_clicked
        is_idle = not (imgui.IsMouseDown(0) or ui.capturing)
        if changed and is_idle and self._number == number:
            self._go_to(number + 1)

    def _go_to(self, number: int) -> None:
        self._number = number if number < len(_STOPS) else None
        if self._number is not None:
            stop = _STOPS[self._number]
            self._before = stop.state(self._context) if stop.state else None
            self._context.ui.open_tab = stop.tab or self._context.ui.open_tab

    def _target(self, stop: _Stop) -> Rect:
        named = [self._parts[name] for name in stop.targets if name in self._parts]
        named += [
            widget.rect
            for widget in self._context.ui.record.drawn
            if {widget.label, widget.name} & {*stop.targets}
            and (widget.is_within(stop.section) if stop.section else not widget.section)
        ]
        left, top, right, bottom = placement.hull(*(named or [self._parts[PANEL]]))
        if len(named) > 1:  # with the captions of the widgets
            right = self._parts[PANEL][2] - imgui.GetStyle().WindowPadding[0]
        return left, top, right, bottom

    def _draw_card(self, stop: _Stop, target: Rect) -> None:
        ui, number = self._context.ui, self._number or 0
        window, color = ui.record.areas[0], ui.colors.accent
        width = min(ui.px(_WIDTH), 0.45 * (window[2] - window[0]))
        height = self.place[3] - self.place[1] or ui.px(150)
        area = self._parts[PANEL] if target[0] >= self._parts[PANEL][0] else None
        left, top = placement.beside(target, area, window, (width, height), ui.px(_GAP))
        is_last = number == len(_STOPS) - 1
        with card(ui, "tour", (left, top, width), color, window[3] - window[1]):
            ui.line(f"{stop.title}  ({number + 1} of {len(_STOPS)})", "muted")
            ui.note(stop.text, "ink")
            if ui.button("Done" if is_last else "Next", "Continue the tour.", primary=True):
                self._go_to(number + 1)
            if not is_last:
                ui.same_line()
                if ui.button("Skip tour", "End the tour. The menu Help starts it again."):
                    self._number = None
            height = float(imgui.GetWindowHeight())
        self.place = (left, top, left + width, top + height)
        self._draw_frame(target, self.place)

    def _draw_frame(self, target: Rect, own: Rect) -> None:
        """Draw a frame around the target, and an arrow to it from the card."""
        ui, drawing = self._context.ui, imgui.GetForegroundDrawList()
        color, side = imgui.GetColorU32(ui.colors.accent), ui.px(_ARROW)
        left, top, right, bottom = target
        corners = (left - 2, top - 2), (right + 2, bottom + 2)
        drawing.AddRect(*corners, color, ui.px(4), 0, ui.px(2))
        x = (max(own[0], left) + min(own[2], right)) / 2
        y = (max(own[1], top) + min(own[3], bottom)) / 2
        if own[2] <= left or own[0] >= right:
            x, way = (left - 4, -side) if own[2] <= left else (right + 4, side)
            base = (x + way, y - side), (x + way, y + side)
        else:
            y, way = (top - 4, -side) if own[3] <= top else (bottom + 4, side)
            base = (x - side, y + way), (x + side, y + way)
        drawing.AddTriangleFilled((x, y), *base, color)


def _is_in(rect: Rect, place: tuple[float, float]) -> bool:
    return rect[0] <= place[0] < rect[2] and rect[1] <= place[1] < rect[3]
