"""Style of ImGui and ImPlot: colours of the theme, rounding and spacing."""

import polyscope.imgui as imgui
import polyscope.implot as implot

from abfm_viewer.appearance.theme import Color, palette
from abfm_viewer.document.document import Theme


def apply(theme: Theme, scale: float) -> None:
    p = palette(theme)
    style = imgui.GetStyle()
    _lengths(style, scale)
    clear: Color = (0, 0, 0, 0)
    colors: tuple[tuple[Color, str], ...] = (
        (p.ink, "Text InputTextCursor"),
        (p.muted, "TextDisabled"),
        (p.panel, "WindowBg PopupBg MenuBarBg"),
        (clear, "ChildBg BorderShadow ScrollbarBg TableRowBg"),
        (p.border, "Border Separator TableBorderStrong TableBorderLight"),
        (p.field, "FrameBg TitleBg TitleBgActive TitleBgCollapsed Button Header Tab TableHeaderBg"),
        (
            p.hovered,
            "FrameBgHovered ScrollbarGrab ButtonHovered HeaderHovered SeparatorHovered TabHovered",
        ),
        (
            p.pressed,
            "FrameBgActive ScrollbarGrabHovered ScrollbarGrabActive ButtonActive HeaderActive",
        ),
        (p.pressed, "SeparatorActive TabSelected"),
        (p.accent, "CheckMark SliderGrab PlotLines PlotHistogram NavCursor"),
        (p.accent_hovered, "SliderGrabActive"),
        ((*p.accent[:3], 0.35), "TextSelectedBg"),
        ((*p.field[:3], 0.35), "TableRowBgAlt"),
        ((0, 0, 0, 0.35), "ModalWindowDimBg"),
    )
    for color, names in colors:
        for name in names.split():
            style.Colors[getattr(imgui, f"ImGuiCol_{name}")] = color
    implot.StyleColorsLight() if theme == "light" else implot.StyleColorsDark()


def _lengths(style: imgui.ImGuiStyle, scale: float) -> None:
    def pair(x: float, y: float) -> tuple[float, float]:
        return x * scale, y * scale

    # polyscope sets either of them and never resets the other
    style.FontScaleMain, style.FontScaleDpi = 1, scale
    style.WindowPadding, style.FramePadding = pair(10, 8), pair(8, 4)
    style.ItemSpacing, style.ItemInnerSpacing = pair(8, 6), pair(6, 4)
    style.CellPadding, style.SeparatorTextPadding = pair(6, 3), pair(0, 4)
    style.WindowRounding = style.ChildRounding = 0
    style.FrameRounding = style.GrabRounding = style.PopupRounding = 4 * scale
    style.WindowBorderSize, style.FrameBorderSize, style.SeparatorTextBorderSize = 1, 0, 1
    style.ScrollbarSize, style.GrabMinSize = 12 * scale, 12 * scale
    style.ScrollbarRounding = 6 * scale
    style.IndentSpacing = 14 * scale
    style.DisabledAlpha = 0.4
    style.HoverDelayShort = 0.35
