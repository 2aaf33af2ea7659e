"""Rows of a table of results side by side: their pictures, values and reasons."""

from functools import cache
from pathlib import Path

import polyscope.imgui as imgui
from PIL import Image

from abfm_viewer.document.result_table import COLUMNS, ResultRow
from abfm_viewer.panels.context import Context
from abfm_viewer.widgets.toolkit import Ui

_FLAGS = (
    imgui.ImGuiTableFlags_ScrollX
    | imgui.ImGuiTableFlags_ScrollY
    | imgui.ImGuiTableFlags_BordersInner
    | imgui.ImGuiTableFlags_NoSavedSettings
)
_HEADS_WIDTH = 110
_ROW_WIDTH = 240
_PICTURE_HEIGHT_MAX = 90


def draw(context: Context, rows: tuple[ResultRow, ...], size: tuple[float, float]) -> None:
    """Draw a column for each row. The first column names the values."""
    ui, table = context.ui, context.files.tables.table
    assert table is not None
    if not imgui.BeginTable(f"comparison of {len(rows)}", len(rows) + 1, _FLAGS, size):
        return
    try:
        fixed = imgui.ImGuiTableColumnFlags_WidthFixed
        imgui.TableSetupColumn("", fixed, ui.px(_HEADS_WIDTH))
        width = max(ui.px(_ROW_WIDTH), (size[0] - ui.px(_HEADS_WIDTH + 40)) / len(rows))
        for row in rows:
            imgui.TableSetupColumn(f"##{row.number}", fixed, width)
        imgui.TableSetupScrollFreeze(1, 1)
        for column in table.columns:
            _cells(ui, COLUMNS[column].head, [row.cell_text(column) for row in rows])
            if column == "verdict" and any(row.picture for row in rows):
                imgui.TableNextRow()
                for place, row in enumerate(rows):
                    imgui.TableSetColumnIndex(place + 1)
                    picture = _picture(row.picture) if row.picture else None
                    name = f"picture of a row: {row.picture}"
                    if picture and (texture := context.textures.find(name, picture)) is not None:
                        highest = ui.px(_PICTURE_HEIGHT_MAX)
                        times = min(width / picture.width, highest / picture.height)
                        imgui.Image(texture, (times * picture.width, times * picture.height))
        if any(row.facts.warnings for row in rows):
            _cells(ui, "warnings", ["; ".join(row.facts.warnings) for row in rows])
    finally:
        imgui.EndTable()


def _cells(ui: Ui, head: str, texts: list[str]) -> None:
    imgui.TableNextRow()
    for place, text in enumerate([head, *texts]):
        imgui.TableSetColumnIndex(place)
        ui.note(text, "ink" if place else "muted")


@cache
def _picture(path: Path) -> Image.Image:
    return Image.open(path).convert("RGBA")
