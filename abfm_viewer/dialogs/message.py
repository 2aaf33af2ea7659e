"""Something to read with a button to close it, and a question with a few buttons as answers."""

from collections.abc import Sequence
from dataclasses import dataclass

import polyscope.imgui as imgui

from abfm_viewer.widgets.containers import child, dialog
from abfm_viewer.widgets.toolkit import Ui

Line = str | tuple[str, str]
"""A paragraph, or a row of two columns."""
_MESSAGE_WIDTH, _QUESTION_WIDTH = 520, 460
_FIRST_COLUMN = 0.34


@dataclass(frozen=True)
class Message:
    """Lines under a title, and a text that can be copied instead of them."""

    title: str
    lines: Sequence[Line]
    copied: str = ""

    def draw(self, ui: Ui) -> bool:
        """Draw the lines; whether they were closed in this frame."""
        with dialog(ui, self.title, _MESSAGE_WIDTH):
            height = imgui.GetIO().DisplaySize[1] * 0.92 - 4 * imgui.GetFrameHeightWithSpacing()
            with child(ui, "lines", height, border=False, shrinks=True):
                for line in self.lines:
                    self._draw_line(ui, line)
            if self.copied:
                if ui.button("Copy", "All lines as text, to the clipboard.", width=ui.px(110)):
                    imgui.SetClipboardText(self.copied)
                ui.beside()
            closed = ui.button("Close", "Esc", primary=True, width=ui.px(110))
            keys = (imgui.ImGuiKey_Enter, imgui.ImGuiKey_Escape)
            return closed or any(imgui.IsKeyPressed(key, False) for key in keys)

    def _draw_line(self, ui: Ui, line: Line) -> None:
        if isinstance(line, str):
            ui.note(line, "ink")
        elif line[1]:
            width = imgui.GetContentRegionAvail()[0]
            ui.note(line[0], "muted")
            imgui.SameLine(_FIRST_COLUMN * width)
            ui.note(line[1], "ink")
        else:
            ui.heading(line[0])


@dataclass(frozen=True)
class Question:
    """A text and the labels of its answers: Enter takes the first one, Esc the last."""

    title: str
    text: str
    answers: Sequence[str]

    def draw(self, ui: Ui) -> str | None:
        """Draw the question; the answer that was chosen in this frame."""
        with dialog(ui, self.title, _QUESTION_WIDTH):
            ui.note(self.text, "ink")
            imgui.Dummy((0, ui.px(4)))
            chosen = None
            width = max(map(ui.text_width, self.answers)) + ui.px(32)
            for number, answer in enumerate(self.answers):
                if number:
                    ui.beside()
                if ui.button(answer, primary=number == 0, width=width):
                    chosen = answer
            if imgui.IsKeyPressed(imgui.ImGuiKey_Enter, False):
                chosen = self.answers[0]
            elif imgui.IsKeyPressed(imgui.ImGuiKey_Escape, False):
                chosen = self.answers[-1]
        return chosen
