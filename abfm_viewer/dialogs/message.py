"""Something to read, and a button to close it."""

from collections.abc import Sequence
from dataclasses import dataclass

import polyscope.imgui as imgui

from abfm_viewer.widgets.toolkit import Ui

Line = str | tuple[str, str]
"""A paragraph, or a row of two columns."""
_WIDTH, _FIRST_COLUMN = 520, 0.34


@dataclass(frozen=True)
class Message:
    """Lines under a title."""

    title: str
    lines: Sequence[Line]

    def draw(self, ui: Ui) -> bool:
        """Draw the lines; whether they were closed in this frame."""
        with ui.dialog(self.title, _WIDTH):
            height = imgui.GetIO().DisplaySize[1] * 0.92 - 4 * imgui.GetFrameHeightWithSpacing()
            with ui.child("lines", height, border=False, shrinks=True):
                for line in self.lines:
                    self._draw_line(ui, line)
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
