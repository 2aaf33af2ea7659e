"""Tour of the window: cards next to the parts that they explain, one after another."""

from collections.abc import Callable, Mapping
from typing import NamedTuple

import polyscope.imgui as imgui

from abfm_viewer.document.keyboard import hint
from abfm_viewer.panels.context import Context
from abfm_viewer.widgets import placement
from abfm_viewer.widgets.containers import card, is_mouse_in
from abfm_viewer.widgets.widget_record import Rect

SCENE = "surfaces"
PANEL = "panel"
VERDICT = "verdict"
TIME_BAR = "time bar"
_WIDTH = 300
_HEIGHT = 150  # of the first card, before it is drawn
_GAP = 12


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
    of_frames: bool | None = None  # whether it is for sequences only, or not for them
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
        of_frames=False,
        state=lambda context: context.session.document.channels,
    ),
    _Stop(
        "Frames",
        "Open frames: one function at several times. Flows are found between consecutive frames.",
        ("Open mesh...", "Open frames..."),
        section="Functions",
        tab="Functions",
        of_frames=True,
    ),
    _Stop(
        "Match them",
        "Press this button. The solver finds a flow between the functions. A small mesh takes "
        "seconds.",
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
    """The tour, whose present card has a title, a place and a target, which a frame surrounds."""

    def __init__(self, context: Context) -> None:
        self._context = context
        self._stops: list[_Stop] = []  # that are not finished
        self._count = 0  # of all stops
        self._before: object = None
        self.place = self.target = (0.0, 0.0, 0.0, 0.0)

    @property
    def title(self) -> str:
        return self._stops[0].title if self._stops else ""

    def start(self) -> None:
        self._context.preferences.change(tour_seen=True)
        left_out = self._context.session.document.has_sides
        stops = [stop for stop in _STOPS if stop.of_frames is not left_out]
        self._count = len(stops)
        self._go_to(stops)

    def skip(self) -> None:
        self._stops = []

    def draw(self, parts: Mapping[str, Rect]) -> None:
        """Draw the present card, unless a dialog is open. Call at the end of a frame."""
        if not self._stops:
            return
        stops, ui = self._stops, self._context.ui
        stop = stops[0]
        self.target = self._target(stop, parts)
        if not self._context.dialogs.is_open:
            self._draw_card(stop, parts[PANEL])
        is_clicked = imgui.IsMouseReleased(0) and is_mouse_in(self.target)
        changed = stop.state(self._context) is not self._before if stop.state else is_clicked
        if changed and self._stops is stops and not (imgui.IsMouseDown(0) or ui.capturing):
            self._go_to(stops[1:])

    def _go_to(self, stops: list[_Stop]) -> None:
        self._stops = stops
        for stop in stops[:1]:
            self._before = stop.state(self._context) if stop.state else None
            self._context.ui.open_tab = stop.tab or self._context.ui.open_tab

    def _target(self, stop: _Stop, parts: Mapping[str, Rect]) -> Rect:
        ui, (left, _, right, bottom) = self._context.ui, parts[PANEL]
        padding, spacing = imgui.GetStyle().WindowPadding[0], imgui.GetStyle().ItemSpacing[1]
        ends = (each.rect[1] for each in ui.record.drawn if each.kind == "tab")
        end = min(ends, default=bottom) - spacing
        verdict = left, end - ui.heights.get("state", 0.0), right, end
        known = {**parts, VERDICT: verdict}
        named = [known[name] for name in stop.targets if name in known]
        for widget in ui.record.drawn:
            is_there = widget.is_within(stop.section) if stop.section else not widget.section
            if is_there and widget.label in stop.targets:
                named.append(widget.rect)
        if len(named) > 1:  # with the captions of the widgets
            named.append((right - padding, *named[0][1:2], right - padding, named[0][3]))
        return placement.hull(*(named or [parts[PANEL]]))

    def _draw_card(self, stop: _Stop, panel: Rect) -> None:
        ui, window, target = self._context.ui, self._context.ui.record.areas[0], self.target
        width = min(ui.px(_WIDTH), 0.45 * (window[2] - window[0]))
        height = self.place[3] - self.place[1] or ui.px(_HEIGHT)
        area = panel if target[0] >= panel[0] else None
        left, top = placement.beside(target, area, window, (width, height), ui.px(_GAP))
        if SCENE in self._stops[0].targets:  # over the panel, as it would cover surfaces elsewhere
            left = min(target[2], window[2] - width - ui.px(_GAP)) + ui.px(_GAP)
            top = target[3] - height
        with card(ui, "tour", (left, top + height, width), ui.colors.accent, window[3] - window[1]):
            number = self._count - len(self._stops) + 1
            ui.line(f"{stop.title}  ({number} of {self._count})", "muted")
            ui.note(stop.text, "ink")
            is_last = len(self._stops) == 1
            if ui.button("Done" if is_last else "Next", "Continue the tour.", primary=True):
                self._go_to(self._stops[1:])
            ui.same_line()
            tip = f"End it ({hint('cancel')}). The menu Help starts it again."
            if not is_last and ui.button("Skip tour", tip):
                self.skip()
            height = float(imgui.GetWindowHeight())
        self.place = (left, top, left + width, top + height)
        corners = (target[0] - 2, target[1] - 2), (target[2] + 2, target[3] + 2)
        color = imgui.GetColorU32(ui.colors.accent)
        imgui.GetForegroundDrawList().AddRect(*corners, color, ui.px(4), 0, ui.px(2.5))
