"""Tabs of a sequence of frames: the frames, a separate match of two of them, and the settings."""

from dataclasses import replace

import numpy as np

from abfm.errors import ParameterError
from abfm.parameters import LAST_SIGMA
from abfm.wording import sentence
from abfm_viewer.document.frame_sequence import FrameSequence
from abfm_viewer.document.kinds import SequenceDocument
from abfm_viewer.panels.context import Context
from abfm_viewer.widgets.toolkit import AUTO, Auto, Ui, finite
from abfm_viewer.widgets.widget_record import Range

_OPEN_TIP = "Open frames for the current mesh. Files can also be dropped on the window."
_STEP = "Seconds between frames. Without a value, times are numbers of frames."
_CIRCULAR_TIP = (
    "The values are phases, which repeat after a period. Compare their cosine (channel 0) and sine "
    "(channel 1) instead of the values."
)
_PAIR = "First and last frame of the separate match, by default those around the shown time."
_MATCH = "Open a separate match of these two frames. Undo returns to the sequence."
_GAMMA = (
    "Smoothness in time: larger if the fields flicker, 0 for independent intervals. Default: 1."
)
_ORDER = (
    "Order of the norm of the fields: 2 gives smoother fields, 1 is as in the paper. Auto chooses "
    "the order that best predicts patches of the surface that the fit does not use."
)
_ALPHA = "Smoothness of the fields: smaller if motion is missed, larger if they are rough."
_SIGMA = (
    "Weight of the smoothness, in standard deviations of the frames. Smaller values match more "
    "closely."
)
_CHOSEN_TIP = (
    "Choose the value that best predicts patches of the surface that the fit does not use, in some "
    "intervals."
)
_AUTO = {"alpha": Auto(1.0, _CHOSEN_TIP), "sigma": Auto(LAST_SIGMA, _CHOSEN_TIP)}


def draw_frames(context: Context) -> None:
    ui, session, document = context.ui, context.session, context.document(SequenceDocument)
    sequence = document.sequence
    if ui.button("Open mesh...", "Open a mesh file. It can also be dropped on the window."):
        context.open_mesh()
    ui.same_line_if_fits("Open frames...", is_button=True)
    if ui.button("Open frames...", _OPEN_TIP):
        context.open_frames()
    ui.line(document.name, "ink")
    mesh = document.surface().mesh
    ui.line(f"{len(mesh.vertices):,} vertices, {len(mesh.faces):,} faces")
    for message in mesh.messages:
        ui.note(message)
    ui.heading("frames")
    ends = f"{sequence.time_text(document.start)} to {sequence.time_text(document.end)}"
    ui.line(f"{len(sequence)} frames, {ends}", "ink")
    for note in sequence.frames.notes:
        ui.note(sentence(note))
    if sequence.channels > 1:
        words = [str(number) for number in range(sequence.channels)]
        tip = "The channel that is shown. All channels are matched by the same fields."
        chosen = ui.combo("channel", words[document.channel], words, tip)
        session.editor.select(channel=words.index(chosen))
    if sequence.frames.mask is not None:
        unknown = int(np.count_nonzero(sequence.frames.mask == 0))
        ui.note(f"Vertices without values (grey, not compared): {unknown:,}")
    if sequence.phases is not None or sequence.period is not None:
        is_circular = sequence.phases is not None
        if ui.checkbox("circular", is_circular, _CIRCULAR_TIP) != is_circular:
            context.files.set_circular(document, None if is_circular else sequence.period)
    _draw_step(ui, context, sequence)


def _draw_step(ui: Ui, context: Context, sequence: FrameSequence) -> None:
    steps = sequence.frames.durations / np.diff(sequence.numbers)
    is_even = bool(np.allclose(steps, steps[0], rtol=1e-6))
    shown = f"{steps[0]:.6g}" if is_even else "uneven"
    typed = ui.text(f"frame step ({sequence.unit or 'frames'})###frame step", shown, _STEP)
    if typed is not None:
        with ui.refusals.refusing("frame step"):
            if (step := finite(typed)) is None or not step > 0:
                raise ParameterError(
                    f"{typed} is not a time; expected seconds above 0, such as 0.04"
                )
            times = step * np.array(sequence.numbers, dtype=np.float64)
            changed = replace(
                sequence, frames=replace(sequence.frames, times=times, unit_of_time="s")
            )
            time = float(np.interp(context.session.document.time, sequence.times, times))
            change = context.session.editor.change
            change("change the frame step", sequence=changed, result=None, time=time)
    ui.refusal("frame step")


def draw_pair(context: Context) -> None:
    """Draw the choice of two frames, and the button that matches only these two."""
    ui, session, document = context.ui, context.session, context.document(SequenceDocument)
    sequence = document.sequence
    ui.heading("two frames")
    now = document.interval
    first, last = session.sequence_match.pair or (now, now + 1)
    numbers = sequence.numbers
    limits = numbers[0], numbers[-1]
    ends = Range(*limits, is_integer=True)
    begin, end = (
        int(np.searchsorted(numbers, ui.bounded(label, numbers[at], ends, _PAIR, limits)))
        for label, at in (("from frame", first), ("to frame", last))
    )
    if (begin, end) != (first, last):
        session.sequence_match.pair = begin, end
    if ui.button("Match these two frames", _MATCH, enabled=begin != end, width=-1):
        session.sequence_match.pair = None
        context.files.match_frames(document, begin, end)


def draw_settings(context: Context) -> None:
    ui, document, editor = context.ui, context.document(SequenceDocument), context.session.editor
    settings = document.settings
    for label, name, ends, tip in (
        ("smoothness α##alpha", "alpha", Range(1e-4, 1e4, log=True), _ALPHA),
        ("closeness σ##sigma", "sigma", Range(1e-3, 20, log=True), _SIGMA),
        ("coupling γ##gamma", "gamma", Range(0, 100, log=True), _GAMMA),
    ):
        value = getattr(settings, name)
        new = ui.number_or_auto(label, value, ends, tip, _AUTO.get(name))
        if new is not None and new != (AUTO if value is None else value):
            with ui.refusals.refusing(name, label.partition("##")[0]):
                given = {name: None if new == AUTO else new}
                editor.set_sequence_settings(name, f"change {label.partition('##')[0]}", **given)
        ui.refusal(name)
    shown = AUTO if settings.order is None else str(settings.order)
    order = ui.combo("norm order##order", shown, (AUTO, "1", "2"), _ORDER)
    if order != shown:
        editor.set_sequence_settings(
            "order", "change the norm order", order=None if order == AUTO else int(order)
        )
    if chosen := _chosen(document):
        ui.line(chosen)


def _chosen(document: SequenceDocument) -> str:
    """Return the settings that the solver chose, such as ``chosen: α 0.3``; empty for none."""
    result, settings = document.result, document.settings
    if result is None:
        return ""
    used = result.parameters
    words = [
        f"{word} {value:.3g}"
        for word, given, value in (
            ("order", settings.order, used.order),
            ("α", settings.alpha, used.alpha),
            ("σ", settings.sigma, result.sigma),
        )
        if given is None
    ]
    return f"chosen: {', '.join(words)}" if words else ""
