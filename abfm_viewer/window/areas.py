"""Where the parts of the window are."""

from dataclasses import dataclass

from abfm_viewer.panels import time_bar
from abfm_viewer.widgets.widget_record import Rect

_PANEL_WIDTH, _WIDEST_PANEL = 380, 0.44
_STATUS_HEIGHT = 30


@dataclass(frozen=True)
class Areas:
    """The parts of the window."""

    scene: Rect
    panel: Rect
    time_bar: Rect
    status: Rect


def areas(size: tuple[float, float], menu_height: float, scale: float) -> Areas:
    """Divide a window: the panel at the right, time bar and status line below, surfaces."""
    width, height = size
    right = max(width - min(_PANEL_WIDTH * scale, _WIDEST_PANEL * width), 1.0)
    status = height - _STATUS_HEIGHT * scale
    bar = status - time_bar.height(right, scale)
    return Areas(
        scene=(0.0, menu_height, right, max(bar, menu_height + 1)),
        panel=(right, menu_height, width, status),
        time_bar=(0.0, bar, right, status),
        status=(0.0, status, width, height),
    )
