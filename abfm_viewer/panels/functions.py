"""The channels, pairs of functions for one flow, and both functions of the active one."""

from pathlib import Path

from abfm import functions
from abfm_viewer.appearance.abbreviation import cut
from abfm_viewer.document.document import SIDES
from abfm_viewer.panels import function_editor
from abfm_viewer.panels.context import Context
from abfm_viewer.widgets.slider_range import Range

_LONGEST = 16  # letters
_BY_MOUSE = "On the source or target; a click moves it there, and Shift-wheel sets its width."
_ADD = (
    "One more channel: another pair of functions that the same flow should match. It begins as a "
    "landmark that stays where it is, far from the Gaussians of the others."
)
_WEIGHT = "How much the active channel's mismatch counts among the others'; 0 leaves it out."


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
    for number, channel in enumerate(session.channels if several else ()):
        weight = "" if channel.weight == 1 else f", weight {channel.weight:g}"
        source, target = (_short(functions.parse(channel.spec(side))) for side in SIDES)
        label = f"{number + 1}: {source} to {target}{weight}"
        if ui.row(label, number == session.document.channel)[0]:
            session.editor.select(channel=number, bump=0)
    if ui.button("Add", _ADD):
        session.editor.add_channel()
    ui.beside_if_fits("Duplicate")
    if ui.button("Duplicate", "Copy the active channel."):
        session.editor.duplicate_channel()
    ui.beside_if_fits("Remove")
    if ui.button("Remove", "Remove the active channel.", enabled=several):
        session.editor.remove_channel()
    ui.beside_if_fits("Swap")
    if ui.button("Swap", "Exchange the active channel's source and target."):
        session.editor.swap_channel()
    if several and session.active is not None:
        changed = ui.number("weight", session.active.weight, Range(0, 10), _WEIGHT)
        if changed is not None:
            with ui.refusals.refusing("weight"):
                session.editor.set_weight(changed, "weight")


def _short(tree: functions.Spec) -> str:
    """Return a function in a word or two, which tell channels of one kind apart."""
    if isinstance(tree, functions.Sum):
        families = {getattr(term, "family", "function") for term in tree.terms}
        return f"{len(tree.terms)} {families.pop() + 's' if len(families) == 1 else 'terms'}"
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
