"""The channels: pairs of a source and a target, each with a weight, and the functions of the active one."""

from __future__ import annotations

from abfm import FunctionError
from abfm.functions import Family, Sum, parse
from abfm_viewer.document import Side
from abfm_viewer.panels import function_editor
from abfm_viewer.session import Session
from abfm_viewer.ui import Ui

_SIDES: tuple[Side, ...] = ("source", "target")


def draw(ui: Ui, session: Session) -> None:
    """Draw the list and the editors of both sides."""
    if session.active is None:
        ui.note("A source and a target for this mesh are being chosen ...")
        return
    _draw_channels(ui, session)
    for side in _SIDES:
        with ui.group(side):
            ui.heading(side, ui.colors.source if side == "source" else ui.colors.target)
            function_editor.draw(ui, session, side)
    ui.note("Shift-click or Shift-drag on the source or the target moves its Gaussian; Shift-wheel sets its width.")


def _draw_channels(ui: Ui, session: Session) -> None:
    if len(session.channels) > 1:
        for number, channel in enumerate(session.channels):
            label = f"{number + 1}: {_short(channel.source)} to {_short(channel.target)}, weight {channel.weight:g}"
            chosen, _ = ui.row(label, number == session.document.channel)
            if chosen:
                session.select(channel=number, bump=0)
    if ui.button("Add", "One more channel: another pair of functions that the same flow should match."):
        session.add_channel()
    ui.beside_if_fits("Duplicate")
    if ui.button("Duplicate", "Copy the active channel."):
        session.duplicate_channel()
    ui.beside_if_fits("Remove")
    if ui.button("Remove", "Remove the active channel.", enabled=len(session.channels) > 1):
        session.remove_channel()
    ui.beside_if_fits("Swap")
    if ui.button("Swap", "Exchange the active channel's source and target."):
        session.swap_channel()
    if len(session.channels) > 1 and session.active is not None:
        weight = ui.number("weight", session.active.weight, 0, 10, "How much the active channel's mismatch counts.")
        if weight is not None:
            try:
                session.set_weight(weight, "weight")
                ui.refuse("weight", "")
            except FunctionError as error:
                ui.refuse("weight", str(error))


def _short(spec: str) -> str:
    """A function in a word."""
    tree = parse(spec)
    if isinstance(tree, Sum):
        return f"{len(tree.terms)} terms"
    return tree.family if isinstance(tree, Family) else "function"
