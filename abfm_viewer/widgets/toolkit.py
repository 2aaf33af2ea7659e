"""Widgets and texts of the window: ImGui's, with a common style, tooltips and error messages.

The label of a widget is the text that the user reads. A different name for scripts, such as that of
a parameter in files, follows after ``###``, as in ``"time τ###tau"``. A label that begins with
``##`` is a name only.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from typing import Any, Literal, NamedTuple, TypeVar

import polyscope.imgui as imgui

from abfm import AbfmError
from abfm_viewer.appearance import theme
from abfm_viewer.appearance.abbreviation import abbreviated
from abfm_viewer.appearance.theme import Color, Palette
from abfm_viewer.document.document import Theme
from abfm_viewer.widgets import placement
from abfm_viewer.widgets.widget_record import Range, Widget, WidgetKind, WidgetRecord

Word = TypeVar("Word", bound=str)
AUTO = "auto"  # text of a number that is chosen automatically
HELP_TEXT = "?"  # of `Ui.help_button`
TextTone = Literal["ink", "muted", "failure", "warning", "good", "source", "target"]
"""Colours of texts, by their names in the theme."""

# lengths at a scale of 1
_TIP_DISTANCE = 8  # movement of the mouse after a click until tooltips appear again
_TIP_WIDTH = 320
_HELP_PADDING = 4
_TIP_GAP = 8
_CAPTION_WIDTH = 96
_CAPTION_SHARE_MAX = 0.45  # of the panel's width
_CAPTION_PANEL_MIN = 280  # narrower panels have captions above the widgets
_PAIR_PANEL_MIN = 300  # narrower panels have one widget in a line
_BOX_WIDTH = 76  # of the box next to a slider
# flags of ImGui; to combine them in every frame takes longer than to draw some widgets
_TIP_FLAGS = imgui.ImGuiHoveredFlags_AllowWhenDisabled | imgui.ImGuiHoveredFlags_DelayShort
_SLIDER_FLAGS = imgui.ImGuiSliderFlags_NoInput | imgui.ImGuiSliderFlags_NoRoundToFormat


class Auto(NamedTuple):
    """Checkbox next to a number; while it is ticked, the solver chooses the number."""

    first: float  # value after the checkbox is cleared
    tip: str


class _WidgetRow(NamedTuple):
    width: float  # of the widgets, from `Ui._placed`
    caption: float
    written: str = ""  # text of the box instead of the value


class Refusals:
    """Reasons why new values of widgets were refused, by `WidgetRecord.path`.

    A refused text stays in its box.
    """

    def __init__(self, record: WidgetRecord) -> None:
        self.reasons: dict[str, str] = {}
        self.texts: dict[str, str] = {}  # of boxes, in place of their values
        self.entered: dict[str, str] = {}  # in this frame; kept if they are refused
        self._record = record
        self._accepted: tuple[object, ...] = ()

    def refuse(self, name: str, reason: str) -> None:
        self.accept(name)
        key = self._record.path(name)
        self.reasons[key] = reason
        if key in self.entered:
            self.texts[key] = self.entered[key]

    def accept(self, name: str) -> None:
        for known in (self.reasons, self.texts):
            known.pop(self._record.path(name), None)

    @contextmanager
    def refusing(self, name: str, label: str = "") -> Iterator[None]:
        """Refuse the new value of a widget if the block raises an `AbfmError`.

        In a message that begins with the name of the widget, its label replaces the name.
        """
        self.accept(name)
        try:
            yield
        except AbfmError as error:
            reason = str(error)
            is_named = label and reason.startswith(f"{name} ")
            self.refuse(name, f"{label}{reason[len(name) :]}" if is_named else reason)

    def accept_after(self, *values: object) -> None:
        """Remove all refusals if a value is not that of the previous call: the user changed it."""
        if list(map(id, values)) != list(map(id, self._accepted)):
            for key in self.reasons:
                self.texts.pop(key, None)
            self.reasons.clear()
        self._accepted = values


class Ui:
    """Draws widgets and texts, and records their positions."""

    def __init__(self) -> None:
        self.scale = 1.0  # pixels per unit of length
        self.colors: Palette = theme.LIGHT_PALETTE
        self.record = WidgetRecord()
        self.refusals = Refusals(self.record)
        # whether frames are drawn for a picture, for which polyscope makes a new ImGui context
        self.capturing = False
        self.typing = False  # whether the latest box has or just lost the keyboard focus
        # the box that had the keyboard focus last, and the box that gets it next
        self.active_box = self.focus_next = ""
        self.open_tab = ""
        self.open_sections: dict[str, bool] = {}
        self.scrolls: dict[str, float] = {}
        self.heights: dict[str, float] = {}  # heights of children by their names
        # heights of the invisible parts of windows and children, by their names
        self.hidden_heights: dict[str, float] = {}
        # whether widgets are only recorded, with all choices and closed sections, and not visible
        self.listing = False
        self.wanted: Widget | None = None  # acts once as if the user had used it
        self._clicked_at: tuple[float, float] | None = None
        self._reason = ""  # why the widgets of the current block are disabled

    @property
    def widgets(self) -> list[Widget]:
        return self.record.latest

    def begin_frame(self, scale: float, name: Theme) -> None:
        self.scale, self.colors = scale, theme.palette(name)
        io = imgui.GetIO()
        self.record.begin_frame((0, 0, *io.DisplaySize))
        self.refusals.entered.clear()
        if imgui.IsMouseClicked(0):
            self._clicked_at = tuple(io.MousePos)
        elif self._clicked_at and math.dist(self._clicked_at, io.MousePos) > self.px(_TIP_DISTANCE):
            self._clicked_at = None

    @contextmanager
    def unseen(self) -> Iterator[WidgetRecord]:
        """Record the widgets of the block, which are not visible, in a separate record."""
        record, self.record, self.listing = self.record, WidgetRecord(), True
        self.record.begin_frame(record.areas[0])
        try:
            yield self.record
        finally:
            self.record.end_frame()
            self.record, self.listing = record, False

    def px(self, length: float) -> float:
        return length * self.scale

    @contextmanager
    def disabled(self, condition: bool = True, reason: str = "") -> Iterator[None]:
        """Draw the widgets of the block as disabled if ``condition``, and paler behind a dialog.

        Their tooltips begin with the reason.
        """
        if not condition:
            yield
            return
        style = imgui.GetStyle()
        alpha = style.Alpha * (1.0 if self.record.enabled else style.DisabledAlpha)
        with Pushed({}, {imgui.ImGuiStyleVar_Alpha: alpha}), self.record.disabled():
            imgui.BeginDisabled()
            before, self._reason = self._reason, reason or self._reason
            try:
                yield
            finally:
                self._reason = before
                imgui.EndDisabled()

    @contextmanager
    def group(self, name: str) -> Iterator[None]:
        """Draw the widgets of the block in a group, so that labels need not be unique."""
        imgui.PushID(name)
        try:
            with self.record.within(name):
                yield
        finally:
            imgui.PopID()

    def note(self, text: str, kind: TextTone = "muted", room: float = 0) -> None:
        """Write text that wraps at the panel's edge, or after ``room`` pixels."""
        imgui.PushTextWrapPos(imgui.GetCursorPosX() + room if room else 0)
        self._write(text, getattr(self.colors, kind))
        imgui.PopTextWrapPos()

    def line(self, text: str, kind: TextTone = "muted", tip: str = "", room: float = 0) -> None:
        """Write text on one line; if it is too wide, abbreviate it and show it in the tooltip."""
        shown = self.fitted(text, room or imgui.GetContentRegionAvail()[0])
        self._write(shown, getattr(self.colors, kind))
        self.tip(_in_full(text, shown, tip))

    def heading(self, text: str, color: Color | None = None, buttons: Sequence[str] = ()) -> None:
        """Write a title, followed by a horizontal line up to the right end of the panel.

        The line leaves space for ``buttons``, which are drawn next.
        """
        left, _ = imgui.GetCursorScreenPos()
        right = left + imgui.GetContentRegionAvail()[0]
        spacing, padding = imgui.GetStyle().ItemSpacing[0], 2 * imgui.GetStyle().FramePadding[0]
        room = sum(self.text_width(label) + padding + spacing for label in buttons)
        if room > right - left - self.text_width(text) - spacing:
            room = 0
        if room:
            self.align()
        shown = self.fitted(text, right - left)
        self._write(shown, color or self.colors.muted)
        self.tip(_in_full(text, shown, ""))
        (_, above), (end, below) = imgui.GetItemRectMin(), imgui.GetItemRectMax()
        y, start, stop = round((above + below) / 2), end + spacing, right - room
        if start < stop:
            ink = imgui.GetColorU32(self.colors.border)
            imgui.GetWindowDrawList().AddLine((start, y), (stop, y), ink, self.px(1))
        if room:
            self.same_line(stop + spacing - end)

    def align(self) -> None:
        imgui.AlignTextToFramePadding()

    def same_line(self, spacing: float = -1) -> None:
        imgui.SameLine(0, spacing)

    def same_line_if_fits(self, label: str, is_button: bool = False, width: float = 0) -> bool:
        """Draw the next checkbox or button on the same line if it fits; return whether it does.

        ``width`` is the width of a button that is not as wide as its label.
        """
        right = imgui.GetCursorScreenPos()[0] + imgui.GetContentRegionAvail()[0]
        style = imgui.GetStyle()
        more = style.ItemSpacing[0] + 2 * style.FramePadding[0] if is_button else self.px(42)
        taken = width + style.ItemSpacing[0] if width else self.text_width(label) + more
        if fits := imgui.GetItemRectMax()[0] + taken <= right + 1:
            self.same_line()
        return bool(fits)

    def remaining_width(self, label: str) -> float:
        """Return the width that remains on a line whose right end is a button with this label."""
        style = imgui.GetStyle()
        button = self.text_width(label) + 2 * style.FramePadding[0]
        return float(imgui.GetContentRegionAvail()[0] - style.ItemSpacing[0] - button)

    def at_right_end(self, label: str) -> None:
        """Draw the next button at the right end of the same line."""
        self.same_line()
        room = self.remaining_width(label) + imgui.GetStyle().ItemSpacing[0]
        imgui.SetCursorPosX(imgui.GetCursorPosX() + max(room, 0.0))

    def text_width(self, text: str) -> float:
        return float(imgui.CalcTextSize(text)[0])

    def fitted(self, text: str, room: float) -> str:
        """Return a text, abbreviated with an ellipsis if it is wider than ``room`` pixels."""
        return abbreviated(text, room + 0.5, self.text_width)

    def tip(self, text: str) -> None:
        """Give the previous widget a tooltip, which covers neither the widget nor its neighbours.

        Disabled widgets have tooltips as well. During a drag, and after a click until the mouse
        moves, no tooltip is shown.
        """
        text = self._reasoned(text)
        if self.listing and text:
            self.record.describe(text)
        if not text or self._clicked_at is not None or imgui.IsMouseDown(0):
            return
        if not imgui.IsItemHovered(_TIP_FLAGS):
            return
        item = (*imgui.GetItemRectMin(), *imgui.GetItemRectMax())
        (left, top), width = imgui.GetWindowPos(), imgui.GetWindowWidth()
        own = (left, top, left + width, top + imgui.GetWindowHeight())
        area = placement.hull(own, *self.record.areas[1:2])
        padding, window = imgui.GetStyle().WindowPadding, self.record.areas[0]
        room = placement.side_room(area, window) - self.px(_TIP_GAP) - 2 * padding[0]
        room = min(room, self.px(_TIP_WIDTH)) if room > self.px(_TIP_WIDTH / 2) else 0.0
        wide, high = imgui.CalcTextSize(text, False, room or self.px(_TIP_WIDTH))
        size = wide + 2 * padding[0], high + 2 * padding[1]
        place = placement.beside(item, area, window, size, self.px(_TIP_GAP))
        imgui.SetNextWindowPos(place, imgui.ImGuiCond_Always)
        imgui.BeginTooltip()
        imgui.PushTextWrapPos(padding[0] + wide + 1)
        imgui.TextUnformatted(text)
        imgui.PopTextWrapPos()
        imgui.EndTooltip()

    def _reasoned(self, tip: str) -> str:
        is_new = not tip.startswith(self._reason)
        return "\n\n".join(filter(None, [self._reason, tip])) if is_new else tip

    def refusal(self, name: str, otherwise: str = "") -> None:
        """Write why the new value of a widget was refused, or else the text ``otherwise``."""
        if reason := self.refusals.reasons.get(self.record.path(name), "") or otherwise:
            self.note(reason, "failure")

    def _write(self, text: str, color: Color) -> None:
        imgui.PushStyleColor(imgui.ImGuiCol_Text, color)
        imgui.TextUnformatted(text)
        imgui.PopStyleColor(1)

    def button(
        self,
        label: str,
        tip: str = "",
        *,
        enabled: bool = True,
        primary: bool = False,
        width: float = 0,
    ) -> bool:
        """Draw a button; return whether it was pressed.

        A negative width leaves that much space at the right of the button.
        """
        text, name = _text_and_name(label)
        room = width if width > 0 else imgui.GetContentRegionAvail()[0] + width
        room = max(room, imgui.GetFrameHeight())
        spare = max((room - self.text_width(text)) / 2, self.px(2))
        across, down = imgui.GetStyle().FramePadding
        padding = min(across, spare)
        shown = self.fitted(text, room - 2 * padding)
        width = width or (0 if shown == text else room)
        ink = self.colors
        colors = {
            imgui.ImGuiCol_Button: ink.accent,
            imgui.ImGuiCol_ButtonHovered: ink.accent_hovered,
            imgui.ImGuiCol_ButtonActive: ink.accent_hovered,
            imgui.ImGuiCol_Text: ink.accent_ink,
        }
        with self.disabled(not enabled):
            with Pushed(
                colors if primary else {}, {imgui.ImGuiStyleVar_FramePadding: (padding, down)}
            ):
                pressed = bool(imgui.Button(f"{shown}###{text}", (width, 0)))
            pressed |= self._finish(text, "button", tip, shown, name=name)
        return pressed

    @property
    def help_width(self) -> float:
        return self.text_width(HELP_TEXT) + 2 * self.px(_HELP_PADDING)

    @property
    def room_before_help(self) -> float:
        """Width that remains for a text before a button "?" on the same line."""
        taken = imgui.GetStyle().ItemSpacing[0] + self.help_width
        return float(imgui.GetContentRegionAvail()[0] - taken)

    def help_button(self, name: str, tip: str) -> bool:
        """Draw a small button "?" with a name for scripts; return whether it was pressed."""
        with Pushed({}, {imgui.ImGuiStyleVar_FramePadding: (self.px(_HELP_PADDING), 0)}):
            pressed = bool(imgui.SmallButton(f"{HELP_TEXT}###{name}"))
        return self._finish(HELP_TEXT, "button", tip, name=name) or pressed

    def checkbox(self, label: str, value: bool, tip: str = "") -> bool:
        text, name = _text_and_name(label)
        shown = self._fitted_next_to_box(text)
        with self._outlined():
            _, value = imgui.Checkbox(f"{shown}###{name or text}", value)
        state = "on" if value else "off"
        is_wanted = self._finish(text, "checkbox", tip, shown, name=name, text=state)
        return bool(value) != is_wanted

    def combo(
        self,
        label: str,
        value: Word,
        choices: Sequence[Word] | Mapping[Word, str],
        tip: str = "",
        width: float = 0,
    ) -> Word:
        """Draw a drop-down list; return the chosen word. A mapping has a tooltip for each word."""
        text, name = _text_and_name(label)
        width, caption = self._placed(text, width)
        text = text or name
        imgui.SetNextItemWidth(width)
        arrow = imgui.GetFrameHeight() + imgui.GetStyle().FramePadding[0]
        preview = self.fitted(value, width - arrow)
        is_open = imgui.BeginCombo(f"##{text}", preview, imgui.ImGuiComboFlags_HeightLargest)
        tip = "" if is_open else _in_full(value, preview, tip)
        self.record_item(text, "combo", tip=tip, shown=text, name=name, text=value)
        if is_open:
            value = self._chosen(name or text, value, choices)
        else:
            self.tip(tip)
            value = self._wanted_choice(name or text, value, choices)
        self._caption(text, caption, tip)
        return value

    def _wanted_choice(
        self, name: str, value: Word, choices: Sequence[Word] | Mapping[Word, str]
    ) -> Word:
        """Return the wanted choice of a closed list, or ``value``; while listing, record all."""
        with self.record.within(name):
            for choice in choices if self.listing else ():
                tip = choices[choice] if isinstance(choices, Mapping) else ""
                self.record_item(choice, "choice", tip=tip)
            wanted, enabled = self.wanted, self.record.enabled
            for choice in choices if wanted and enabled and not self.listing else ():
                if wanted and wanted.key == (self.record.path(choice)[1:], "choice", ""):
                    self.wanted, value = None, choice
        return value

    def _chosen(self, name: str, value: Word, choices: Sequence[Word] | Mapping[Word, str]) -> Word:
        tips = choices if isinstance(choices, Mapping) else {}
        try:
            # the list may be drawn outside its panel
            with self.record.within(name, self.record.areas[0]):
                for choice in choices:
                    text = "chosen" if choice == value else ""
                    if imgui.Selectable(choice, choice == value):
                        value = choice
                    self._finish(choice, "choice", tips.get(choice, ""), text=text)
        finally:
            close_by_escape()
            imgui.EndCombo()
        return value

    def radio(self, choices: Sequence[Word], value: Word, tips: Sequence[str]) -> Word:
        """Draw radio buttons, next to each other as far as they fit; return the chosen word."""
        for number, (choice, tip) in enumerate(zip(choices, tips, strict=True)):
            if number:
                self.same_line_if_fits(choice)
            shown = self._fitted_next_to_box(choice)
            with self._outlined():
                if imgui.RadioButton(f"{shown}###{choice}", choice == value):
                    value = choice
            state = "chosen" if choice == value else ""
            if self._finish(choice, "choice", tip, shown, text=state):
                value = choice
        return value

    def number(self, label: str, value: float, ends: Range, tip: str) -> float | None:
        """Draw a slider with a text box, which accepts any number; return a new value or None."""
        text, name = _text_and_name(label)
        new = self._slider_and_box(label, _WidgetRow(*self._placed(text)), value, ends, tip)
        return self._understood(name or text, new)

    def number_or_auto(
        self, label: str, value: float | None, ends: Range, tip: str, auto: Auto | None
    ) -> float | str | None:
        """Draw a slider with a text box, and a checkbox for an automatic choice (value None).

        Return a new value, `AUTO` if the user ticked the checkbox, or None if nothing changed.
        Without ``auto``, there is no checkbox.
        """
        if auto is None:
            return self.number(label, value or 0.0, ends, tip)
        text, name = _text_and_name(label)
        width, caption = self._placed(text)
        left, is_auto = imgui.GetCursorPosX(), value is None
        ticked = self.checkbox(f"{AUTO}##{AUTO} {name or text}", is_auto, auto.tip)
        self.same_line()
        taken = imgui.GetCursorPosX() - left
        row = _WidgetRow(width - taken, caption, AUTO if is_auto else "")
        with Pushed({imgui.ImGuiCol_SliderGrab: self.colors.muted} if is_auto else {}):
            shown = auto.first if value is None else value
            new = self._slider_and_box(label, row, shown, ends, tip)
        if ticked != is_auto:
            new = AUTO if ticked else auto.first
        if isinstance(new, str) and new.strip() == AUTO:
            self.refusals.accept(name or text)
            return AUTO
        return self._understood(name or text, new)

    def _slider_and_box(
        self, label: str, row: _WidgetRow, value: float, ends: Range, tip: str
    ) -> float | str | None:
        """Draw slider, box and caption; return a number from the slider, a typed text, or None."""
        text, name = _text_and_name(label)
        spacing = imgui.GetStyle().ItemInnerSpacing[0]
        box = min(self.px(_BOX_WIDTH), row.width / 2)
        imgui.SetNextItemWidth(row.width - box - spacing)
        slid = self.slider(label, value, ends, tip)
        if slid is not None:
            # a slider has a resolution of about three digits
            slid = float(round(slid)) if ends.is_integer else float(f"{slid:.3g}")
            self.refusals.accept(name or text)
        self.same_line(spacing)
        written = row.written or (f"{round(value)}" if ends.is_integer else f"{value:.6g}")
        typed = self._box(label, written, tip, width=box)
        self._caption(text, row.caption, tip)
        return slid if typed is None else typed

    def _understood(self, key: str, new: float | str | None) -> float | None:
        """Return the selected or typed number, or None; refuse a text that is not a number."""
        number = finite(new) if isinstance(new, str) else new
        if isinstance(new, str) and number is None:
            self.refusals.refuse(key, f"{new!r} is not a number")
        elif number is not None:
            self.refusals.accept(key)
        self.refusal(key)
        return number

    def bounded(
        self, label: str, value: float, ends: Range, tip: str, limits: tuple[float, float]
    ) -> float:
        """Draw a slider with a text box; return the new or old value, clipped to the limits."""
        new = self.number(label, value, ends, tip)
        return value if new is None else min(max(new, limits[0]), limits[1])

    def slider(self, label: str, value: float, ends: Range, tip: str) -> float | None:
        """Draw a slider, without a number, in ImGui's next width; return a new value or None."""
        text, name = _text_and_name(label)
        share = ends.share_of(ends.nearest(value))
        changed, share = imgui.SliderFloat(f"##{text} slider", share, 0.0, 1.0, "", _SLIDER_FLAGS)
        grab, written = imgui.GetStyle().GrabMinSize, f"{value:.6g}"
        self.record_item(text, "slider", ends=ends, grab=grab, text=written, name=name, tip=tip)
        self.tip(tip)
        return ends.value_at(share) if changed else None

    def text(
        self, label: str, value: str, tip: str = "", *, hint: str = "", width: float = 0
    ) -> str | None:
        """Draw a text box; return the new text when the user presses Enter or leaves the box.

        The result is None in all other frames. Escape discards the text.
        """
        shown, _ = _text_and_name(label)
        width, caption = self._placed(shown, width)
        text = self._box(label, value, tip, hint=hint, width=width)
        self._caption(shown, caption, tip)
        return text

    def _box(self, label: str, value: str, tip: str, *, width: float, hint: str = "") -> str | None:
        text, name = _text_and_name(label)
        key, refusals = self.record.path(name or text), self.refusals
        imgui.SetNextItemWidth(width)
        if key == self.focus_next:
            imgui.SetKeyboardFocusHere()
            self.focus_next = ""
        typed = _input(text, hint, refusals.texts.get(key, value))
        is_longer = self.text_width(typed) > width - 2 * imgui.GetStyle().FramePadding[0]
        full_tip = _in_full(typed, "" if is_longer else typed, tip)
        if self._finish(text, "box", full_tip, name=name, text=typed):
            self.focus_next = key
        is_active, is_done = imgui.IsItemActive(), imgui.IsItemDeactivated()
        self.typing = bool(is_active or is_done)
        if is_active:
            self.active_box = key
            refusals.texts[key] = typed
        if not is_done:
            return None
        if imgui.IsKeyPressed(imgui.ImGuiKey_Escape) or typed == value:
            refusals.accept(name or text)
            return None
        refusals.texts.pop(key, None)
        refusals.entered[key] = typed
        return typed

    def live_text(
        self, label: str, value: str, hint: str, *, focus: bool = False, width: float = 0
    ) -> str:
        """Draw a text box; return its text in each frame. ``focus`` gives it the keyboard focus."""
        text, name = _text_and_name(label)
        width, caption = self._placed(text, width)
        imgui.SetNextItemWidth(width)
        if focus:
            imgui.SetKeyboardFocusHere()
        value = _input(label, hint, value)
        self.typing = bool(imgui.IsItemActive())
        self.record_item(text, "box", text=value, name=name)
        self._caption(text, caption, "")
        return value

    def row(self, label: str, chosen: bool, room: float = 0) -> tuple[bool, bool]:
        """Draw a row of a list; return whether it was clicked, and whether double-clicked.

        The label is at most ``room`` pixels wide, by default as wide as the list.
        """
        shown = self.fitted(label, room or imgui.GetContentRegionAvail()[0])
        text = shown.replace("##", "# #")  # ImGui hides text after ##
        flags = imgui.ImGuiSelectableFlags_AllowDoubleClick
        clicked = bool(imgui.Selectable(f"{text}###{label}", chosen, flags))
        self._finish(label, "choice", "", shown, text="chosen" if chosen else "")
        return clicked, clicked and bool(imgui.IsMouseDoubleClicked(0))

    def sort_arrow(self, falls: bool) -> None:
        """Draw an arrow in the previous widget, the heading of the column that sorts a list."""
        (_, top), (right, bottom) = imgui.GetItemRectMin(), imgui.GetItemRectMax()
        size, x, y = self.px(3.5), right - self.px(7), (top + bottom) / 2
        tip, base = (y + size, y - size) if falls else (y - size, y + size)
        ink = imgui.GetColorU32(self.colors.accent)
        corners = (x - size, base), (x + size, base), (x, tip)
        imgui.GetWindowDrawList().AddTriangleFilled(*corners, ink)

    def record_item(self, label: str, kind: WidgetKind, **details: Any) -> bool:
        """Record ImGui's latest item as a `Widget`; return whether it should act now."""
        rect = (*imgui.GetItemRectMin(), *imgui.GetItemRectMax())
        if self._reason:
            details["tip"] = self._reasoned(details.get("tip", ""))
        widget = self.record.add(label, kind, rect, **details)
        if self.wanted is None or not widget.enabled or widget.key != self.wanted.key:
            return False
        self.wanted = None
        imgui.SetScrollHereY(0.5)
        return True

    def _finish(
        self, label: str, kind: WidgetKind, tip: str, shown: str | None = None, **details: Any
    ) -> bool:
        """Record the previous widget, whose visible label is ``shown``, and add its tooltip.

        Return whether it should act, as after a click.
        """
        shown = shown or label
        tip = _in_full(label, shown, tip)
        is_wanted = self.record_item(label, kind, tip=tip, shown=shown, **details)
        self.tip(tip)
        return is_wanted

    @contextmanager
    def _outlined(self) -> Iterator[None]:
        """Draw the widgets of the block with an outline, which makes checkboxes visible."""
        edge = {imgui.ImGuiCol_Border: (*self.colors.muted[:3], 0.7)}
        with Pushed(edge, {imgui.ImGuiStyleVar_FrameBorderSize: max(1.0, self.scale)}):
            yield

    def _fitted_next_to_box(self, label: str) -> str:
        """Return a label, abbreviated if it does not fit next to a checkbox or a radio button."""
        box = imgui.GetFrameHeight() + imgui.GetStyle().ItemInnerSpacing[0]
        return self.fitted(label, imgui.GetContentRegionAvail()[0] - box)

    def halves(self, left: str, right: str, choice: str = "") -> tuple[float, float]:
        """Return the widths of two widgets that fill a line with captions; 0 if too narrow.

        The left one is wide enough for a drop-down list with the text ``choice``.
        """
        room, gap = imgui.GetContentRegionAvail()[0], imgui.GetStyle().ItemInnerSpacing[0]
        if room < self.px(_PAIR_PANEL_MIN):
            return 0.0, 0.0
        cell = (room - imgui.GetStyle().ItemSpacing[0]) / 2 - gap
        first, second = cell - self.text_width(left), cell - self.text_width(right)
        list_width = self.text_width(choice) + imgui.GetFrameHeight()  # with its arrow
        missing = max(list_width + 2 * imgui.GetStyle().FramePadding[0] - first, 0) * bool(choice)
        return first + missing, second - missing

    @property
    def captions_are_above(self) -> bool:
        """Whether captions are above widgets, because the panel is narrow."""
        return float(imgui.GetContentRegionAvail()[0]) < self.px(_CAPTION_PANEL_MIN)

    def _placed(self, label: str, width: float = 0) -> tuple[float, float]:
        """Return the widths of the next widget and its caption, 0 if the caption is above it."""
        room, gap = float(imgui.GetContentRegionAvail()[0]), imgui.GetStyle().ItemInnerSpacing[0]
        if width:
            return width, self.text_width(label)
        if self.captions_are_above:
            self.line(label, "ink")
            return room, 0.0
        widest = _CAPTION_SHARE_MAX * room
        caption = max(min(self.text_width(label), widest), self.px(_CAPTION_WIDTH))
        return room - caption - gap, caption

    def _caption(self, label: str, room: float, tip: str) -> None:
        """Write the caption next to the previous widget, in the width that `_placed` returned."""
        if room:
            self.same_line(imgui.GetStyle().ItemInnerSpacing[0])
            self.align()
            self.line(label, "ink", tip, room)


class Pushed:
    """A context manager that draws its block with other colours and style variables of ImGui."""

    def __init__(
        self,
        colors: Mapping[int, Color],
        variables: Mapping[int, float | tuple[float, float]] | None = None,
    ) -> None:
        self._colors, self._variables = colors, variables or {}

    def __enter__(self) -> None:
        for index, color in self._colors.items():
            imgui.PushStyleColor(index, color)
        for index, value in self._variables.items():
            imgui.PushStyleVar(index, value)

    def __exit__(self, *error: object) -> None:
        imgui.PopStyleVar(len(self._variables))
        imgui.PopStyleColor(len(self._colors))


def close_by_escape() -> None:
    """Close the open list on Escape, which ImGui does only with keyboard navigation."""
    if imgui.IsKeyPressed(imgui.ImGuiKey_Escape, False):
        imgui.CloseCurrentPopup()


def finite(text: str) -> float | None:
    with suppress(ValueError):
        number = float(text)
        return number if math.isfinite(number) else None
    return None


def _text_and_name(label: str) -> tuple[str, str]:
    """Split a label into its text and its name for scripts, which is empty if they are equal."""
    text, _, name = label.partition("##")
    return text, name.removeprefix("#")


def _input(label: str, hint: str, value: str) -> str:
    flags = imgui.ImGuiInputTextFlags_AutoSelectAll
    return str(imgui.InputTextWithHint(f"##{label}", hint, value, flags)[1])


def _in_full(text: str, shown: str, tip: str) -> str:
    """Return a tooltip, which begins with the complete text if only a part of it is shown."""
    return "\n\n".join(filter(None, ["" if shown == text else text, tip]))
