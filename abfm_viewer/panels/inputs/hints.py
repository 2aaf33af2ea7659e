"""Hints on functions that no flow can match, with changes that make a match possible."""

from abfm.outcome import Facts
from abfm.wording import sentence
from abfm_viewer.document.document import SIDES, Side
from abfm_viewer.panels.context import Context

_SCALE_LABELS: dict[Side, str] = {"source": "Scale source", "target": "Scale target"}
_SCALE_TIP = "Scale and shift the {side} to the range of the other function."
_SMOOTHING_TIP = (
    "Smooth both functions over {length:g} sqrt(area), the shortest length after which their peaks "
    "and pits agree. The text of the functions shows this."
)


def draw(context: Context) -> None:
    """Draw the obstacles to a match of the functions, each with its remedies, or with advice."""
    for facts in context.session.work.expected_obstacles:
        context.ui.note(sentence(facts.reason), facts.tone)
        if not _draw_remedies(context, facts) and facts.advice:
            context.ui.note(f"Advice: {facts.advice}.")


def _draw_remedies(context: Context, facts: Facts) -> bool:
    """Draw buttons that remove an obstacle; return whether there is one."""
    ui, session = context.ui, context.session
    if "values differ" in facts.topics:
        sides = [side for side in SIDES if session.scaled_channels(side) != session.channels]
        for side in sides:
            if side != sides[0]:
                ui.same_line()
            if ui.button(_SCALE_LABELS[side], _SCALE_TIP.format(side=side)):
                session.scale(side)
        return bool(sides)
    found = session.work.sufficient_smoothing if "extrema differ" in facts.topics else None
    if found is not None and ui.button("Smooth", _SMOOTHING_TIP.format(length=found[1])):
        session.smooth(*found)
    return found is not None
