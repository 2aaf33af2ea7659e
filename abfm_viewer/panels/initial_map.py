"""How surface A comes to surface B before anything flows: the choice of the initial map."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from abfm_viewer.document.verdict_words import sentence
from abfm_viewer.panels.context import Context
from abfm_viewer.session.initial_maps import GIVEN
from abfm_viewer.session.session_files import MESHES

_ABOUT = "Where each point of B lies on A before anything flows; the flow on B goes on from there."
_MIRRORED = "See sphere A in a mirror first, as between left and right."
_MIRROR = "mirror"


class _Choice(NamedTuple):
    """A word of `abfm.registration`, and what it means; of which surfaces it takes files."""

    word: str
    about: str
    of_files: tuple[str, ...] = ()


_CHOICES = {
    "automatic": _Choice("", "Chosen by what there is."),
    "same connectivity": _Choice("connectivity", "Vertex i to vertex i: the faces are the same."),
    "sphere to sphere": _Choice(
        "sphere", "For surfaces that are spheres; A is turned as the functions ask."
    ),
    "spheres from files...": _Choice(
        "sphere", "Through spheres with the same vertices; A's is turned as asked.", ("A", "B")
    ),
    "closest points": _Choice("closest", "The closest points after alignment in space."),
    "eigenfunctions": _Choice("spectral", "By eigenfunctions: surfaces that are nearly isometric."),
    "as opened": _Choice(GIVEN, "The map that the file came with."),
}
"""By their labels."""


def draw(context: Context) -> None:
    """Draw the choice, where there are two surfaces."""
    ui, session = context.ui, context.session
    word, mirror, files = _parts(session.document.initial)
    now = next(
        (
            label
            for label, choice in _CHOICES.items()
            if choice.word == word and bool(choice.of_files) == bool(files)
        ),
        word,
    )
    offered = [label for label in _CHOICES if _is_offered(context, label)]
    words = {label: _CHOICES[label].about for label in offered} | {now: ""}
    words[now] = _CHOICES[now].about if now in _CHOICES else ""
    about = ", ".join(Path(file).name for file in files) or words[now]
    label = ui.combo("initial map", now, words, f"{_ABOUT}\n\n{sentence(now)} {about}")
    if label != now:
        choice = _CHOICES[label]
        if choice.of_files:
            _choose_files(context, choice, ())
        else:
            session.editor.set_initial(choice.word)
    if word == "sphere":
        wanted = ui.checkbox("mirrored", mirror, _MIRRORED)
        if wanted != mirror:
            session.editor.set_initial(_joined(word, wanted, files))


def draw_notes(context: Context) -> None:
    """Say why there is no map, or what is worth knowing of it."""
    session = context.session
    if not session.document.is_pair:
        return
    if session.prepared is not None:
        for note in session.prepared.notes:
            context.ui.note(sentence(note))
    elif error := session.initial_maps.error:
        context.ui.note(f"No initial map: {error}", "failure")


def _is_offered(context: Context, label: str) -> bool:
    from abfm.registration.initial.words import WORDS

    word = _CHOICES[label].word
    is_given = word == GIVEN and context.session.document.initial_map is not None
    return word in ("", *WORDS) or (is_given and context.session.document.initial == GIVEN)


def _choose_files(context: Context, choice: _Choice, chosen: tuple[str, ...]) -> None:
    """Let the user choose one file after the other; nothing changes before the last."""
    missing = choice.of_files[len(chosen) :]
    if not missing:
        context.session.editor.set_initial(_joined(choice.word, mirror=False, files=chosen))
        return

    def take(path: Path) -> None:
        _choose_files(context, choice, (*chosen, str(path)))

    context.dialogs.open(f"Open the sphere of {missing[0]}", MESHES, take)


def _parts(word: str) -> tuple[str, bool, tuple[str, ...]]:
    """Return a word without what follows it, whether it is mirrored, and its files."""
    base, _, rest = word.partition(":")
    parts = tuple(part for part in rest.split(",") if part)
    mirror = parts[:1] == (_MIRROR,)
    return base, mirror, parts[mirror:]


def _joined(word: str, mirror: bool, files: tuple[str, ...]) -> str:
    rest = ",".join([*([_MIRROR] if mirror else []), *files])
    return f"{word}:{rest}" if rest else word
