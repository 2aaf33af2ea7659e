"""The time bar: playing the flow, and the slider over 0 to 2 tau."""

import polyscope.imgui as imgui

from abfm_viewer.panels.context import Context
from abfm_viewer.session.player import REPEATS
from abfm_viewer.session.session import Session
from abfm_viewer.widgets.toolkit import Ui, finite
from abfm_viewer.widgets.widget_record import Rect

STEP = 1 / 20
"""Of tau: how far a step moves in time."""
_SLOWEST, _FASTEST = 0.1, 4.0
_NARROW = 600  # at a scale of 1: below, the bar needs a row more
_HEIGHT, _ROW = 82, 30


def height(width: float, scale: float) -> float:
    """How high a bar of a certain width must be, in pixels."""
    return (_HEIGHT + (_ROW if width < _NARROW * scale else 0)) * scale


def draw(context: Context, rect: Rect) -> None:
    ui, session = context.ui, context.session
    with ui.window("time bar", rect), ui.group("time bar"):
        _buttons(ui, session)
        if rect[2] - rect[0] >= ui.px(_NARROW):
            ui.beside(ui.px(16))
        _ways(ui, session)
        _slider(context)


def _buttons(ui: Ui, session: Session) -> None:
    player = session.player
    step = STEP * session.parameters.tau
    tip = "Hold (Space)." if player.playing else "Show the function on its way (Space)."
    if ui.button("Pause" if player.playing else "Play", tip, width=ui.px(52)):
        player.toggle()
    for label, seconds, tip in (("<", -step, "A twentieth of tau back."), (">", step, "A twentieth of tau on.")):
        ui.beside(ui.px(4))
        if ui.button(label, tip, width=ui.px(24)):
            session.set_time(session.time + seconds)
    ui.beside(ui.px(4))
    if ui.button("to start", "Show the source, time 0."):
        session.set_time(0.0)
    ui.beside()
    player.beyond = ui.checkbox("beyond tau", player.beyond, "Play on to 2 tau, where the flow extrapolates.")


def _ways(ui: Ui, session: Session) -> None:
    player = session.player
    player.repeat = ui.combo("repeat", player.repeat, REPEATS, "What happens at the end.", width=ui.px(104))
    ui.beside(ui.px(12))
    tip = "1 goes from 0 to tau in four seconds."
    speed = ui.slider("speed", player.speed, _SLOWEST, _FASTEST, tip, width=ui.px(64), log=True)
    if speed is not None:
        player.speed = float(f"{speed:.2g}")
    ui.beside(ui.px(6))
    imgui.AlignTextToFramePadding()
    ui.note(f"speed {player.speed:g}", "ink")


def _slider(context: Context) -> None:
    """The slider over 0 to 2 tau; right of its tick at tau is what no target was given for."""
    ui, session, note = context.ui, context.session, context.shown.flow.note
    box, spacing = ui.px(64), imgui.GetStyle().ItemInnerSpacing[0]
    width = imgui.GetContentRegionAvail()[0] - box - 2 * spacing - imgui.CalcTextSize("time")[0]
    left, top = imgui.GetCursorScreenPos()
    _track(ui, note, (left, top, left + width, top + imgui.GetFrameHeight()))
    imgui.PushStyleColor(imgui.ImGuiCol_FrameBg, (0, 0, 0, 0))
    tip = note or "0 is the source, tau the match; beyond, the flow goes on by itself."
    slid = ui.slider("time", session.time, 0.0, session.end, tip, width=width)
    imgui.PopStyleColor()
    if slid is not None:
        session.set_time(slid)
    ui.beside(spacing)
    typed = ui.text("time", f"{session.time:.4g}", "The time that is shown, 0 to 2 tau.", width=box)
    if typed is not None:
        if (time := finite(typed)) is None:
            session.say(f"time: {typed!r} is no number", is_error=True)
        else:
            session.set_time(time)


def _track(ui: Ui, note: str, rect: Rect) -> None:
    left, top, right, bottom = rect
    colors, canvas, rounding = ui.colors, imgui.GetWindowDrawList(), imgui.GetStyle().FrameRounding
    middle = (left + right) / 2
    canvas.AddRectFilled((left, top), (right, bottom), _packed(colors.field), rounding)
    tint, corners = _packed((*colors.marker[:3], 0.16)), imgui.ImDrawFlags_RoundCornersRight
    canvas.AddRectFilled((middle, top), (right, bottom), tint, rounding, corners)
    canvas.AddLine((middle, top), (middle, bottom), _packed(colors.ink), ui.px(1.5))
    text, color = ("cannot be followed", colors.failure) if note else ("extrapolation", colors.muted)
    size = imgui.CalcTextSize(text)
    place = (right - size[0] - ui.px(6), (top + bottom - size[1]) / 2)
    if place[0] > middle + ui.px(12):
        canvas.AddText(place, _packed(color), text)
    canvas.AddText((middle - ui.px(12) - imgui.CalcTextSize("tau")[0], place[1]), _packed(colors.ink), "tau")


def _packed(color: tuple[float, float, float, float]) -> int:
    return int(imgui.GetColorU32(color))
