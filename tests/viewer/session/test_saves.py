"""What is in a file, and what is not."""

from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest

from abfm_viewer.document.document import Identity, Point
from abfm_viewer.files.documents import document_of_sequence
from abfm_viewer.session.saving.exporter import Exporter
from tests.core.sequences.rotating_sphere import solved


@pytest.fixture
def film(session):
    """A session with a film whose fields are in no file."""
    found = document_of_sequence(solved(), Path("film.npz"))
    session.restore(replace(found, result=None), {}, None)
    session.reset_history()
    session.editor.change("match all frames", result=found.result)
    assert session.saves.changes(session.document) == ("result",)
    return session


def exported(film, path):
    """Write a sequence as the tab Export does."""
    told = []
    exporter = Exporter(lambda text, failed: told.append((text, failed)))
    document, saves = film.document, film.saves
    exporter.save_result(path, document.result, partial(saves.record_export, document))
    exporter.wait()
    assert told == [(f"saved {path}", False)]


def test_a_sequence_in_its_own_file_is_saved(film, tmp_path):
    """Other files hold less."""
    exported(film, tmp_path / "film-lh.stc")
    assert film.saves.unsaved
    exported(film, tmp_path / "film.npz")
    assert not film.saves.unsaved
    assert film.saves.unsaved_documents == ()
    film.restore(replace(film.document, identity=Identity()), {}, None)
    assert film.saves.unsaved_documents == ()


def test_what_a_file_of_a_sequence_does_not_hold_is_unsaved(film, tmp_path):
    exported(film, tmp_path / "film.npz")
    film.editor.set_sequence_settings(gamma=3.0)
    assert film.saves.changes(film.document) == ("settings",)
    film.saves.record_export(film.document)  # whose file has the settings of its fields
    assert film.saves.changes(film.document) == ("settings",)
    film.undo()
    film.editor.add_point("lines", Point(0, (1.0, 0.0, 0.0)))
    assert film.saves.changes(film.document) == ("lines",)


def test_a_recovered_film_is_saved_by_a_file_of_its_sequence(film, tmp_path):
    film.restore(replace(film.document, identity=Identity()), {}, None, saved=False)
    assert film.saves.unsaved
    exported(film, tmp_path / "film.npz")
    assert not film.saves.unsaved
