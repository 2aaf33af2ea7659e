"""The window's widgets: ImGui's, with one look, tooltips, and what is refused said in place."""

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import Literal, TypeVar

import polyscope.imgui as imgui

from abfm import AbfmError
from abfm_viewer.appearance.theme import Color
from abfm_viewer.document.document import Theme
from abfm_viewer.widgets.containers import Containers, close_by_escape
from abfm_viewer.widgets.slider_scale import share_of, value_at

Word = TypeVar("Word", bound=str)
Kind = Literal["ink", "muted", "failure", "good", "source", "target"]
"""Colours of texts, by their names in the theme."""
_AWAY = 8  # how far the mouse moves before tooltips come again


class Ui(Containers):
    """Draws widgets, in containers, and remembers them."""

    def __init__(self) -> None:
        super().__init__()
        self._texts: dict[str, str] = {}
        self._refused: dict[str, str] = {}
        self._clicked_at: tuple[float, float] | None = None

    def begin_frame(self, scale: float, name: Theme) -> None:
        super().begin_frame(scale, name)
        x, y = imgui.GetIO().MousePos
        if imgui.IsMouseClicked(0):
            self._clicked_at = (x, y)
        elif self._clicked_at and math.dist(self._clicked_at, (x, y)) > self.px(_AWAY):
            self._clicked_at = None

    # Widgets

    def button(
        self, label: str, tip: str = "", *, enabled: bool = True, primary: bool = False, width: float = 0
    ) -> bool:
        """A button; whether it was pressed. A negative width leaves that much at the right, in pixels."""
        with self.disabled(not enabled):
            if primary:
                imgui.PushStyleColor(imgui.ImGuiCol_Button, self.colors.accent)
                imgui.PushStyleColor(imgui.ImGuiCol_ButtonHovered, self.colors.accent_hovered)
                imgui.PushStyleColor(imgui.ImGuiCol_ButtonActive, self.colors.accent_hovered)
                imgui.PushStyleColor(imgui.ImGuiCol_Text, self.colors.accent_ink)
            pressed = bool(imgui.Button(label, (width, 0)))
            if primary:
                imgui.PopStyleColor(4)
            self.record(label, "button")
        self.tip(tip)
        return pressed

    def checkbox(self, label: str, value: bool, tip: str = "") -> bool:
        """A box to tick; its new value."""
        _, value = imgui.Checkbox(label, value)
        self.record(label, "checkbox", text="on" if value else "off")
        self.tip(tip)
        return bool(value)

    def combo(self, label: str, value: Word, choices: Sequence[Word], tip: str = "", width: float = 0) -> Word:
        """One of several words; its new value. A width in pixels, or what the label leaves."""
        imgui.SetNextItemWidth(width or self._width_beside(label))
        is_open = imgui.BeginCombo(label, value, imgui.ImGuiComboFlags_HeightLargest)
        self.record(label, "combo", text=value)
        if is_open:
            try:
                record = self._widget_record
                with record.section(label), record.area(record.window):  # the list may be drawn outside its panel
                    for choice in choices:
                        chosen = imgui.Selectable(choice, choice == value)
                        self.record(choice, "choice", text="chosen" if choice == value else "")
                        value = choice if chosen else value
            finally:
                close_by_escape()
                imgui.EndCombo()
        else:
            self.tip(tip)
        return value

    def radio(self, choices: Sequence[Word], value: Word, tips: Sequence[str] = ()) -> Word:
        """One of a few words, side by side, on further lines where the panel ends; its new value."""
        right = imgui.GetCursorScreenPos()[0] + imgui.GetContentRegionAvail()[0]
        for number, choice in enumerate(choices):
            if number:
                needed = imgui.CalcTextSize(choice)[0] + imgui.GetFrameHeight() + self.px(16)
                if imgui.GetItemRectMax()[0] + needed < right:
                    imgui.SameLine()
            if imgui.RadioButton(choice, choice == value):
                value = choice
            self.record(choice, "choice", text="chosen" if choice == value else "")
            self.tip(tips[number] if tips else "")
        return value

    def number(
        self, label: str, value: float, low: float, high: float, tip: str, *, log: bool = False, whole: bool = False
    ) -> float | None:
        """A slider with a box to type into, which takes values beyond the slider's ends; a new value, or None.

        A text that is no number is refused in place. Whole numbers keep their type in the display. A logarithmic
        slider from 0 has 0 at its left end, and six decades.
        """
        box = self.px(76)
        spacing = imgui.GetStyle().ItemInnerSpacing[0]
        width = max(self._width_beside(label) - box - spacing, self.px(40))
        result = self.slider(label, value, low, high, tip, width=width, log=log)
        if result is not None:
            result = float(round(result)) if whole else float(f"{result:.3g}")  # what a slider is good for
            self.refuse(label, "")
        imgui.SameLine(0, spacing)
        text = self.text(label, f"{round(value)}" if whole else f"{value:.6g}", tip, width=box)
        if text is not None:
            typed = finite(text)
            result = result if typed is None else typed
            self.refuse(label, f"{text!r} is no number" if typed is None else "")
        self.refusal(label)
        return result

    def slider(
        self, label: str, value: float, low: float, high: float, tip: str, *, width: float, log: bool = False
    ) -> float | None:
        """A slider without a text; a new value, or None."""
        imgui.SetNextItemWidth(width)
        flags = imgui.ImGuiSliderFlags_NoInput | imgui.ImGuiSliderFlags_NoRoundToFormat
        shown = share_of(min(max(value, low), high), low, high, log)
        changed, share = imgui.SliderFloat(f"##{label} slider", shown, 0.0, 1.0, "", flags)
        self.record(label, "slider", low=low, high=high, log=log, text=f"{value:.6g}")
        self.tip(tip)
        return value_at(share, low, high, log) if changed else None

    def text(self, label: str, value: str, tip: str = "", *, hint: str = "", width: float = 0) -> str | None:
        """A box to type into; the new text when Enter is pressed or the box is left, else None."""
        key = self._widget_record.path(label)
        imgui.SetNextItemWidth(width or self._width_beside(label))
        shown = self._texts.get(key, value)
        _, typed = imgui.InputTextWithHint(label, hint, shown, imgui.ImGuiInputTextFlags_AutoSelectAll)
        self.record(label, "box", text=typed)
        self.tip(tip)
        if imgui.IsItemActive():
            self._texts[key] = typed
        if imgui.IsItemDeactivated():
            self._texts.pop(key, None)
            if typed != value and not imgui.IsKeyPressed(imgui.ImGuiKey_Escape):
                return str(typed)
        return None

    def live_text(self, label: str, value: str, hint: str, focus: bool) -> str:
        """A box to type into; what it holds now. `focus` puts the keyboard there."""
        imgui.SetNextItemWidth(self._width_beside(label))
        if focus:
            imgui.SetKeyboardFocusHere()
        _, value = imgui.InputTextWithHint(label, hint, value, imgui.ImGuiInputTextFlags_AutoSelectAll)
        self.record(label, "box", text=value)
        return str(value)

    def row(self, label: str, chosen: bool) -> tuple[bool, bool]:
        """A row of a list; whether it was clicked, and whether twice in a row."""
        text = label.replace("##", "# #")  # which would hide the rest
        clicked = bool(imgui.Selectable(text, chosen, imgui.ImGuiSelectableFlags_AllowDoubleClick))
        self.record(label, "choice", text="chosen" if chosen else "")
        return clicked, clicked and bool(imgui.IsMouseDoubleClicked(0))

    def refuse(self, label: str, reason: str) -> None:
        """Say below the widget of this label why its new value was not taken; empty to say nothing any more."""
        self._refused.pop(self._widget_record.path(label), None)
        if reason:
            self._refused[self._widget_record.path(label)] = reason

    @contextmanager
    def refusing(self, label: str) -> Iterator[None]:
        """Say so below the widget of this label if the block refuses its new value with an error."""
        self.refuse(label, "")
        try:
            yield
        except AbfmError as error:
            self.refuse(label, str(error))

    def accept_all(self) -> None:
        """Take back all refusals in this section."""
        here = self._widget_record.path("")
        self._refused = {key: reason for key, reason in self._refused.items() if not key.startswith(here)}

    def refusal(self, label: str) -> None:
        """Show what `refuse` was told."""
        if reason := self._refused.get(self._widget_record.path(label)):
            self.note(reason, "failure")

    # Text and space

    def note(self, text: str, kind: Kind = "muted") -> None:
        """Text that wraps at the panel's edge."""
        imgui.PushStyleColor(imgui.ImGuiCol_Text, getattr(self.colors, kind))
        imgui.PushTextWrapPos(0)
        imgui.TextUnformatted(text)
        imgui.PopTextWrapPos()
        imgui.PopStyleColor()

    def heading(self, text: str, color: Color | None = None) -> None:
        """A title inside a section, with a line."""
        imgui.PushStyleColor(imgui.ImGuiCol_Text, color or self.colors.muted)
        imgui.SeparatorText(text)
        imgui.PopStyleColor()

    def beside(self, spacing: float = -1) -> None:
        imgui.SameLine(0, spacing)

    def beside_if_fits(self, label: str) -> None:
        """Put the next button or checkbox on the same line where there is room for it."""
        right = imgui.GetCursorScreenPos()[0] + imgui.GetContentRegionAvail()[0]
        if imgui.GetItemRectMax()[0] + imgui.CalcTextSize(label)[0] + self.px(48) < right:
            imgui.SameLine()

    def tip(self, text: str) -> None:
        """A tooltip for the widget before; also where it is disabled.

        Who has just clicked wants to see what comes of it: there is none until the mouse moves.
        """
        flags = imgui.ImGuiHoveredFlags_AllowWhenDisabled | imgui.ImGuiHoveredFlags_DelayShort
        if text and self._clicked_at is None and imgui.IsItemHovered(flags):
            imgui.BeginTooltip()
            imgui.PushTextWrapPos(self.px(340))
            imgui.TextUnformatted(text)
            imgui.PopTextWrapPos()
            imgui.EndTooltip()

    def _width_beside(self, label: str) -> float:
        """What the panel leaves beside a label, which all have the same room."""
        room = max(imgui.CalcTextSize(label.partition("##")[0])[0] + self.px(8), self.px(104))
        return max(float(imgui.GetContentRegionAvail()[0] - room), self.px(60))


def finite(text: str) -> float | None:
    """The number that a text says; None if it says none, or not a finite one."""
    with suppress(ValueError):
        number = float(text)
        return number if math.isfinite(number) else None
    return None
