"""Choice of the initial map from surface A to surface B."""

from pathlib import Path
from typing import NamedTuple

from abfm.reading import VALUES_ENDINGS
from abfm.wording import sentence
from abfm_viewer.document.kinds import GIVEN_WORD, PairDocument
from abfm_viewer.files.contents import MESHES
from abfm_viewer.panels.context import Context
from abfm_viewer.panels.explanations import draw_help

_MAP_TIP = (
    "Map from each point of B to A before the flow. The flow on B corrects its remaining errors."
)
_MIRRORED_TIP = "Mirror A first, for example to register a left to a right side."
_BEST_TIP = "Show the functions that the best initial map transfers, and match with it."
_SECOND_TIP = "Show the functions that the second best map transfers, and match with it."
_STEP = "change the initial map"
_MIRROR = "mirror"
_FILE = "file"
_CAN_MIRROR = ("landmarks", "extremities", "closest", "spectral", "sphere", "embedding")


class _Choice(NamedTuple):
    """A kind of initial map that the user can choose, and the files that it needs."""

    word: str
    about: str  # tooltip
    titles: tuple[str, ...] = ()  # of the dialogs that open the files
    suffixes: tuple[str, ...] = MESHES  # of the files


_CHOICES = {
    "automatic": _Choice(
        "",
        "The best of the applicable maps below, judged by stretch, descriptors, functions and "
        "landmarks.",
    ),
    "landmarks": _Choice(
        "landmarks", "From three or more landmarks, by distances, eigenfunctions or closest points."
    ),
    "ends of limbs": _Choice(
        "extremities",
        "By the ends of limbs, matched by distances. For surfaces that are not isometric.",
    ),
    "same connectivity": _Choice(
        "connectivity", "Vertex i to vertex i, for meshes of equal faces."
    ),
    "closest points": _Choice(
        "closest", "To the closest point, after a rigid alignment of B to A."
    ),
    "eigenfunctions": _Choice(
        "spectral", "By eigenfunctions and functions. For surfaces that are nearly isometric."
    ),
    "spheres": _Choice(
        "sphere",
        "For surfaces that are spheres. The sphere of A is rotated to match the functions.",
    ),
    "computed spheres": _Choice(
        "embedding",
        "By spheres computed from surfaces without handles. The sphere of A is rotated to match "
        "the functions.",
    ),
    "spheres from files...": _Choice(
        "sphere",
        "By spheres with the vertices of the surfaces. The sphere of A is rotated to match the "
        "functions.",
        ("Open the sphere of A", "Open the sphere of B"),
    ),
    "map from a file...": _Choice(
        _FILE,
        "A file with one row for each vertex of B: a vertex of A, or a face of A with barycentric "
        "weights.",
        ("Open a map from B to A",),
        (*VALUES_ENDINGS, ".map"),
    ),
}
"""Kinds of initial maps, by their labels in the drop-down list."""
_OPENED_CHOICE = {"as opened": _Choice(GIVEN_WORD, "The map in the registration file.")}


def draw(context: Context) -> None:
    ui, document, editor = context.ui, context.document(PairDocument), context.session.editor
    word, mirror, files = _parts(document.initial)
    choices = {**_CHOICES} | (_OPENED_CHOICE if word == GIVEN_WORD else {})
    fitting = (
        label
        for label, choice in choices.items()
        if choice.word == word and bool(choice.titles) == bool(files)
    )
    now = next(fitting, document.initial)  # a project may have another word
    choices.setdefault(now, _Choice(document.initial, ""))
    current = choices[now]
    names = ", ".join(Path(file).name for file in files)
    if not word:
        compared = context.session.initial_maps.compared(document)
        names = "".join(f"Chosen: {best.name}." for best in compared[:1])
    tip = "\n\n".join(filter(None, (_MAP_TIP, f"{sentence(now)} {current.about}", names)))
    label = ui.combo("initial map", now, {key: one.about for key, one in choices.items()}, tip)
    draw_help(context, "initial-map cost", "initial map")
    if label != now:
        _choose(context, choices[label], ())
    elif current.word in _CAN_MIRROR:
        ui.same_line_if_fits("mirrored")
        wanted = ui.checkbox("mirrored", mirror, _MIRRORED_TIP)
        editor.change(_STEP, initial=_joined(word, wanted, files))


def draw_notes(context: Context) -> None:
    """Draw notes and warnings about the initial map, or the reason why there is no initial map."""
    session = context.session
    _draw_best_two(context)
    if session.initial_maps.waits_for_placing(context.document(PairDocument)):
        context.ui.note("The initial map is found anew when placing stops or a match starts.")
    if session.work.prepared is not None:
        for note in session.work.prepared.initial.notes:
            context.ui.note(sentence(note))
        for warning in session.work.prepared.initial.warnings:
            context.ui.note(sentence(warning), "warning")
    elif error := session.initial_maps.error:
        context.ui.note(f"No initial map: {error}", "failure")


def _draw_best_two(context: Context) -> None:
    """Draw a choice between the best two initial maps, and show what the chosen one transfers."""
    document = context.document(PairDocument)
    candidates = context.session.initial_maps.compared(document)[:2]
    words = ["", *(each.name for each in candidates[1:])]
    if len(words) > 1 and document.initial in words:
        labels = [f"{each.name}, cost {each.cost:.2f}" for each in candidates]
        now = labels[words.index(document.initial)]
        chosen = context.ui.radio(labels, now, [_BEST_TIP, _SECOND_TIP])
        context.session.editor.change(_STEP, initial=words[labels.index(chosen)])


def _choose(context: Context, choice: _Choice, files: tuple[str, ...]) -> None:
    """Let the user choose the files that are not yet in ``files``, and then apply the map."""
    missing = choice.titles[len(files) :]
    if not missing:
        context.session.editor.change(_STEP, initial=_joined(choice.word, False, files))
        return

    def take(path: Path) -> None:
        _choose(context, choice, (*files, str(path)))

    context.dialogs.open(missing[0], choice.suffixes, take)


def _parts(word: str) -> tuple[str, bool, tuple[str, ...]]:
    """Split the text of an initial map into its kind, whether A is mirrored, and its files."""
    base, _, rest = word.partition(":")
    if base == _FILE:
        return base, False, (rest,)
    parts = tuple(part for part in rest.split(",") if part)
    mirror = parts[:1] == (_MIRROR,)
    return base, mirror, parts[mirror:]


def _joined(word: str, mirror: bool, files: tuple[str, ...]) -> str:
    rest = ",".join((*((_MIRROR,) if mirror else ()), *files))
    return f"{word}:{rest}" if rest else word
