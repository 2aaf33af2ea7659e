"""Formats of exported files, by the kind of document."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import NamedTuple

import abfm
from abfm.wording import capital
from abfm_viewer.document.kinds import PairDocument, SequenceDocument
from abfm_viewer.files import outputs
from abfm_viewer.panels.context import Context
from abfm_viewer.session.functions import known_values
from abfm_viewer.session.saving.exporter import LABELS, MOVIES, PICTURES, TABLES, Known

PICTURE = "Picture"
MOVIE = "Movie"
PAGE = "Page for a browser"
_PAGE_SUFFIX = ".html"
_RESULT_TIPS = {
    "match": "The match (.npz), mesh, functions and field (.ply, .vtu), or energies (.csv).",
    "registration": (
        "The correspondence of A and B (.npz). Also A's faces on B (.gii, .ply, .reg), or A's "
        "vertex for each vertex of B (.txt, .csv, .npy)."
    ),
    "sequence": (
        "Frames and fields (.npz, .pvd for ParaView). Also the speed at vertices (-lh.stc or "
        "-rh.stc by hemisphere, .gii)."
    ),
}
_SEQUENCE_SUFFIXES = (".npz", ".pvd", "-lh.stc", "-rh.stc", ".gii")


class Format(NamedTuple):
    """A format of an exported file."""

    tip: str
    suffixes: tuple[str, ...]
    content: str  # a word for the name of the file
    save: Callable[[Path], object]
    is_ready: bool = True


def formats(context: Context) -> dict[str, Format]:
    """Return the formats to which the document can be exported, by their names in the window."""
    session, exporter, document = context.session, context.exporter, context.session.document
    kinds = {SequenceDocument: "sequence", PairDocument: "registration"}
    kind = kinds.get(type(document), "match")
    match, found = document.result, document.complete_result
    known: Known = partial(known_values, document, session.functions.of_document(document))

    def save_result(result: object, path: Path) -> None:
        exporter.save_result(path, result, partial(session.saves.record_export, document))

    def of_result(result: object, word: str, suffixes: tuple[str, ...]) -> Format:
        save = partial(save_result, result)
        return Format(_RESULT_TIPS[word], suffixes, word, save, result is not None)

    shown = {
        PICTURE: Format(
            "The surfaces as they are now, without the panels.",
            PICTURES,
            kind,
            lambda path: exporter.save_picture(path, document, known),
        ),
        MOVIE: Format(
            "The flow between two times. Every frame is computed exactly.",
            MOVIES,
            kind,
            lambda path: exporter.save_movie(path, document, known),
        ),
        PAGE: Format(
            "An interactive page (HTML) that any browser shows, without a server. Its surfaces "
            "turn, and the flow plays.",
            (_PAGE_SUFFIX,),
            kind,
            partial(save_result, found),
            found is not None,
        ),
    }
    task = abfm.loading.task_of(found) if found is not None else None
    suffixes = tuple(one for one in outputs.suffixes(task) if one != _PAGE_SUFFIX) if task else ()
    if kind == "sequence":
        suffixes = _SEQUENCE_SUFFIXES
    shown[f"{kind.capitalize()} data"] = of_result(found, kind, suffixes or (".npz",))
    if isinstance(document, PairDocument):
        of_match = outputs.suffixes(abfm.matching.MatchTask)
        shown["Match data"] = of_result(match, "match", of_match)
    if (labels := document.labels) is not None:
        shown["Transferred labels"] = Format(
            "Labels at τ, transferred by the flow (.label.gii, .annot, or a table of keys).",
            (".label.gii", *LABELS),
            "labels",
            lambda path: exporter.save_labels(path, labels, found),
            found is not None,
        )
    for name, table in task.tables.items() if task else ():
        save = partial(exporter.save_table, found=found, name=name)
        shown[f"Table: {name}"] = Format(f"{capital(table.help)}.", TABLES, name, save)
    return shown
