"""Landmarks: pairs of corresponding points on the surfaces of source and target."""

from functools import partial
from pathlib import Path

import abfm
from abfm.wording import counted, share
from abfm_viewer.document.document import SIDES, Document, Landmark
from abfm_viewer.document.keyboard import hint
from abfm_viewer.document.surface_points import landmark_pairs, landmarks_of
from abfm_viewer.files.names import suggested_name
from abfm_viewer.panels.context import Context
from abfm_viewer.session.session import Session

FILES = (".csv", ".txt", ".vts")
PLACE_TIP = (
    f"Place pairs of points that the flow should match ({hint('place landmarks')}). Click on one "
    "surface and then on the corresponding point of the other; drag a point to move it."
)
_ALONE_TIP = "Match only the landmarks. The functions are advected by the same flow."
_OPEN_TIP = "Open pairs from a file. Each line has vertices of both surfaces or their coordinates."
_SAVE = "Write the pairs to a .csv file, as coordinates on both surfaces."
_REMOVE = f"Remove the selected landmark from both surfaces ({hint('remove landmark')})."


def draw(context: Context) -> None:
    """Draw the list of landmarks, if there are any or the user is placing some."""
    ui, document = context.ui, context.session.document
    places = document.view.tool == "landmark"
    if not (document.landmarks or places):
        return
    ui.heading("landmarks")
    if places and not document.pairs:
        first, second = (document.surface_label(side) for side in SIDES)
        ui.note(f"Click on {first}, then on {second}.")
    if document.landmarks:
        _draw_list(context)
    elif ui.button("Open landmarks...", _OPEN_TIP):
        open_file(context)


def open_file(context: Context) -> None:
    context.dialogs.open("Open landmarks", FILES, lambda path: read(context.session, path))


def _draw_list(context: Context) -> None:
    ui, session, editor = context.ui, context.session, context.session.editor
    document, errors = session.editor.draft, _errors(session)
    # above the list, so that the buttons do not move when landmarks are added
    if ui.button("Remove##landmark", _REMOVE):
        editor.remove_landmark()
    ui.same_line_if_fits("Clear landmarks", is_button=True)
    if ui.button("Clear landmarks", "Remove all landmarks."):
        editor.set_landmarks("clear landmarks", ())
    ui.same_line_if_fits("Open landmarks...", is_button=True)
    if ui.button("Open landmarks...", _OPEN_TIP):
        open_file(context)
    with ui.disabled(not document.pairs, "There are no landmarks."):
        if ui.button("Save landmarks...", _SAVE):
            name, write_to = suggested_name(document, "landmarks", ".csv"), partial(write, session)
            context.dialogs.save("Save landmarks", FILES[:1], name, write_to)
    ui.same_line_if_fits("landmarks alone")
    alone = ui.checkbox("landmarks alone", document.landmarks_alone, _ALONE_TIP)
    step = f"match {'landmarks alone' if alone else 'functions as well'}"
    editor.change(step, landmarks_alone=alone)
    for number, landmark in enumerate(document.landmarks):
        label = f"{number + 1}: {_row_text(document, landmark, errors.get(landmark))}"
        if ui.row(label, number == document.landmark)[0]:
            editor.select(landmark=number)


def read(session: Session, path: Path) -> None:
    a, b = (session.surface(side).mesh for side in SIDES)
    with session.notices.showing_errors():
        found = landmarks_of(abfm.registration.read_landmarks(a, b, str(path)))
        session.editor.set_landmarks(f"open {path.name}", found)
        session.notices.show(f"opened {counted(len(found), 'landmark')} of {path.name}")


def write(session: Session, path: Path) -> None:
    a, b = (session.surface(side).mesh for side in SIDES)
    found = landmark_pairs(a, b, session.document.pairs)
    if found is not None:
        with session.notices.showing_errors():
            found.save(path)
            session.notices.show(f"saved {path}")


def _row_text(document: Document, landmark: Landmark, error: float | None) -> str:
    name = f"{landmark.name}, " if landmark.name else ""
    missing = [document.surface_label(side) for side in SIDES if landmark.point(side) is None]
    if missing:
        return f"{name}not yet placed on {missing[0]}, so not used"
    return f"{name}{'placed' if error is None else f'{share(error)} away'}"


def _errors(session: Session) -> dict[Landmark, float]:
    """Return the landmark errors of a match that is up to date, as fractions of sqrt(area)."""
    result, pairs = session.result, session.document.pairs
    if result is None or session.outdated or session.solver.running:
        return {}
    errors = result.landmark_errors
    if errors is None or len(errors) != len(pairs):
        return {}
    return dict(zip(pairs, errors.tolist(), strict=True))
