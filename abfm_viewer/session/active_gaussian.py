"""The active Gaussian of the source or target, which the mouse and the Functions tab change."""

from abfm_viewer.document import gaussians
from abfm_viewer.document.document import Side
from abfm_viewer.session.session import Session

_WIDTH_PER_NOTCH = 1.12
WIDTH_MIN = 0.005
WIDTH_MAX = 2.0
_FRAMES = "frames have no Gaussian"
_NO_GAUSSIAN = "the {} has no Gaussian to {}; choose the family gaussian in the tab Functions"


def active_gaussian(session: Session, side: Side) -> int | None:
    if session.active is None:
        return None
    count = len(gaussians.gaussians(session.active.spec(side)))
    draft = session.editor.draft
    wanted = draft.bump if draft.side == side else 0
    return min(wanted, count - 1) if count else None


def obstacle_to_move(session: Session, side: Side) -> str:
    """Return why the mouse cannot move a Gaussian of the source or target; empty if it can."""
    if not session.document.has_sides:
        return _FRAMES
    if session.active is None:
        return f"the {side} is still being chosen"
    if active_gaussian(session, side) is None:
        return _NO_GAUSSIAN.format(side, "move")
    if gaussians.is_mapped(session.active.spec(side)):
        remedy = "type the vertex of its Gaussian in the tab Functions"
        return f"the {side} uses a vertex map, so the mouse cannot move its Gaussian; {remedy}"
    return ""


def move(session: Session, side: Side, vertex: int, merge: str) -> None:
    """Move the active Gaussian of a side to a vertex, and record this as a step of undo.

    ``vertex`` is an index of the loaded mesh, whose vertices may be numbered differently in the
    file. Consecutive moves with the same key ``merge`` are one step of undo.
    """
    chosen = active_gaussian(session, side)
    in_file = int(session.surface(side).mesh.vertex_ids[vertex])
    if chosen is not None and session.active is not None:
        spec = gaussians.changed(session.active.spec(side), chosen, vertex=(in_file,))
        session.editor.set_spec(side, spec, merge, chosen)


def widen(session: Session, side: Side, notches: float, merge: str) -> None:
    """Widen the active Gaussian by notches of the mouse wheel; negative ones narrow it.

    Consecutive changes with the same key ``merge`` are one step of undo.
    """
    chosen = active_gaussian(session, side)
    if chosen is None or session.active is None:
        has_sides = session.document.has_sides
        session.notices.show(_NO_GAUSSIAN.format(side, "widen") if has_sides else _FRAMES)
        return
    spec = session.active.spec(side)
    width = gaussians.gaussians(spec)[chosen].width * _WIDTH_PER_NOTCH**notches
    width = float(f"{min(max(width, WIDTH_MIN), WIDTH_MAX):.3g}")
    session.editor.set_spec(side, gaussians.changed(spec, chosen, width=width), merge, chosen)
