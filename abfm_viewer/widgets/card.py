"""A card over the surfaces: a small window that takes the keyboard from nothing."""

from collections.abc import Iterator
from contextlib import contextmanager

import polyscope.imgui as imgui

from abfm_viewer.appearance.theme import Color
from abfm_viewer.widgets.containers import Containers, window_rect

_CARD = (
    imgui.ImGuiWindowFlags_NoTitleBar
    | imgui.ImGuiWindowFlags_NoResize
    | imgui.ImGuiWindowFlags_NoMove
    | imgui.ImGuiWindowFlags_NoCollapse
    | imgui.ImGuiWindowFlags_NoSavedSettings
    | imgui.ImGuiWindowFlags_AlwaysAutoResize
    | imgui.ImGuiWindowFlags_NoFocusOnAppearing
)


class Cards(Containers):
    """Containers, and cards."""

    @contextmanager
    def card(self, name: str, place: tuple[float, float, float], color: Color, highest: float) -> Iterator[None]:
        """A window as high as what is in it, up to a height, at a left end, top and width; the colour is its edge's.

        It takes the keyboard from nothing.
        """
        left, top, width = place
        imgui.SetNextWindowPos((left, top))
        imgui.SetNextWindowSizeConstraints((width, 0), (width, max(highest, self.px(40))))
        imgui.PushStyleColor(imgui.ImGuiCol_Border, color)
        imgui.PushStyleVar(imgui.ImGuiStyleVar_WindowBorderSize, max(1.0, 2 * self.scale))
        imgui.PushStyleVar(imgui.ImGuiStyleVar_WindowRounding, self.px(6))
        imgui.Begin(f"{name}##card", _CARD)
        imgui.PopStyleVar(2)
        imgui.PopStyleColor()
        with self._inside(imgui.End, self._widget_record.area(window_rect())):
            yield
