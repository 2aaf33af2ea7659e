"""The tab Export: pictures, movies and data of the current document."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import abfm
from abfm.wording import capital
from abfm_viewer.document.document import Document
from abfm_viewer.files import outputs
from abfm_viewer.panels.context import Context
from abfm_viewer.panels.solver import draw_step
from abfm_viewer.session.functions import known_values
from abfm_viewer.session.saving.exporter import (
    LABELS,
    MOVIES,
    PICTURES,
    TABLES,
    Exporter,
    Known,
)
from abfm_viewer.session.session import Session
from abfm_viewer.widgets.toolkit import Ui
from abfm_viewer.widgets.widget_record import Range

_SIZES = {"HD": (1280, 720), "full HD": (1920, 1080), "4K": (3840, 2160), "8K": (7680, 4320)}
_CUSTOM_SIZE = "custom size"
_LABELS_TIP = "Labels at τ, transferred by the flow (.label.gii, .annot, or a table of keys)."
_WIDTH_RANGE = Range(320, 7680, is_integer=True)
_HEIGHT_RANGE = Range(240, 4320, is_integer=True)


class _Saved(NamedTuple):
    """Settings of a button ``Save NAME...``, which writes an attribute of a document to a file."""

    what: str  # in the label of the button
    tip: str
    name: str  # default name of the file
    attribute: str = "result"
    endings: tuple[str, ...] = ()  # of the file; by default the suffixes of the kind of result


_MATCH = _Saved(
    "result",
    "The match (.npz), or mesh, functions and field (.ply, .vtu). Also energies (.csv) and a web "
    "page (.html).",
    "match.npz",
)
_REGISTRATION = _Saved(
    "registration",
    "The correspondence of A and B (.npz) or a web page (.html). Also A's faces on B (.gii, .ply), "
    "or A's vertex for each vertex of B (.txt, .csv, .npy).",
    "registration.npz",
    "complete_result",
)
_SEQUENCE = _Saved(
    "sequence",
    "Frames and fields (.npz, .pvd for ParaView), or a web page that plays them (.html). Also the "
    "speed at vertices (-lh.stc or -rh.stc by hemisphere, .gii).",
    "sequence.npz",
    endings=(".npz", ".pvd", "-lh.stc", "-rh.stc", ".gii", ".html"),
)


def draw(context: Context) -> None:
    ui, session, exporter = context.ui, context.session, context.exporter

    def save(drawn: Callable[[Path, Document, Known], None], path: Path) -> None:
        document = session.document
        drawn(
            path, document, partial(known_values, document, session.functions.of_document(document))
        )

    ask = context.dialogs.save
    # settings must not change during an export; further exports are queued
    with ui.disabled(exporter.running):
        _draw_size(ui, exporter)
    if ui.button("Save picture...", "The surfaces as they are now (.png), without the panels."):
        ask("Save a picture", PICTURES, "picture.png", partial(save, exporter.save_picture))
    ui.heading("movie")
    with ui.disabled(exporter.running):
        _draw_movie(ui, session, exporter)
    tip = "The flow between two times (.mp4 or .gif). Every frame is computed exactly."
    if ui.button("Save movie...", tip):
        ask("Save a movie", MOVIES, "movie.mp4", partial(save, exporter.save_movie))
    ui.heading("data")


def draw_result(context: Context) -> None:
    _draw_save(context, _MATCH)
    if context.session.document.labels is not None:
        _draw_labels(context)


def draw_registration(context: Context) -> None:
    _draw_save(context, _REGISTRATION)
    context.ui.same_line_if_fits("Save result...", is_button=True)
    draw_result(context)


def draw_sequence(context: Context) -> None:
    ui = context.ui
    _draw_save(context, _SEQUENCE)
    for name, table in abfm.sequences.SequenceTask.tables.items():

        def save(path: Path, name: str = name) -> None:
            if (found := context.session.document.result) is not None:
                context.exporter.save_table(path, found, name)

        label, is_there = f"Save {name}...", context.session.document.result is not None
        ui.same_line_if_fits(label, is_button=True)
        if ui.button(label, _tip(context, f"{capital(table.help)} (.csv)."), enabled=is_there):
            context.dialogs.save(f"Save the {name}", TABLES, f"{name}.csv", save)


def _tip(context: Context, text: str) -> str:
    is_there = context.session.document.result is not None
    return text if is_there else f"{text} Available after a match."


def _draw_save(context: Context, saved: _Saved) -> None:
    session = context.session

    def save(path: Path) -> None:
        document = session.document
        if (found := getattr(document, saved.attribute)) is not None:
            on_saved = partial(session.saves.record_export, document)
            context.exporter.save_result(path, found, on_saved)

    found, tip = getattr(session.document, saved.attribute), _tip(context, saved.tip)
    if context.ui.button(f"Save {saved.what}...", tip, enabled=found is not None):
        endings = saved.endings or outputs.suffixes(abfm.loading.task_of(found))
        context.dialogs.save(f"Save the {saved.what}", endings, saved.name, save)


def _draw_labels(context: Context) -> None:
    session = context.session

    def save(path: Path) -> None:
        labels, found = session.document.labels, session.document.complete_result
        if labels is not None and found is not None:
            context.exporter.save_labels(path, labels, found)

    is_there = session.document.result is not None
    if context.ui.button(
        "Save transferred labels...", _tip(context, _LABELS_TIP), enabled=is_there
    ):
        context.dialogs.save("Save transferred labels", LABELS, "transferred.label.gii", save)


def draw_state(context: Context) -> None:
    """Draw the progress of exports, at the end of the tab so that other widgets do not move."""
    ui, session, exporter = context.ui, context.session, context.exporter
    if exporter.running:
        draw_step(ui, exporter.step)
        if ui.button("Cancel export", "Cancel the export. An existing file stays unchanged."):
            exporter.cancel()
    elif exporter.message and exporter.message_subject is context.session.document.identity:
        ui.note(exporter.message, "failure" if exporter.failed else "good")
    if session.solver.running:
        ui.note("Files contain the latest result, not the current run.")


def _draw_size(ui: Ui, exporter: Exporter) -> None:
    picture = exporter.picture
    sizes = {"window": exporter.window_size, **_SIZES}
    names = {size: name for name, size in sizes.items()}
    now = names.get((picture.width, picture.height), _CUSTOM_SIZE)
    choices = [*sizes, _CUSTOM_SIZE] if now == _CUSTOM_SIZE else list(sizes)
    chosen = ui.combo("size", now, choices, "Size of pictures and movies.")
    width, height = (picture.width, picture.height) if chosen == now else sizes[chosen]
    tip = "Width in pixels, 320 to 8192."
    width = round(ui.bounded("pixels across", width, _WIDTH_RANGE, tip, (320, 8192)))
    tip = "Height in pixels, 240 to 8192."
    height = round(ui.bounded("pixels down", height, _HEIGHT_RANGE, tip, (240, 8192)))
    tip = "Transparent background, for slides and papers."
    transparent = ui.checkbox("transparent", picture.transparent, tip)
    ui.same_line_if_fits("color bar")
    tip = "Include a colour bar in pictures and movies."
    bar = ui.checkbox("color bar", picture.color_bar, tip)
    exporter.picture = replace(
        picture, width=width, height=height, transparent=transparent, color_bar=bar
    )


def _draw_movie(ui: Ui, session: Session, exporter: Exporter) -> None:
    movie, document = exporter.movie, session.document
    first, last = document.start, document.end
    duration = document.last_target_time - first

    def bounded_time(label: str, share: float, tip: str) -> float:
        shown = min(first + share * duration, last)
        new = ui.bounded(label, shown, Range(first, last), tip, (first, last))
        return share if new == shown else (new - first) / duration

    tip = "Length of the movie in seconds."
    seconds = ui.bounded("seconds", movie.seconds, Range(0.5, 20), tip, (0.1, 600.0))
    tip = "Frames per second: at most 120, in a GIF 50."
    fps = ui.bounded("fps", movie.fps, Range(5, 60, is_integer=True), tip, (1.0, 120.0))
    start = bounded_time("from", movie.start, "First time of the movie.")
    beyond = " Beyond τ the flow is extrapolated." if document.extrapolates else ""
    tip = f"Last time of the movie.{beyond}"
    end = bounded_time("to", movie.end, tip)
    tip, unlimited = "Rotation of the surfaces during the movie, in degrees.", (-math.inf, math.inf)
    turn = ui.bounded("turntable", movie.turntable, Range(-360, 360), tip, unlimited)
    exporter.movie = replace(movie, seconds=seconds, fps=fps, start=start, end=end, turntable=turn)
