"""Still pictures of a match: from source to target on one colour range and one camera."""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

import numpy as np
from PIL import Image, ImageFont

from abfm import Match
from abfm.io.sheets import Frame, Panel, Sheet, Values
from abfm.types import FloatArray
from abfm_viewer.document.verdict_words import headline, tone
from abfm_viewer.pictures.sheets.layout import Layout, laid_out
from abfm_viewer.pictures.sheets.panel_pictures import cameras
from abfm_viewer.pictures.sheets.sheet_picture import sheet_picture

DEFAULT_WIDTH, _USUAL_HEIGHT, _SMALLEST_SCALE = 1800, 700, 0.6
_PLEASANT_ASPECT = 2.4


def match_picture(
    match: Match,
    times: Sequence[float] | None = None,
    size: tuple[int, int] | None = None,
    channel: int = 0,
    up: Literal["x", "y", "z"] = "y",
) -> Image.Image:
    """Source (blue frame), the source on its way, at tau (black frame), and target (red frame).

    Parameters
    ----------
    times
        When to show the source besides 0 and tau; by default at a quarter, half and three quarters
        of tau.
    size
        Width and height in pixels; by default a wide sheet that fits the shape.
    channel, up
        Which of several pairs of functions to show, and the axis that points upwards.

    Raises
    ------
    DrawingError
        Where the machine cannot draw.
    """
    tau = match.parameters.tau
    moments = sorted({*(tau * np.array([0.25, 0.5, 0.75]) if times is None else times), tau})

    def panel(function: FloatArray, label: str, frame: Frame = "other") -> Panel:
        values = Values(function.reshape(len(function), -1)[:, channel])
        return Panel(match.mesh, values, label, frame)

    meant = tone(match)

    panels = [panel(match.source, "source", "source")]
    for time, values in zip(moments, match.advect(moments), strict=True):
        if time == tau:
            result = panel(values, f"t = {time:.4g}, {headline(match)}", "result")
            panels.append(replace(result, tone="" if meant == "ink" else meant))
        else:
            panels.append(panel(values, f"t = {time:.4g}"))
    sheet = Sheet(((*panels, panel(match.target, "target", "target")),), up)
    views = cameras(sheet)
    layout = grid(len(sheet.rows[0]), views[match.mesh].aspect, size)
    return sheet_picture(sheet, views, layout, ImageFont.load_default)


def grid(count: int, aspect: float, size: tuple[int, int] | None = None) -> Layout:
    """Lay out panels as large as a size allows, or on a sheet of pleasant proportions."""
    width, height = size or (DEFAULT_WIDTH, None)
    scale = 1.0
    if height is not None:
        scale = max(_SMALLEST_SCALE, min(width / DEFAULT_WIDTH, height / _USUAL_HEIGHT))
    candidates = []
    for columns in sorted({math.ceil(count / rows) for rows in range(1, count + 1)}):
        rows = [[aspect] * columns] * math.ceil(count / columns)
        candidates.append(laid_out(rows, 1, True, (width, height), scale))
    if size is None:
        off = [math.log(one.width / one.height / _PLEASANT_ASPECT) for one in candidates]
        return candidates[int(np.argmin(np.abs(off)))]
    return max(candidates, key=lambda layout: layout.rows[0][0].width)
