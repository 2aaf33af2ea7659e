"""What the advected surface shows: its function, the field's numbers, or the flow as a map."""

from abfm_viewer.document.document import Coloring
from abfm_viewer.panels.context import Context

_TIPS: dict[Coloring, str] = {
    "function": "The advected function itself.",
    "speed": "How fast the field is, in sqrt(area) per time.",
    "divergence": "Where the flow spreads (positive) and where it gathers.",
    "curl": "Where the flow turns, and which way.",
    "coordinates": "The coordinates as red, green and blue, carried by the flow.",
    "checker": "A checkerboard, carried by the flow.",
    "area distortion": "How much larger (red) or smaller (blue) the map makes each face.",
    "conformal distortion": "How much the map stretches each face in one direction more than in "
    "the other.",
}


def draw(context: Context) -> None:
    ui, session = context.ui, context.session
    now = session.view.coloring
    tip = f"What the advected surface shows. {_TIPS[now]}"
    chosen = ui.combo("color by", now, _TIPS, tip)
    session.editor.set_view(f"color by {chosen}", coloring=chosen)
