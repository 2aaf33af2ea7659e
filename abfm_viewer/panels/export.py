"""Pictures, movies and data of what the window shows."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

from abfm_viewer.document.document import Document
from abfm_viewer.panels.context import Context
from abfm_viewer.panels.progress import draw_step
from abfm_viewer.session.exporter import DATA, MOVIES, PICTURES, Exporter, Known
from abfm_viewer.session.functions import known_values
from abfm_viewer.session.session import Session
from abfm_viewer.widgets.slider_range import Range
from abfm_viewer.widgets.toolkit import Ui

_SIZES = {"HD": (1280, 720), "full HD": (1920, 1080), "4K": (3840, 2160), "8K": (7680, 4320)}
_OWN = "own size"
_ACROSS, _DOWN = Range(320, 7680, whole=True), Range(240, 4320, whole=True)


def draw(context: Context) -> None:
    ui, session, exporter = context.ui, context.session, context.exporter

    def save(drawn: Callable[[Path, Document, Known], None], path: Path) -> None:
        document = session.document
        drawn(path, document, partial(known_values, document, session.functions_of(document)))

    def save_result(path: Path) -> None:
        if session.result is not None:
            exporter.save_result(path, session.result)

    ask = context.dialogs.save
    with ui.disabled(exporter.running):
        _draw_size(ui, exporter)
        if ui.button("Save picture...", "The surfaces as they are now (.png), without the panels."):
            ask("Save a picture", PICTURES, "picture.png", partial(save, exporter.save_picture))
        ui.heading("movie")
        _draw_movie(ui, session, exporter)
        tip = "The flow from one time to another (.mp4 or .gif), every frame computed exactly."
        if ui.button("Save movie...", tip):
            ask("Save a movie", MOVIES, "movie.mp4", partial(save, exporter.save_movie))
        ui.heading("data")
        tip = "The result (.npz), mesh, functions and field (.ply, .vtu), or energies (.csv)."
        has_none = "" if session.result else " There is one after a match."
        if ui.button("Save result...", f"{tip}{has_none}", enabled=session.result is not None):
            ask("Save the result", DATA, "match.npz", save_result)
    _draw_state(ui, session, exporter)


def _draw_state(ui: Ui, session: Session, exporter: Exporter) -> None:
    """Say what is written and what was: last, so that nothing moves when there is something."""
    if exporter.running:
        draw_step(ui, exporter.step)
        if ui.button("Cancel export", "Stop; an older file stays as it was."):
            exporter.cancel()
    elif exporter.message:
        ui.note(exporter.message, "failure" if exporter.failed else "good")
    if session.solver.running:
        ui.note("What is saved shows the latest result, not the run that goes on.")


def _draw_size(ui: Ui, exporter: Exporter) -> None:
    picture = exporter.picture
    sizes = {"window": exporter.window_size, **_SIZES}
    names = {size: name for name, size in sizes.items()}
    now = names.get((picture.width, picture.height), _OWN)
    choices = [*sizes, _OWN] if now == _OWN else list(sizes)
    chosen = ui.combo("size", now, choices, "Of pictures and movies.")
    width, height = (picture.width, picture.height) if chosen == now else sizes[chosen]
    across = ui.number("pixels across", width, _ACROSS, "320 to 8192.")
    down = ui.number("pixels down", height, _DOWN, "240 to 8192.")
    tip = "A picture without a ground, for slides and papers."
    transparent = ui.checkbox("transparent", picture.transparent, tip)
    ui.beside_if_fits("color bar")
    bar = ui.checkbox("color bar", picture.color_bar, "Whether pictures and movies have one.")
    exporter.picture = replace(
        picture,
        width=width if across is None else round(min(max(across, 320), 8192)),
        height=height if down is None else round(min(max(down, 240), 8192)),
        transparent=transparent,
        color_bar=bar,
    )


def _draw_movie(ui: Ui, session: Session, exporter: Exporter) -> None:
    movie, tau = exporter.movie, session.parameters.tau
    seconds = ui.number("seconds", movie.seconds, Range(0.5, 20), "How long the movie is.")
    tip = "Frames a second; at most 120, in a GIF 50."
    fps = ui.number("fps", movie.fps, Range(5, 60, whole=True), tip)
    times = Range(0, session.document.end)
    start = ui.number("from", movie.start * tau, times, "The first time shown.")
    tip = "The last time shown; beyond τ the flow goes on."
    end = ui.number("to", movie.end * tau, times, tip)
    tip = "How far the surfaces turn meanwhile, in degrees."
    turn = ui.number("turntable", movie.turntable, Range(-360, 360), tip)
    exporter.movie = replace(
        movie,
        seconds=movie.seconds if seconds is None else min(max(seconds, 0.1), 600.0),
        fps=movie.fps if fps is None else min(max(fps, 1.0), 120.0),
        start=movie.start if start is None else min(max(start, 0.0), session.document.end) / tau,
        end=movie.end if end is None else min(max(end, 0.0), session.document.end) / tau,
        turntable=movie.turntable if turn is None else turn,
    )
