"""Killed while saving: the old file or the new one is there, whole, and nothing else once somebody
writes again.

What is saved is prepared once; for every kill the process forks a child that saves it over and
over, and kills that at a random moment. POSIX only.
"""

import json
import os
import random
import signal
import tempfile
import time
from pathlib import Path

import av
import numpy as np

import abfm
from abfm import AbfmError, load_match, load_mesh
from abfm_viewer.files import outputs
from abfm_viewer.files.autosave import Autosave
from abfm_viewer.files.project import load_project, save_project
from abfm_viewer.files.state_folder import StateFolder
from abfm_viewer.pictures import write_movie
from abfm_viewer.session.session_files import document_of_result
from tests.attack.trial import Trial, run
from tests.shapes import icosphere

_LONGEST = 0.03  # seconds that a child saves


class Attack:
    """Kills processes that save in a folder one of two versions again and again."""

    def __init__(self, folder):
        self._folder = folder
        self._matches = [_match(version) for version in range(2)]
        self._documents = [
            document_of_result(match, folder / "m.npz")[0] for match in self._matches
        ]
        self.savings = {  # suffix; saves a version; tells which one a file is, or raises an error
            "result": (".npz", self._save_result, _result_version),
            "project": (".abfm", self._save_project, _project_version),
            "autosave": (".abfm", self._autosave, _project_version),
            "ply": (".ply", self._export, _ply_version),
            "vtu": (".vtu", self._export, _vtu_version),
            "csv": (".csv", self._export, lambda path: len(path.read_text().splitlines())),
            "recent": (".json", _save_recent, lambda path: len(json.loads(path.read_text()))),
            "mp4": (".mp4", _save_movie, _frames),
            "gif": (".gif", _save_movie, _frames),
        }

    def one(self, what, chance):
        """Kill what saves this: after which time, temporary files that it left, what is wrong."""
        (suffix, save, version_of), after = self.savings[what], _LONGEST * chance.random()
        with tempfile.TemporaryDirectory(dir=self._folder) as place:
            tempfile.tempdir = place
            path = Path(place, f"{'recent' if what == 'recent' else 'saved'}{suffix}")
            versions = []
            for version in range(2):
                save(path, version)
                versions.append(version_of(path))
            child = os.fork()
            if not child:
                try:
                    while True:
                        for version in range(2):
                            save(path, version)
                finally:
                    os._exit(1)
            time.sleep(after)
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)
            left, faults = len(list(Path(place).iterdir())) - 1, []
            try:
                if version_of(path) not in versions:
                    faults.append("the file is another one")
            except (AbfmError, ValueError, OSError) as error:
                faults.append(f"the file is broken: {error}"[:200])
            save(path, 0)
            faults += [f"{left.name} is left" for left in path.parent.iterdir() if left != path]
            tempfile.tempdir = None
        return after, left, faults

    def attempt(self, seed):
        """The trial of a seed."""
        chance = random.Random(seed)
        what = chance.choice(list(self.savings))
        after, _, faults = self.one(what, chance)
        kind = f"{what} after {after:.3f} s"
        return Trial(kind, seed, "fault" if faults else "ok", "; ".join(faults))

    def _save_result(self, path, version):
        self._matches[version].save(path)

    def _save_project(self, path, version):
        save_project(path, self._documents[version], {})

    def _autosave(self, path, version):
        copies = Autosave(StateFolder(path.parent), seconds=0, clock=lambda: 1.0)
        copies.path = path
        copies.offer(self._documents[version], lambda: (self._documents[version], {}), unsaved=True)
        copies.close()

    def _export(self, path, version):
        outputs.write(path, self._matches[version])


def _match(version):
    """Two results, which differ in how many iterations they took."""
    mesh = icosphere(2)
    f, g, _ = mesh.vertices.T
    return abfm.match(mesh, f, g, abfm.Parameters(iterations=2 + 2 * version, levels=1))


def _result_version(path):
    return len(load_match(path).energy_history)


def _project_version(path):
    return len(load_project(path)[0].result.energy_history)


def _ply_version(path):
    return len(load_mesh(path).vertices) + path.stat().st_size


def _vtu_version(path):
    if not path.read_bytes().rstrip().endswith(b"</VTKFile>"):
        raise ValueError("it is cut short")
    return path.stat().st_size


def _save_recent(path, version):
    folder = StateFolder(path.parent)
    folder.add_recent(path) if version else folder.clear_recent()


def _save_movie(path, version):
    shape, random = (2 + version, 32, 32, 3), np.random.default_rng(version)
    write_movie(path, random.integers(0, 255, shape, dtype=np.uint8), 25.0, 2 + version)


def _frames(path):
    with av.open(str(path)) as movie:
        return sum(1 for _ in movie.decode(video=0))


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        run(Attack(Path(folder)).attempt, __doc__)
