"""The list of autosaved copies, with a picture, a name and a time for each."""

import time
from collections.abc import Sequence
from typing import Literal, NamedTuple

import polyscope.imgui as imgui
from PIL import Image

from abfm_viewer.files.autosave import Recovery
from abfm_viewer.scene.textures import Textures
from abfm_viewer.widgets.containers import child, dialog
from abfm_viewer.widgets.toolkit import Ui

TITLE = "Recover unsaved work?"
PICTURE_SIZE = 104, 84
_WIDTH = 640
_LIST_HEIGHT_SHARE_MAX = 0.6  # of the window
_BUTTON_WIDTH = 96


class Copy(NamedTuple):
    """An autosaved copy, with the name of its project or document."""

    recovery: Recovery
    name: str
    picture: Image.Image
    note: str = ""

    @property
    def time(self) -> str:
        """Time of the last change that the copy contains."""
        return time.strftime("%H:%M on %d %B %Y", time.localtime(self.recovery.changed))


class Answer(NamedTuple):
    """Action for some copies; the others stay for later."""

    do: Literal["recover", "discard", "later"]
    copies: tuple[Copy, ...] = ()


class RecoveryList:
    """Dialog with a row for each copy, the latest first."""

    title = TITLE

    def __init__(self, copies: Sequence[Copy], textures: Textures) -> None:
        self._copies, self._textures = tuple(copies), textures

    def draw(self, ui: Ui) -> Answer | None:
        count, answer = len(self._copies), None
        with dialog(ui, TITLE, _WIDTH):
            many = f"{count} documents were" if count > 1 else "this document was"
            order = " The latest change is first." if count > 1 else ""
            ui.note(f"The app ended before {many} saved.{order}", "ink")
            height = _LIST_HEIGHT_SHARE_MAX * imgui.GetIO().DisplaySize[1]
            with child(ui, "copies", height, border=False, fits="at most"):
                for number, copy in enumerate(self._copies):
                    with ui.group(f"copy {number + 1}"):
                        answer = self._draw_row(ui, number, copy) or answer
            imgui.Dummy((0, ui.px(4)))
            if count > 1:
                tip = "Open all copies. The latest one is shown; Undo returns to the others."
                width = ui.text_width("Recover all") + ui.px(32)
                if ui.button("Recover all", tip, primary=True, width=width):
                    answer = Answer("recover", self._copies)
                ui.same_line()
            if imgui.IsKeyPressed(imgui.ImGuiKey_Enter, False):
                answer = Answer("recover", self._copies)
            later = ui.button("Later", "Keep the copies. File lists them again (Esc).")
            if later or imgui.IsKeyPressed(imgui.ImGuiKey_Escape, False):
                answer = Answer("later")
        return answer

    def _draw_row(self, ui: Ui, number: int, copy: Copy) -> Answer | None:
        answer, (left, top) = None, imgui.GetCursorPos()
        size = tuple(map(ui.px, PICTURE_SIZE))
        if (texture := self._textures.find(f"copy {number}", copy.picture)) is not None:
            imgui.Image(texture, size)
        buttons = 2 * ui.px(_BUTTON_WIDTH) + imgui.GetStyle().ItemSpacing[0]
        edge = left + float(imgui.GetContentRegionAvail()[0])
        x = left + size[0] + ui.px(12)
        room = edge - buttons - ui.px(12) - x
        imgui.SetCursorPos((x, top + ui.px(8)))
        imgui.BeginGroup()
        ui.line(copy.name, "ink", room=room)
        ui.line(f"last change at {copy.time}", room=room)
        if copy.note:
            ui.note(copy.note, "warning", room)
        imgui.EndGroup()
        imgui.SetCursorPos((edge - buttons, top + ui.px(8)))
        width = ui.px(_BUTTON_WIDTH)
        is_only = len(self._copies) == 1
        if ui.button("Recover", "Open this copy.", primary=is_only, width=width):
            answer = Answer("recover", (copy,))
        ui.same_line()
        if ui.button("Discard", "Delete this copy.", width=width):
            answer = Answer("discard", (copy,))
        imgui.SetCursorPos((left, top + size[1] + ui.px(6)))
        imgui.Dummy((1, 1))
        return answer
