"""The channels, pairs of functions that one flow should match, and the source and the target of the active one."""

from pathlib import Path

from abfm import functions
from abfm_viewer.appearance.abbreviation import cut
from abfm_viewer.document.document import SIDES
from abfm_viewer.panels import function_editor
from abfm_viewer.panels.context import Context

_LONGEST = 16  # letters
_BY_MOUSE = "Shift-click or Shift-drag on the source or target moves its Gaussian; Shift-wheel sets its width."
_ADD = (
    "One more channel: another pair of functions that the same flow should match. It begins as a landmark that stays "
    "where it is, far from the Gaussians of the others."
)
_WEIGHT = "How much the active channel's mismatch counts among the others'; 0 leaves the channel out."


def draw(context: Context) -> None:
    ui, session = context.ui, context.session
    if session.active is None:
        ui.note("A source and a target for this mesh are being chosen.")
        return
    _draw_channels(context)
    for side in SIDES:
        with ui.group(side):
            function_editor.draw(context, side)
    ui.line("Shift-drag on a surface moves its Gaussian.", tip=_BY_MOUSE)


def _draw_channels(context: Context) -> None:
    """Draw the list where there are several, and the buttons that change it."""
    ui, session = context.ui, context.session
    several = len(session.channels) > 1
    if several:
        for number, channel in enumerate(session.channels):
            weight = "" if channel.weight == 1 else f", weight {channel.weight:g}"
            source, target = (_short(functions.parse(spec)) for spec in (channel.source, channel.target))
            label = f"{number + 1}: {source} to {target}{weight}"
            if ui.row(label, number == session.document.channel)[0]:
                session.select(channel=number, bump=0)
    if ui.button("Add", _ADD):
        session.add_channel()
    ui.beside_if_fits("Duplicate")
    if ui.button("Duplicate", "Copy the active channel."):
        session.duplicate_channel()
    ui.beside_if_fits("Remove")
    if ui.button("Remove", "Remove the active channel.", enabled=several):
        session.remove_channel()
    ui.beside_if_fits("Swap")
    if ui.button("Swap", "Exchange the active channel's source and target."):
        session.swap_channel()
    if several and session.active is not None:
        changed = ui.number("weight", session.active.weight, 0, 10, _WEIGHT)
        if changed is not None:
            with ui.refusing("weight"):
                session.set_weight(changed, "weight")


def _short(tree: functions.Spec) -> str:
    """A function in a word or two, which tell channels of one kind apart."""
    if isinstance(tree, functions.Sum):
        words = {term.family if isinstance(term, functions.Family) else "function" for term in tree.terms}
        return f"{len(tree.terms)} {words.pop()}s" if len(words) == 1 else f"{len(tree.terms)} terms"
    if isinstance(tree, functions.Permuted):
        return f"{_short(tree.function)}, {Path(tree.path).name}"
    if not isinstance(tree, functions.Family):
        return "function"
    if tree.positional is None:
        return tree.family
    word = str(getattr(tree, tree.positional))
    if any(parameter.kind.suffixes for parameter in tree.parameters()):
        return cut(Path(word).name, _LONGEST, len)
    return cut(word, _LONGEST, len) if tree.is_open_ended else f"{tree.family} {word}"
