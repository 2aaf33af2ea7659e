"""The window's widgets: ImGui's, with one look, tooltips, and what is refused said in place.

A widget's label is what the user reads; where scripts call it something else, as a parameter by its name in files, that
is its `name`.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from typing import Any, TypeVar

import polyscope.imgui as imgui

from abfm import AbfmError
from abfm_viewer.document.document import Theme
from abfm_viewer.widgets.containers import close_by_escape
from abfm_viewer.widgets.refusals import Refusals
from abfm_viewer.widgets.slider_scale import share_of, value_at
from abfm_viewer.widgets.texts import Texts
from abfm_viewer.widgets.widget_record import WidgetKind

Word = TypeVar("Word", bound=str)
_BOX = 76  # beside a slider, at a scale of 1


class Ui(Texts):
    """Draws widgets, in containers, and remembers them.

    After `text` it says whether the keyboard was in that box, also if it is no more: `typing`. `active_box` is the
    latest one that the keyboard was in, and `focus_next` the one that gets it next.
    """

    def __init__(self) -> None:
        super().__init__()
        self.typing = False
        self.active_box = self.focus_next = ""
        self.refusals = Refusals()

    def begin_frame(self, scale: float, name: Theme) -> None:
        super().begin_frame(scale, name)
        self.refusals.begin_frame()

    # Widgets

    def button(
        self,
        label: str,
        tip: str = "",
        *,
        enabled: bool = True,
        primary: bool = False,
        width: float = 0,
        name: str = "",
    ) -> bool:
        """A button; whether it was pressed. A negative width leaves that much at the right, in pixels."""
        room = max(width if width > 0 else imgui.GetContentRegionAvail()[0] + width, imgui.GetFrameHeight())
        padding = min(imgui.GetStyle().FramePadding[0], max((room - self.text_width(label)) / 2, self.px(2)))
        shown = self.fitted(label, room - 2 * padding)
        width = width or (0 if shown == label else room)
        with self.disabled(not enabled):
            if primary:
                imgui.PushStyleColor(imgui.ImGuiCol_Button, self.colors.accent)
                imgui.PushStyleColor(imgui.ImGuiCol_ButtonHovered, self.colors.accent_hovered)
                imgui.PushStyleColor(imgui.ImGuiCol_ButtonActive, self.colors.accent_hovered)
                imgui.PushStyleColor(imgui.ImGuiCol_Text, self.colors.accent_ink)
            imgui.PushStyleVarX(imgui.ImGuiStyleVar_FramePadding, padding)
            pressed = bool(imgui.Button(f"{shown}###{label}", (width, 0)))
            imgui.PopStyleVar()
            if primary:
                imgui.PopStyleColor(4)
            self._done(label, "button", tip, shown, name=name)
        return pressed

    def checkbox(self, label: str, value: bool, tip: str = "", *, name: str = "") -> bool:
        """A box to tick; its new value."""
        shown = self._fitted_beside_a_box(label)
        with self._outlined():
            _, value = imgui.Checkbox(f"{shown}###{label}", value)
        self._done(label, "checkbox", tip, shown, name=name, text="on" if value else "off")
        return bool(value)

    def combo(
        self,
        label: str,
        value: Word,
        choices: Sequence[Word],
        tip: str = "",
        width: float = 0,
        *,
        name: str = "",
        tips: Mapping[Word, str] | None = None,
        captioned: bool = True,
    ) -> Word:
        """One of several words, each with a tooltip; its new value. A width in pixels, or what the caption leaves."""
        width, caption = self.placed(label, width)
        caption = caption if captioned else 0
        imgui.SetNextItemWidth(width)
        preview = self.fitted(value, width - imgui.GetFrameHeight() - imgui.GetStyle().FramePadding[0])
        is_open = imgui.BeginCombo(f"##{label}", preview, imgui.ImGuiComboFlags_HeightLargest)
        if not is_open:
            tip = self._in_full(value if preview != value else "", tip)
            self._done(label, "combo", tip, name=name, text=value)
            self.caption(label, caption, tip)
            return value
        self.record(label, "combo", name=name, text=value)
        try:
            record = self._widget_record
            with record.section(name or label), record.area(record.window):  # the list may be drawn outside its panel
                for choice in choices:
                    chosen = imgui.Selectable(choice, choice == value)
                    about = tips.get(choice, "") if tips else ""
                    self._done(choice, "choice", about, text="chosen" if choice == value else "")
                    value = choice if chosen else value
        finally:
            close_by_escape()
            imgui.EndCombo()
        self.caption(label, caption, "")
        return value

    def radio(self, choices: Sequence[Word], value: Word, tips: Sequence[str] = ()) -> Word:
        """One of a few words, side by side, on further lines where the panel ends; its new value."""
        for number, choice in enumerate(choices):
            if number:
                self.beside_if_fits(choice)
            shown = self._fitted_beside_a_box(choice)
            with self._outlined():
                if imgui.RadioButton(f"{shown}###{choice}", choice == value):
                    value = choice
            about = tips[number] if tips else ""
            self._done(choice, "choice", about, shown, text="chosen" if choice == value else "")
        return value

    def number(
        self,
        label: str,
        value: float,
        low: float,
        high: float,
        tip: str,
        *,
        log: bool = False,
        whole: bool = False,
        name: str = "",
    ) -> float | None:
        """A slider with a box to type into, which takes values beyond the slider's ends; a new value, or None.

        A text that is no number is refused in place. Whole numbers keep their type in the display. A logarithmic
        slider from 0 has 0 at its left end, and six decades.
        """
        width, caption = self.placed(label)
        spacing = imgui.GetStyle().ItemInnerSpacing[0]
        box = min(self.px(_BOX), width / 2)
        result = self.slider(label, value, low, high, tip, width=width - box - spacing, log=log, name=name)
        if result is not None:
            result = float(round(result)) if whole else float(f"{result:.3g}")  # what a slider is good for
            self.refuse(name or label, "")
        imgui.SameLine(0, spacing)
        text = self._box(label, f"{round(value)}" if whole else f"{value:.6g}", tip, width=box, name=name)
        self.caption(label, caption, tip)
        if text is not None:
            typed = finite(text)
            result = result if typed is None else typed
            self.refuse(name or label, f"{text!r} is no number" if typed is None else "")
        self.refusal(name or label)
        return result

    def slider(
        self,
        label: str,
        value: float,
        low: float,
        high: float,
        tip: str,
        *,
        width: float,
        log: bool = False,
        name: str = "",
        tip_above: bool = False,
    ) -> float | None:
        """A slider without a text; a new value, or None."""
        imgui.SetNextItemWidth(width)
        flags = imgui.ImGuiSliderFlags_NoInput | imgui.ImGuiSliderFlags_NoRoundToFormat
        shown = share_of(min(max(value, low), high), low, high, log)
        changed, share = imgui.SliderFloat(f"##{label} slider", shown, 0.0, 1.0, "", flags)
        self.record(label, "slider", low=low, high=high, log=log, text=f"{value:.6g}", name=name, tip=tip)
        self.tip(tip, above=tip_above)
        return value_at(share, low, high, log) if changed else None

    def text(self, label: str, value: str, tip: str = "", *, hint: str = "", width: float = 0) -> str | None:
        """A box to type into; the new text when Enter is pressed or the box is left, else None.

        A text that is then refused stays in the box, to be mended, until Escape or another change that is accepted.
        """
        width, caption = self.placed(label, width)
        text = self._box(label, value, tip, hint=hint, width=width)
        self.caption(label, caption, tip)
        return text

    def _box(self, label: str, value: str, tip: str, *, width: float, hint: str = "", name: str = "") -> str | None:
        key = self._widget_record.path(name or label)
        imgui.SetNextItemWidth(width)
        if key == self.focus_next:
            imgui.SetKeyboardFocusHere()
            self.focus_next = ""
        shown = self.refusals.text(key, value)
        _, typed = imgui.InputTextWithHint(f"##{label}", hint, shown, imgui.ImGuiInputTextFlags_AutoSelectAll)
        is_longer = self.text_width(typed) > width - 2 * imgui.GetStyle().FramePadding[0]
        self._done(label, "box", self._in_full(typed if is_longer else "", tip), name=name, text=typed)
        self.typing = bool(imgui.IsItemActive() or imgui.IsItemDeactivated())
        if imgui.IsItemActive():
            self.active_box = key
            self.refusals.is_typing(key, typed)
        if imgui.IsItemDeactivated():
            if imgui.IsKeyPressed(imgui.ImGuiKey_Escape) or typed == value:
                self.refusals.accept(key)
            else:
                self.refusals.typed(key, typed)
                return str(typed)
        return None

    def live_text(self, label: str, value: str, hint: str, focus: bool) -> str:
        """A box to type into; what it holds now. `focus` puts the keyboard there."""
        width, caption = self.placed(label)
        imgui.SetNextItemWidth(width)
        if focus:
            imgui.SetKeyboardFocusHere()
        _, value = imgui.InputTextWithHint(f"##{label}", hint, value, imgui.ImGuiInputTextFlags_AutoSelectAll)
        self.record(label, "box", text=value)
        self.caption(label, caption, "")
        return str(value)

    def row(self, label: str, chosen: bool) -> tuple[bool, bool]:
        """A row of a list; whether it was clicked, and whether twice in a row."""
        shown = self.fitted(label, imgui.GetContentRegionAvail()[0])
        text = shown.replace("##", "# #")  # which would hide the rest
        clicked = bool(imgui.Selectable(f"{text}###{label}", chosen, imgui.ImGuiSelectableFlags_AllowDoubleClick))
        self._done(label, "choice", "", shown, text="chosen" if chosen else "")
        return clicked, clicked and bool(imgui.IsMouseDoubleClicked(0))

    def tile(self, label: str, chosen: bool, size: tuple[float, float]) -> bool:
        """An empty place of a size in pixels in a menu, to be drawn on; whether it was chosen."""
        pressed = bool(imgui.Selectable(f"##{label}", chosen, imgui.ImGuiSelectableFlags_None, size))
        self.record(label, "item", text="checked" if chosen else "")
        return pressed

    # What is refused

    def refuse(self, name: str, reason: str) -> None:
        """Say below the widget of this name why its new value was not taken; empty to say nothing any more."""
        key = self._widget_record.path(name)
        self.refusals.refuse(key, reason) if reason else self.refusals.accept(key)

    @contextmanager
    def refusing(self, name: str, label: str = "") -> Iterator[None]:
        """Say so below the widget of this name if the block refuses its new value with an error.

        An error that begins with the name begins with the label instead.
        """
        self.refuse(name, "")
        try:
            yield
        except AbfmError as error:
            reason = str(error)
            is_named = label and reason.startswith(f"{name} ")
            self.refuse(name, f"{label}{reason[len(name) :]}" if is_named else reason)

    def accept_after(self, *values: object) -> None:
        """Take back all refusals when one of these is another than in the frame before."""
        self.refusals.accept_after(*values)

    def refusal(self, name: str, otherwise: str = "") -> None:
        """Show what `refuse` was told, or else another error."""
        if reason := self.refusals.reasons.get(self._widget_record.path(name), otherwise):
            self.note(reason, "failure")

    def _done(self, label: str, kind: WidgetKind, tip: str, shown: str = "", **details: Any) -> None:
        """Remember the widget that was just drawn, which shows that much of its label, and give it a tooltip."""
        tip = self._in_full(label if shown not in ("", label) else "", tip)
        self.record(label, kind, tip=tip, shown=shown or label, **details)
        self.tip(tip)

    def _fitted_beside_a_box(self, label: str) -> str:
        """A label as far as the panel has room for it beside a checkbox or a radio button."""
        room = imgui.GetContentRegionAvail()[0] - imgui.GetFrameHeight() - imgui.GetStyle().ItemInnerSpacing[0]
        return self.fitted(label, room)

    def _in_full(self, text: str, tip: str) -> str:
        """A tooltip that begins with what was cut."""
        return "\n\n".join(filter(None, [text, tip]))


def finite(text: str) -> float | None:
    """The number that a text says; None if it says none, or not a finite one."""
    with suppress(ValueError):
        number = float(text)
        return number if math.isfinite(number) else None
    return None
