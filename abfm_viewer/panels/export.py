"""The tab Export, and its dialog: formats, settings, what will be written, and its progress."""

from dataclasses import asdict, replace
from typing import Any

import polyscope.imgui as imgui

from abfm_viewer.document.kinds import SequenceDocument
from abfm_viewer.files import outputs
from abfm_viewer.files.names import suggested_name
from abfm_viewer.panels.context import Context
from abfm_viewer.panels.export_formats import MOVIE, PICTURE, Format, formats
from abfm_viewer.panels.solver import draw_step
from abfm_viewer.session.saving.export_settings import (
    MOVIE_SUFFIXES,
    SHOWN_VIEWS,
    Background,
    ExportSettings,
)
from abfm_viewer.widgets.containers import dialog, is_popup_open
from abfm_viewer.widgets.toolkit import Ui
from abfm_viewer.widgets.widget_record import Range

TITLE = "Export to a file"
_WIDTH = 620
_HEIGHT_MAX = 700  # pixels at a scale of 1
_SIZES = {"HD": (1280, 720), "full HD": (1920, 1080), "4K": (3840, 2160), "8K": (7680, 4320)}
_CUSTOM_SIZE = "custom size"
_WIDTH_RANGE = Range(320, 7680, is_integer=True)
_HEIGHT_RANGE = Range(240, 4320, is_integer=True)
_BACKGROUNDS: dict[Background, str] = {
    "theme": "The background of the window, light or dark.",
    "white": "White, with the light theme, for papers.",
    "transparent": "No background, for slides. Movies have that of the window instead.",
}


class ExportDialog:
    """Dialog in which the user chooses the format ``name`` and settings of an exported file.

    The settings are stored as preferences when a file is chosen.
    """

    def __init__(self, context: Context, name: str) -> None:
        self.title = TITLE
        self._context, self._name, self._suffix = context, name, ""
        self._has_exported = False

    def draw(self, ui: Ui) -> bool:
        """Draw the dialog; return whether the user closed it."""
        context, exporter = self._context, self._context.exporter
        known = formats(context)
        name = self._name if self._name in known else PICTURE
        has_list = is_popup_open()  # which Escape closes
        with dialog(ui, self.title, _WIDTH, highest=_HEIGHT_MAX):
            tips = [one.tip for one in known.values()]
            self._name = ui.radio([*known], name, tips)
            chosen, problem = known[self._name], ""
            ui.heading(self._name)
            ui.note(chosen.tip)
            # settings must not change during an export; further exports are queued
            with ui.disabled(exporter.running):
                if self._name in (PICTURE, MOVIE):
                    problem = self._draw_pictures(ui)
                elif chosen.suffixes[1:]:
                    suffix = self._suffix if self._suffix in chosen.suffixes else chosen.suffixes[0]
                    self._suffix = ui.combo("file type", suffix, chosen.suffixes)
            if not chosen.is_ready:
                problem = "Available after a match."
            if problem:
                ui.note(problem, "failure")
            imgui.Dummy((0, ui.px(4)))
            width = ui.px(130)
            if ui.button("Save as...", primary=True, enabled=not problem, width=width):
                self._choose_file(chosen)
            ui.same_line()
            closed = ui.button("Close", "Esc. A running export continues.", width=width)
            if self._has_exported:
                draw_state(context)
            is_escape = imgui.IsKeyPressed(imgui.ImGuiKey_Escape, False)
            return closed or (is_escape and not has_list and not imgui.GetIO().WantTextInput)

    def _choose_file(self, chosen: Format) -> None:
        context, exporter = self._context, self._context.exporter
        context.preferences.change(export=asdict(exporter.settings))
        suffix = self._suffix if self._suffix in chosen.suffixes else chosen.suffixes[0]
        if self._name == MOVIE:
            suffix = exporter.settings.movie_suffix
        others = (one for one in chosen.suffixes if one != suffix)
        name = suggested_name(context.session.document, chosen.content, suffix)

        def save(path: Any) -> None:
            self._has_exported = True
            chosen.save(path)

        context.dialogs.save(f"Save the {self._name.lower()}", (suffix, *others), name, save)

    def _draw_pictures(self, ui: Ui) -> str:
        """Draw the settings of pictures or movies; return why they are impossible, if they are."""
        exporter, is_movie = self._context.exporter, self._name == MOVIE
        settings = self._draw_size(ui, exporter.settings)
        if is_movie:
            settings = self._draw_movie(ui, settings)
        else:
            tip = "Pixels per inch of the printed picture, 36 to 2400."
            dpi = ui.bounded("dpi", settings.dpi, Range(72, 600, is_integer=True), tip, (36, 2400))
            settings = replace(settings, dpi=round(dpi))
        tip = "Side from which the surfaces are shown, by default that of the window."
        view = ui.combo("view", settings.view, SHOWN_VIEWS, tip)
        background = ui.combo("background", settings.background, _BACKGROUNDS)
        bar = ui.checkbox("colour bar", settings.color_bar, "Include the colour bars.")
        exporter.settings = replace(settings, view=view, background=background, color_bar=bar)
        ui.note(settings.movie_text if is_movie else settings.picture_text, "ink")
        fastest = outputs.FPS_MAX[settings.movie_suffix]
        if is_movie and settings.fps > fastest:
            return f"A {settings.movie_suffix} file has at most {fastest:g} frames per second."
        return ""

    def _draw_size(self, ui: Ui, settings: ExportSettings) -> ExportSettings:
        sizes = {"window": self._context.exporter.window_size, **_SIZES}
        names = {size: name for name, size in sizes.items()}
        now = names.get((settings.width, settings.height), _CUSTOM_SIZE)
        choices = [*sizes, _CUSTOM_SIZE] if now == _CUSTOM_SIZE else list(sizes)
        chosen = ui.combo("size", now, choices, "Size of pictures and movies.")
        width, height = (settings.width, settings.height) if chosen == now else sizes[chosen]
        tip = "Width in pixels, 320 to 8192."
        width = round(ui.bounded("pixels across", width, _WIDTH_RANGE, tip, (320, 8192)))
        tip = "Height in pixels, 240 to 8192."
        height = round(ui.bounded("pixels down", height, _HEIGHT_RANGE, tip, (240, 8192)))
        return replace(settings, width=width, height=height)

    def _draw_movie(self, ui: Ui, settings: ExportSettings) -> ExportSettings:
        document = self._context.session.document
        suffix = ui.combo("file type", settings.movie_suffix, MOVIE_SUFFIXES)
        tip = "Length of the movie in seconds."
        seconds = ui.bounded("seconds", settings.seconds, Range(0.5, 20), tip, (0.1, 600.0))
        tip = "Frames per second: at most 120, in a GIF 50."
        ends = Range(5, 60, is_integer=True)
        fps = ui.bounded("fps", settings.fps, ends, tip, (1.0, 120.0))
        # times of a match are in units of tau, and those of a sequence in its unit
        first, duration, last, unit = 0.0, 1.0, 2.0, "τ"
        if isinstance(document, SequenceDocument):
            first, last, unit = document.start, document.end, document.sequence.unit or "frame"
            duration = last - first

        def time(label: str, share: float, tip: str) -> float:
            value = min(first + share * duration, last)
            new = ui.bounded(
                f"{label} ({unit})###{label}", value, Range(first, last), tip, (first, last)
            )
            return share if new == value else (new - first) / duration

        start = time("from", settings.start, "First time of the movie.")
        beyond = " Beyond τ the flow is extrapolated." if document.extrapolates else ""
        end = time("to", settings.end, f"Last time of the movie.{beyond}")
        tip = "Turns of the surfaces about their upright axis during the movie, such as 1 or -0.5."
        turns = ui.bounded("turns###turntable", settings.turns, Range(-2, 2), tip, (-100, 100))
        settings = replace(settings, movie_suffix=suffix, seconds=seconds, fps=fps)
        return replace(settings, start=start, end=end, turns=turns)


def open_dialog(context: Context, name: str = PICTURE) -> None:
    """Open the dialog Export on a format, and pause the playback."""
    context.session.player.playing = False
    context.dialogs.push(ExportDialog(context, name), lambda _: context.dialogs.pop())


def draw(context: Context) -> None:
    """Draw a button for each format, which opens the dialog, and the progress of exports."""
    ui = context.ui
    for name, one in formats(context).items():
        tip = one.tip if one.is_ready else f"{one.tip} Available after a match."
        if ui.button(f"{name}...", tip, enabled=one.is_ready, width=-1):
            open_dialog(context, name)
    draw_state(context)


def draw_state(context: Context) -> None:
    """Draw the progress or the outcome of exports; no widgets may be below, as they would move."""
    ui, session, exporter = context.ui, context.session, context.exporter
    if exporter.running:
        draw_step(ui, exporter.step)
        if ui.button("Cancel export", "Cancel the export. An existing file stays unchanged."):
            exporter.cancel()
    elif exporter.message and exporter.message_subject is context.session.document.identity:
        is_done = exporter.progress == 1  # unless it was cancelled
        ui.note(exporter.message, "failure" if exporter.failed else "good" if is_done else "muted")
    if session.solver.running:
        ui.note("Files contain the latest result, not the current run.")
