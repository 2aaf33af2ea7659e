"""Project files that are known from earlier: whether they are still there, and as they were."""

import os

import pytest

from abfm_viewer.document.document import Document, Surface
from abfm_viewer.files.project import MEMBER, Origin, load_origin, load_project, save_project
from tests.core.reading.hostile import rewrite
from tests.shapes import icosphere

DOCUMENT = Document((Surface(icosphere(0), "sphere"),))


@pytest.fixture
def origin(tmp_path):
    """Of a file whose name is not plain."""
    path = tmp_path / "a prøject.abfm"
    path.write_text("one")
    return Origin.of(path)


def test_a_file_is_unchanged_until_it_is_written_and_none_when_it_is_gone(origin):
    assert (origin.exists, origin.changed) == (True, False)
    state = origin.path.stat()
    origin.path.write_text("two")
    os.utime(origin.path, ns=(state.st_atime_ns, state.st_mtime_ns + 1))
    assert origin.changed
    os.utime(origin.path, ns=(state.st_atime_ns, state.st_mtime_ns))
    assert not origin.changed
    origin.path.write_text("three")
    os.utime(origin.path, ns=(state.st_atime_ns, state.st_mtime_ns))
    assert origin.changed  # its size tells
    origin.path.unlink()
    assert (origin.exists, origin.changed) == (False, False)


def test_a_copy_says_of_which_file_it_is_as_long_as_that_is_there(origin, tmp_path):
    copy = tmp_path / "copy.abfm"
    save_project(copy, DOCUMENT, {}, origin)
    assert load_origin(copy) == origin
    origin.path.unlink()
    assert load_origin(copy) is None


def test_other_files_are_copies_of_nothing(tmp_path):
    path = tmp_path / "a.abfm"
    assert load_origin(path) is None
    path.write_text("no zip")
    assert load_origin(path) is None
    save_project(path, DOCUMENT, {})
    assert load_origin(path) is None


@pytest.mark.parametrize(
    "text",
    [
        *("[]", "{", "[" * 100_000, "1" * 5000, '"\\ud800"'),
        '{"path": 1, "modified": 2, "size": 3}',
        '{"path": "\\u0000", "modified": 2, "size": 3}',
        '{"path": "/", "modified": 1e999, "size": 0}',
    ],
)
def test_copies_may_say_anything_of_their_origin(tmp_path, text):
    path = tmp_path / "p.abfm"
    save_project(path, DOCUMENT, {}, Origin.of(tmp_path / "q.abfm"))
    rewrite(path, {MEMBER: text.encode()})
    assert load_origin(path) is None
    assert load_project(path)[0].name == "sphere"
