"""Killed while saving: the old file or the new one is there, whole, and nothing else once somebody
writes again.

What is saved is prepared once; for every kill the process forks a child that saves it over and
over, and kills that at a random moment. POSIX only.
"""

from __future__ import annotations

import json
import os
import random
import signal
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

import abfm
from abfm import AbfmError, Match, load_match, load_mesh
from abfm_viewer.document.document import Document
from abfm_viewer.files import outputs
from abfm_viewer.files.autosave import Autosave
from abfm_viewer.files.project import load_project, save_project
from abfm_viewer.files.state_folder import StateFolder
from abfm_viewer.pictures import write_movie
from abfm_viewer.session.session_files import document_of_result
from tests.attack.trial import Trial, run
from tests.shapes import icosphere

_LONGEST = 0.03  # seconds that a child saves


@dataclass
class Outcome:
    """One kill: what was being saved, when it came, and what was wrong with what it left."""

    what: str
    after: float
    left: int = 0  # temporary files, which the next to write removed
    faults: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class Saving:
    """A way to save one of two versions, and to tell which one a file is."""

    suffix: str
    save: Callable[[Path, int], None]
    version: Callable[[Path], int]  # AbfmError or ValueError if it is neither


class Attack:
    """Kills processes that save in a folder."""

    def __init__(self, folder: Path, random: random.Random) -> None:
        self._folder, self.random = folder, random
        self._matches = [_match(version) for version in range(2)]
        self._documents = [
            document_of_result(match, folder / "m.npz")[0] for match in self._matches
        ]
        self.savings = {
            "result": Saving(
                ".npz", self._save_result, lambda path: len(load_match(path).energy_history)
            ),
            "project": Saving(".abfm", self._save_project, _project_version),
            "autosave": Saving(".abfm", self._autosave, _project_version),
            "ply": Saving(".ply", self._export, _ply_version),
            "vtu": Saving(".vtu", self._export, _vtu_version),
            "csv": Saving(".csv", self._export, lambda path: len(path.read_text().splitlines())),
            "recent": Saving(
                ".json", self._save_recent, lambda path: len(json.loads(path.read_text()))
            ),
            "mp4": Saving(".mp4", _save_movie, lambda path: _frames(path)),
            "gif": Saving(".gif", _save_movie, lambda path: _frames(path)),
        }

    def one(self, what: str) -> Outcome:
        """Kill a process that saves this, and look at what is left."""
        saving, outcome = self.savings[what], Outcome(what, _LONGEST * self.random.random())
        with tempfile.TemporaryDirectory(dir=self._folder) as place:
            tempfile.tempdir = place
            path = Path(
                place, f"recent{saving.suffix}" if what == "recent" else f"saved{saving.suffix}"
            )
            versions = []
            for version in range(2):
                saving.save(path, version)
                versions.append(saving.version(path))
            child = os.fork()
            if not child:
                self._save_for_ever(saving, path)
            time.sleep(outcome.after)
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)
            outcome.left = len(list(Path(place).iterdir())) - 1
            self._judge(saving, path, versions, outcome)
            tempfile.tempdir = None
        return outcome

    def _save_for_ever(self, saving: Saving, path: Path) -> None:
        try:
            while True:
                for version in range(2):
                    saving.save(path, version)
        finally:
            os._exit(1)

    def _judge(self, saving: Saving, path: Path, versions: list[int], outcome: Outcome) -> None:
        try:
            if saving.version(path) not in versions:
                outcome.faults.append("the file is another one")
        except (AbfmError, ValueError, OSError) as error:
            outcome.faults.append(f"the file is broken: {error}"[:200])
        saving.save(path, 0)
        outcome.faults += [f"{left.name} is left" for left in path.parent.iterdir() if left != path]

    def _save_result(self, path: Path, version: int) -> None:
        self._matches[version].save(path)

    def _save_project(self, path: Path, version: int) -> None:
        save_project(path, self._documents[version], {})

    def _autosave(self, path: Path, version: int) -> None:
        copies = Autosave(StateFolder(path.parent), seconds=0, clock=lambda: 1.0)
        copies.path = path
        copies.offer(self._documents[version], lambda: (self._documents[version], {}), unsaved=True)
        copies.close()

    def _export(self, path: Path, version: int) -> None:
        outputs.write(path, self._matches[version])

    def _save_recent(self, path: Path, version: int) -> None:
        folder = StateFolder(path.parent)
        folder.add_recent(path) if version else folder.clear_recent()


def _match(version: int) -> Match:
    """Two results, which differ in how many iterations they took."""
    mesh = icosphere(2)
    f, g, _ = mesh.vertices.T
    return abfm.match(mesh, f, g, abfm.Parameters(iterations=2 + 2 * version, levels=1))


def _project_version(path: Path) -> int:
    document: Document = load_project(path)[0]
    assert document.result is not None
    return len(document.result.energy_history)


def _ply_version(path: Path) -> int:
    return len(load_mesh(path).vertices) + path.stat().st_size


def _vtu_version(path: Path) -> int:
    if not path.read_bytes().rstrip().endswith(b"</VTKFile>"):
        raise ValueError("it is cut short")
    return path.stat().st_size


def _save_movie(path: Path, version: int) -> None:
    frames = np.random.default_rng(version).integers(
        0, 255, (2 + version, 32, 32, 3), dtype=np.uint8
    )
    write_movie(path, frames, 25.0, len(frames))


def _frames(path: Path) -> int:
    import av

    with av.open(str(path)) as movie:
        return sum(1 for _ in movie.decode(video=0))


def main() -> None:
    """Kill, a line of JSON each."""
    with tempfile.TemporaryDirectory() as folder:
        attack = Attack(Path(folder), random.Random())

        def attempt(seed: int) -> Trial:
            chosen = attack.random = random.Random(seed)
            outcome = attack.one(chosen.choice(list(attack.savings)))
            kind = f"{outcome.what} after {outcome.after:.3f} s"
            return Trial(kind, seed, "fault" if outcome.faults else "ok", "; ".join(outcome.faults))

        run(attempt, __doc__)


if __name__ == "__main__":
    main()
