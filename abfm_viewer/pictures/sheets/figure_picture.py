"""A figure of the paper as a sheet: its rows, and the colour bars below."""

from collections.abc import Sequence

from PIL import Image

from abfm.io.sheets import Panel, Plot, Sheet
from abfm_viewer.pictures.sheets.layout import laid_out
from abfm_viewer.pictures.sheets.panel_pictures import cameras
from abfm_viewer.pictures.sheets.plot_pictures import font
from abfm_viewer.pictures.sheets.ranges import color_ranges
from abfm_viewer.pictures.sheets.sheet_picture import sheet_picture

_ASPECTS = (0.45, 1.9)  # least and greatest width over height of a panel


def figure_picture(sheet: Sheet, notes: Sequence[str] = ()) -> Image.Image:
    """Draw a figure, with notes below it; a `DrawingError` says why the machine cannot."""
    views = cameras(sheet, _ASPECTS)
    usual = max(next(iter(views.values())).aspect if views else 1.0, 0.7)

    def aspect(cell: Panel | Plot) -> float:
        return views[cell.mesh].aspect if isinstance(cell, Panel) else cell.width * usual

    aspects = [[aspect(cell) for cell in row] for row in sheet.rows]
    return sheet_picture(sheet, views, laid_out(aspects, len(color_ranges(sheet))), font, notes)
