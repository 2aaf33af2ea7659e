"""Reading of documents from project files and result files."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np

import abfm
from abfm import FunctionError
from abfm.types import FloatArray
from abfm_viewer.document.document import (
    SIDES,
    Channel,
    Document,
    InitialMap,
    Landmark,
    RunRecord,
    Surface,
    View,
)
from abfm_viewer.document.frame_sequence import FrameSequence, settings_of
from abfm_viewer.document.kinds import (
    GIVEN_WORD,
    OF_A,
    MatchDocument,
    PairDocument,
    SequenceDocument,
)
from abfm_viewer.document.surface_points import landmarks_of_match, points_of
from abfm_viewer.files.contents import PROJECT
from abfm_viewer.files.project import load_project, terms_from_files

Opened = tuple[Document, dict[str, FloatArray]]
"""A document, and the values (V,) of its functions from files, by `Document.values_key`."""


def read_document(path: Path) -> Opened:
    if path.name.lower().endswith(PROJECT):
        return load_project(path)
    documents: dict[type, Callable[[Any, Path], Opened]] = {
        abfm.Match: document_of_result,
        abfm.Registration: document_of_registration,
        abfm.Sequence: lambda found, path: (document_of_sequence(found, path), {}),
    }
    found = abfm.load(path, *documents)
    return documents[type(found)](found, path)


def document_of_result(
    match: abfm.Match, path: Path
) -> tuple[MatchDocument, dict[str, FloatArray]]:
    """Return a document that shows a match at time tau, and the values of its functions by spec.

    The specs (texts) of functions stay the same if they need no file. Otherwise they refer to the
    result file ``path``.
    """
    known: dict[str, FloatArray] = {}

    def spec(column: str, values: FloatArray, given: str = "") -> str:
        text = given if given and _needs_no_file(given) else _column(path, column)
        known[text] = np.array(values)
        return text

    sources, targets = (
        [spec(f"{side} {i}", *each) for i, each in enumerate(zip(values.T, specs, strict=True))]
        for side, values, specs in zip(
            SIDES, (match.source, match.target), match.problem.specs, strict=True
        )
    )
    weights = match.weights.tolist()
    if not any(weights):  # in matches of landmarks alone
        weights = [1.0] * len(weights)
    document = MatchDocument(
        (Surface(match.mesh, path.name),),
        channels=tuple(map(Channel, sources, targets, weights)),
        landmarks=landmarks_of_match(match),
        landmarks_alone=match.problem.is_of_landmarks,
        parameters=match.parameters,
        mask="" if match.mask is None else spec("mask", match.mask),
        result=match,
        runs=(RunRecord(match.energy_history, match.stages, (), match.residual, path.name),),
        time=match.parameters.tau,
    )
    return document, known


def document_of_registration(found: abfm.Registration, path: Path) -> Opened:
    """Return a document that shows a registration at time tau, and the values of its functions.

    ``path`` is the result file. Functions of A that are known on B alone are transferred back to A
    by the initial map.
    """
    match, initial = found.match, found.initial
    (document, on_b), back = document_of_result(match, path), initial.inverse()
    names = [_column(path, f"source {number}") for number in range(len(document.channels))]
    known = {name: values for name, values in on_b.items() if name not in names}
    functions = back.transfer(match.source) if found.functions is None else found.functions
    for name, values in zip(names, functions.T, strict=True):
        known[f"{OF_A}{name}"] = values
    pair = Surface(initial.a, "A"), Surface(match.mesh, f"B of {path.name}")
    landmarks: tuple[Landmark, ...] = ()
    if (marks := match.problem.landmarks) is not None:
        starts = points_of(back.transfer_points(marks.points(match.mesh)))
        given = zip(starts, document.landmarks, strict=True)
        landmarks = tuple(one.placed("source", start) for start, one in given)
    drafted = {one.name: getattr(document, one.name) for one in fields(document)}
    drafted |= {"surfaces": pair, "landmarks": landmarks, "initial": GIVEN_WORD}
    opened = PairDocument(**drafted)
    request = opened.map_request
    initial_map = InitialMap(initial, request, found.notes, found.functions, found.warnings)
    return replace(opened, initial_map=initial_map), known


def document_of_sequence(sequence: abfm.Sequence, path: Path) -> SequenceDocument:
    """Return a document that shows the sequence of a result file from its start, with tracks."""
    return SequenceDocument(
        (Surface(sequence.mesh, path.name),),
        FrameSequence(path.name, sequence._frames),
        settings=settings_of(sequence),
        result=sequence,
        time=float(sequence.times[0]),
        view=View(tracks=True),
    )


def _column(path: Path, name: str) -> str:
    return str(abfm.functions.ValuesFile(path=str(path.absolute()), column=name))


def _needs_no_file(spec: str) -> bool:
    try:
        return not terms_from_files(spec)
    except FunctionError:  # written by another version
        return False
