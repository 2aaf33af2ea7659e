"""A question with a few buttons as answers."""

from collections.abc import Sequence
from dataclasses import dataclass

import polyscope.imgui as imgui

from abfm_viewer.widgets.toolkit import Ui

_WIDTH = 460


@dataclass(frozen=True)
class Question:
    """A text and the labels of its answers: Enter takes the first one, Esc the last."""

    title: str
    text: str
    answers: Sequence[str]

    def draw(self, ui: Ui) -> str | None:
        """Draw the question; the answer that was chosen in this frame."""
        with ui.dialog(self.title, _WIDTH):
            ui.note(self.text, "ink")
            imgui.Dummy((0, ui.px(4)))
            chosen = None
            width = max(float(imgui.CalcTextSize(answer)[0]) for answer in self.answers) + ui.px(32)
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
