"""A file that says where the widgets are, for programs that drive a real window with a mouse of their own."""

import json
import os
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from abfm_viewer.widgets.widget_record import Widget

VARIABLE = "ABFM_WIDGETS"
"""Names the file; without it none is written."""
_FRAMES = 10


def write_widgets(widgets: Sequence[Widget], frame: int) -> None:
    """Write the widgets of every tenth frame as JSON, a list of `widget_record.Widget`, if the user asked for it."""
    name = os.environ.get(VARIABLE)
    if name and frame % _FRAMES == 0:
        temporary = Path(f"{name}.part")
        temporary.write_text(json.dumps([asdict(widget) for widget in widgets]))
        temporary.replace(name)
