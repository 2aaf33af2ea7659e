"""Documents of files: meshes, projects and results, told apart by their suffix."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import abfm
from abfm import load_mesh
from abfm.mesh.files import READERS
from abfm.types import FloatArray
from abfm_viewer.document.document import Channel, Document, Run, Surface
from abfm_viewer.files.origin import Origin
from abfm_viewer.files.project import load_project
from abfm_viewer.session.session import Session

MESHES = tuple(READERS)
PROJECT, RESULT = ".abfm", ".npz"
Opened = tuple[Document, dict[str, FloatArray]]
"""A document, and the values of its functions from files (see `Functions`)."""


def open_session(path: Path, largest_component: bool = False) -> Session:
    """A session that begins with a file, read now; AbfmError if it cannot be read."""
    if not path.name.lower().endswith((PROJECT, RESULT)):
        return Session(load_mesh(path, largest_component=largest_component), path.name)
    origin = Origin.of(path.absolute()) if is_project(path) else None
    document, known = read_document(path)
    session = Session(document.surface().mesh, document.name)
    session.restore(document, known, origin)
    session.reset_history()
    return session


def is_project(path: Path) -> bool:
    """Return whether a file is a project, by its name."""
    return path.name.lower().endswith(PROJECT)


def read_document(path: Path) -> Opened:
    """Read a project file, or make a document that shows the result in a file."""
    if is_project(path):
        return load_project(path)
    return document_of_result(abfm.load_match(path), path)


def document_of_result(match: abfm.Match, path: Path) -> Opened:
    """A document that shows a result at tau; its functions are named by the result's file."""
    known: dict[str, FloatArray] = {}

    def spec(column: str, values: FloatArray) -> str:
        text = str(abfm.functions.ValuesFile(path=str(path.absolute()), column=column))
        known[text] = np.array(values)
        return text

    sources = [spec(f"source {i}", values) for i, values in enumerate(match.source.T)]
    targets = [spec(f"target {i}", values) for i, values in enumerate(match.target.T)]
    channels = tuple(map(Channel, sources, targets, match.weights.tolist()))
    document = Document(
        (Surface(match.mesh, path.name),),
        channels=channels,
        parameters=match.parameters,
        mask="" if match.mask is None else spec("mask", match.mask),
        result=match,
        runs=(Run(match.energy_history, match.stages, (), match.mismatch, path.name),),
        time=match.parameters.tau,
    )
    return document, known
