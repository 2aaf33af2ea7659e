"""Small files of every kind, damaged in the same ways: opened, or refused in one line."""

import pytest

from abfm import AbfmError
from tests.attack import doors
from tests.attack.specimens import specimens
from tests.attack.victim import put
from tests.core.reading.hostile import one_byte_changed

CHANGES = {"project": 20, "result": 20, "mesh": 30}
"""The number of changes of a file where opening one takes long; 60 of others."""
OTHERS = ("spec", "state", "batch")
"""Doors of texts, and of what is never refused."""
WHOLE_ENDINGS = (".npy", ".npz", ".abfm", ".glb", "binary.stl", "little.ply", "big.ply", ".annot")
WHOLE_ENDINGS += (".gii", ".gz", ".sulc", ".mgz", ".stc", ".dscalar.nii", ".mat", "_0.vtu")
"""Files whose parts are told apart from complete ones."""


def changes(content, count):
    """Return contents with one byte changed, half of them near the beginning."""
    places = [*range(0, min(len(content), 128), 128 // (count // 2))]
    places += range(0, len(content), max(len(content) // (count // 2), 1))
    return one_byte_changed(content, places)


@pytest.mark.parametrize("door", [door for door in doors.DOORS if door not in OTHERS])
def test_damaged_files_are_opened_or_refused(door, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    opened, refused = [], 0
    for name, whole in specimens().items():
        if whole.door != door:
            continue
        put(whole, tmp_path / "files")
        path, size = tmp_path / "files" / name, len(whole.content)
        parts = [whole.content[: size * tenth // 10] for tenth in range(10)]
        for number, content in enumerate([*parts, *changes(whole.content, CHANGES.get(door, 60))]):
            path.write_bytes(content)
            try:
                doors.enter(door, path)
            except AbfmError:
                refused += 1
            else:
                opened += [f"{number} tenths of {name}"] if number < len(parts) else []
    assert refused > 10
    assert [each for each in opened if each.endswith(WHOLE_ENDINGS)] == []
