"""The time bar: playback controls and the time slider."""

import math

import polyscope.imgui as imgui

from abfm_viewer.document.keyboard import with_key
from abfm_viewer.panels.context import Context
from abfm_viewer.session.player import REPEATS
from abfm_viewer.session.session import Session
from abfm_viewer.widgets.containers import window
from abfm_viewer.widgets.toolkit import Ui, finite
from abfm_viewer.widgets.widget_record import Range, Rect

STEP = 1 / 20  # time of a step, as a fraction of tau
PADDING = 20
GAP = 8
# at a scale of 1; in a narrower bar the combo repeat has no caption
_ROW_HEIGHT = 32
_CAPTION_WIDTH_MIN = 430
_GRAB_PADDING = 2.0  # pixels, ImGui's own
_TICK_DISTANCE_MIN = 5


def groups(width: float) -> tuple[int, ...]:
    """Return the widths of buttons, "repeat", "beyond τ" and "speed" in a bar, at a scale of 1."""
    return 180, 153 if width >= _CAPTION_WIDTH_MIN else 70, 106, 136


def rows(width: float) -> list[int]:
    """Return the row number of each part of `groups`, in a bar of ``width`` pixels at scale 1."""
    found, used = [0], 0.0
    for needed in groups(width):
        fits = used + needed <= width - PADDING
        found.append(found[-1] + (not fits))
        used = (used if fits else 0) + needed + GAP
    return found[1:]


def height(width: float, scale: float) -> float:
    return (PADDING - 6 + _ROW_HEIGHT * (1 + len(set(rows(width / scale))))) * scale


def draw(context: Context, rect: Rect) -> None:
    ui, before = context.ui, -1
    with window(ui, "time bar", rect), ui.group("time bar"):
        places = rows((rect[2] - rect[0]) / ui.scale)
        extrapolates = context.session.document.extrapolates
        groups = _buttons, _repeat, _beyond, _speed
        for row, draw_group in zip(places, groups, strict=True):
            if draw_group is _beyond and not extrapolates:
                continue
            if row == before:
                ui.same_line(ui.px(GAP))
            draw_group(ui, context.session)
            before = row
        _slider(context)


def _buttons(ui: Ui, session: Session) -> None:
    player, document = session.player, session.document
    times = document.time_after(-STEP), document.time_after(STEP), document.start
    keys = "play", "back", "forward", "start"
    tip, *tips = map(with_key, document.play_tips, keys)
    tip = with_key("Pause.", "play") if player.playing else tip
    if ui.button("Pause" if player.playing else "Play", tip, width=ui.px(52)):
        player.toggle()
    labels = ("<", 26), (">", 26), ("to start", 0)
    for (label, width), time, tip in zip(labels, times, tips, strict=True):
        ui.same_line(ui.px(4))
        if ui.button(label, tip, width=ui.px(width)):
            session.set_time(time)


def _repeat(ui: Ui, session: Session) -> None:
    is_narrow = imgui.GetWindowWidth() < ui.px(_CAPTION_WIDTH_MIN)
    label, width = ("##repeat", 70) if is_narrow else ("repeat", 104)
    tip, player = "Repeat: what happens at the end of the time bar.", session.player
    player.repeat = ui.combo(label, player.repeat, REPEATS, tip, ui.px(width))


def _beyond(ui: Ui, session: Session) -> None:
    tip, player = "Play to 2τ. Beyond τ the flow is extrapolated.", session.player
    player.beyond = ui.checkbox("beyond τ##beyond tau", player.beyond, tip)


def _speed(ui: Ui, session: Session) -> None:
    tip, player = session.document.speed_tip, session.player
    imgui.SetNextItemWidth(ui.px(64))
    speed = ui.slider("speed", player.speed, Range(0.1, 4.0, log=True), tip)
    if speed is not None:
        player.speed = float(f"{speed:.2g}")
    ui.same_line(ui.px(6))
    ui.align()
    ui.line(f"speed {player.speed:g}", "ink")


def _slider(context: Context) -> None:
    ui, session = context.ui, context.session
    document = session.document
    box, spacing = ui.px(64), imgui.GetStyle().ItemInnerSpacing[0]
    width = imgui.GetContentRegionAvail()[0] - box - 2 * spacing - ui.text_width("time")
    left, top = imgui.GetCursorScreenPos()
    rect = (left, top, left + width, top + imgui.GetFrameHeight())
    ends = Range(document.start, document.end)
    note = context.shown.flow.note if document.extrapolates else ""
    about = f"Shown time, {document.time_range_label}."
    tip = note or document.slider_tip
    if document.extrapolates:
        _track(ui, note, rect, document.time / document.end)
    else:
        _ticks(ui, document.ticks, ends, rect)
    grounds = (imgui.ImGuiCol_FrameBg, imgui.ImGuiCol_FrameBgHovered, imgui.ImGuiCol_FrameBgActive)
    for color in grounds:  # transparent, so that the ground is visible
        imgui.PushStyleColor(color, (0, 0, 0, 0))
    imgui.SetNextItemWidth(width)
    slid = ui.slider("time", document.time, ends, tip)
    imgui.PopStyleColor(len(grounds))
    if document.extrapolates:  # the tick at tau, drawn over the grab
        middle, ink = left + width / 2, imgui.GetColorU32(ui.colors.ink)
        imgui.GetWindowDrawList().AddLine((middle, top), (middle, rect[3]), ink, ui.px(1.5))
    if slid is not None:
        session.set_time(slid)
    ui.same_line(spacing)
    typed = ui.text("time", f"{document.time:.4g}", about, width=box)
    if typed is not None:
        if (time := finite(typed)) is None:
            session.notices.show(f"time {typed!r} is not a number; type a number", is_error=True)
        else:
            session.set_time(time)


def _ticks(ui: Ui, times: tuple[float, ...], ends: Range, rect: Rect) -> None:
    """Draw the background of the time slider, with a tick at every frame or every n-th frame."""
    left, top, right, bottom = rect
    colors, canvas, rounding = ui.colors, imgui.GetWindowDrawList(), imgui.GetStyle().FrameRounding
    packed = imgui.GetColorU32
    canvas.AddRectFilled((left, top), (right, bottom), packed(colors.field), rounding)
    inset = imgui.GetStyle().GrabMinSize / 2 + _GRAB_PADDING  # as for ImGui's grab
    start, room = left + inset, right - left - 2 * inset
    every = max(math.ceil(len(times) * ui.px(_TICK_DISTANCE_MIN) / max(room, 1.0)), 1)
    ink = packed((*colors.muted[:3], 0.6))
    for time in times[::every]:
        x = start + ends.share_of(time) * room
        canvas.AddLine((x, bottom - ui.px(7)), (x, bottom - ui.px(1)), ink, ui.px(1))


def _track(ui: Ui, note: str, rect: Rect, share: float) -> None:
    """Draw the background of the time slider, and texts that its grab (the handle) does not cover.

    ``share`` is the position of the grab, 0 to 1. ``note`` is not empty if the flow cannot be
    followed beyond tau.
    """
    left, top, right, bottom = rect
    colors, canvas, rounding = ui.colors, imgui.GetWindowDrawList(), imgui.GetStyle().FrameRounding
    packed, middle, gap = imgui.GetColorU32, (left + right) / 2, ui.px(12)
    canvas.AddRectFilled((left, top), (right, bottom), packed(colors.field), rounding)
    tint, corners = packed((*colors.marker[:3], 0.16)), imgui.ImDrawFlags_RoundCornersRight
    canvas.AddRectFilled((middle, top), (right, bottom), tint, rounding, corners)
    text, color = ("cannot be followed", colors.failure) if note else ("extrapolation", colors.ink)
    width, height = imgui.CalcTextSize(text)
    y, tau = (top + bottom - height) / 2, ui.text_width("τ")
    grab = left + share * (right - left)
    hides_tau = middle - tau - 2 * gap < grab < middle - gap / 2
    beyond = middle + gap if hides_tau else middle - gap - tau
    canvas.AddText((beyond, y), packed(colors.ink), "τ")
    end, start = max(middle, beyond + tau), right - ui.px(6) - width
    if grab > start - gap:
        start = min(start, grab - 2 * gap - width)
    if start > end + gap:
        canvas.AddText((start, y), packed(color), text)
