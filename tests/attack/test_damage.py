"""Small files of every kind, damaged in the same ways: read, or refused in one line."""

import pytest

from abfm import AbfmError
from tests.attack import readers
from tests.attack.specimens import specimens
from tests.attack.victim import put
from tests.core.reading.hostile import one_byte_changed

CHANGES = {"project": 20, "result": 20, "mesh": 30}
"""Number of changes of a file that is slow to read; others have 60."""
OTHER_KINDS = ("spec", "state", "batch")
"""Readers of texts, and of files that are never refused."""
COMPLETE_ENDINGS = (".npy", ".npz", ".abfm", ".glb", "binary.stl", "little.ply", "big.ply")
COMPLETE_ENDINGS += (".annot", ".gii", ".gz", ".sulc", ".mgz", ".stc", ".dscalar.nii", ".mat")
COMPLETE_ENDINGS += ("_0.vtu",)
"""Suffixes of files whose truncation is always detected."""


def changes(content, count):
    """Return contents with one byte changed, half of them near the beginning."""
    places = [*range(0, min(len(content), 128), 128 // (count // 2))]
    places += range(0, len(content), max(len(content) // (count // 2), 1))
    return one_byte_changed(content, places)


@pytest.mark.parametrize(
    "reader", [reader for reader in readers.READERS if reader not in OTHER_KINDS]
)
def test_damaged_files_are_opened_or_refused(reader, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    opened, refused = [], 0
    for name, specimen in specimens().items():
        if specimen.reader != reader:
            continue
        put(specimen, tmp_path / "files")
        path, size = tmp_path / "files" / name, len(specimen.content)
        parts = [specimen.content[: size * tenth // 10] for tenth in range(10)]
        damaged = [*parts, *changes(specimen.content, CHANGES.get(reader, 60))]
        for number, content in enumerate(damaged):
            path.write_bytes(content)
            try:
                readers.read_as(reader, path)
            except AbfmError:
                refused += 1
            else:
                opened += [f"{number} tenths of {name}"] if number < len(parts) else []
    assert refused > 10
    assert [each for each in opened if each.endswith(COMPLETE_ENDINGS)] == []
