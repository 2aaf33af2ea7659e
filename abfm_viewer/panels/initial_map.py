"""How surface A comes to surface B before anything flows: the choice of the initial map."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from abfm.reading import VALUES_ENDINGS
from abfm.wording import sentence
from abfm_viewer.document.kinds import GIVEN_WORD, PairDocument
from abfm_viewer.files.contents import MESHES
from abfm_viewer.panels.context import Context

_MAP_TIP = (
    "Where each point of B lies on A before anything flows; the flow on B goes on from there."
)
_MIRRORED_TIP = "See A in a mirror first, as between left and right."
_STEP = "change the initial map"
_MIRROR = "mirror"
_FILE = "file"


class _Choice(NamedTuple):
    """A word of `abfm.registration.initial`, what it means, and the files that it takes."""

    word: str
    about: str
    titles: tuple[str, ...] = ()
    suffixes: tuple[str, ...] = MESHES
    can_mirror: bool = False


_CHOICES = {
    "automatic": _Choice(
        "",
        "The best of the following maps that apply, compared by how much they stretch the "
        "surfaces, and by descriptors, functions and landmarks.",
    ),
    "landmarks": _Choice(
        "landmarks",
        "From three or more landmarks: by distances to them, by eigenfunctions, or closest points.",
        can_mirror=True,
    ),
    "ends of limbs": _Choice(
        "extremities",
        "By the ends of limbs, matched by distances, for surfaces that are not isometric.",
        can_mirror=True,
    ),
    "same connectivity": _Choice("connectivity", "Vertex i to vertex i, of the same faces."),
    "closest points": _Choice(
        "closest", "To the closest point, after B was laid on A.", can_mirror=True
    ),
    "eigenfunctions": _Choice(
        "spectral",
        "By eigenfunctions and functions, of surfaces that are nearly isometric.",
        can_mirror=True,
    ),
    "spheres": _Choice(
        "sphere",
        "The surfaces are spheres; A's is turned as the functions ask.",
        can_mirror=True,
    ),
    "spheres made of both": _Choice(
        "embedding",
        "Through spheres that are made of the surfaces, which have no handles; A's is turned as "
        "the functions ask.",
        can_mirror=True,
    ),
    "spheres from files...": _Choice(
        "sphere",
        "Through spheres with the surfaces' vertices; A's is turned as the functions ask.",
        ("Open the sphere of A", "Open the sphere of B"),
        can_mirror=True,
    ),
    "map from a file...": _Choice(
        _FILE,
        "For each vertex of B its vertex of A, or a face and weights.",
        ("Open a map from B to A",),
        (*VALUES_ENDINGS, ".map"),
    ),
}
"""By their labels."""
_OPENED_CHOICE = {"as opened": _Choice(GIVEN_WORD, "The map that the file came with.")}


def draw(context: Context) -> None:
    """Draw the choice of the map between two surfaces."""
    ui, document, editor = context.ui, context.document(PairDocument), context.session.editor
    word, mirror, files = _parts(document.initial)
    choices = {**_CHOICES} | (_OPENED_CHOICE if word == GIVEN_WORD else {})
    fitting = (
        label
        for label, choice in choices.items()
        if choice.word == word and bool(choice.titles) == bool(files)
    )
    now = next(fitting, document.initial)  # one that was typed into a project
    choices.setdefault(now, _Choice(document.initial, ""))
    known = choices[now]
    names = ", ".join(Path(file).name for file in files)
    tip = "\n\n".join(filter(None, (_MAP_TIP, f"{sentence(now)} {known.about}", names)))
    label = ui.combo("initial map", now, {key: one.about for key, one in choices.items()}, tip)
    if label != now:
        _choose(context, choices[label], ())
    elif known.can_mirror:
        ui.beside_if_fits("mirrored")
        wanted = ui.checkbox("mirrored", mirror, _MIRRORED_TIP)
        editor.change(_STEP, initial=_joined(word, wanted, files))


def draw_notes(context: Context) -> None:
    """Say why there is no map, or what is worth knowing of it."""
    session = context.session
    if session.work.prepared is not None:
        for note in session.work.prepared.initial.notes:
            context.ui.note(sentence(note))
        for warning in session.work.prepared.initial.warnings:
            context.ui.note(sentence(warning), "warning")
    elif error := session.initial_maps.error:
        context.ui.note(f"No initial map: {error}", "failure")


def _choose(context: Context, choice: _Choice, files: tuple[str, ...]) -> None:
    """Take a choice, and let the user choose its files before, one after the other."""
    missing = choice.titles[len(files) :]
    if not missing:
        context.session.editor.change(_STEP, initial=_joined(choice.word, False, files))
        return

    def take(path: Path) -> None:
        _choose(context, choice, (*files, str(path)))

    context.dialogs.open(missing[0], choice.suffixes, take)


def _parts(word: str) -> tuple[str, bool, tuple[str, ...]]:
    """Return a word without what follows it, whether A is mirrored, and files."""
    base, _, rest = word.partition(":")
    if base == _FILE:
        return base, False, (rest,)
    parts = tuple(part for part in rest.split(",") if part)
    mirror = parts[:1] == (_MIRROR,)
    return base, mirror, parts[mirror:]


def _joined(word: str, mirror: bool, files: tuple[str, ...]) -> str:
    rest = ",".join((*((_MIRROR,) if mirror else ()), *files))
    return f"{word}:{rest}" if rest else word
