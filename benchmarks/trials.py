"""Random problems that are matched as rows of a batch, and the report about them."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import nullcontext
from dataclasses import dataclass, field
from itertools import takewhile
from pathlib import Path
from typing import Any

from abfm import TriangleMesh, batch
from abfm.batch import Cluster, LedgerEntry
from abfm.io import temporary_folder
from abfm.workers import Control
from benchmarks.common import Log, Report, machine


@dataclass(frozen=True)
class Trials:
    """Which problems are matched, where, and how.

    Attributes
    ----------
    meshes : dict
        By name, on which problems depend.
    seed, count : int
        Of random numbers, and of problems on each mesh.
    folder : path, optional
        For results, which later runs reuse; None for a temporary one.
    cluster : Cluster
        The processes that match.
    control : Control
        Ends the run early: the report then has the finished problems.
    """

    meshes: Mapping[str, TriangleMesh]
    log: Log = lambda line: None
    seed: int = 0
    count: int = 6
    folder: Path | None = None
    cluster: Cluster = Cluster(jobs=1)
    control: Control = field(default_factory=Control)

    def report(self, rows: list[Report], **settings: Any) -> Report:
        """Return the report of all rows with what identifies the problems and the machine."""
        sizes = {name: len(mesh.vertices) for name, mesh in self.meshes.items()}
        return {
            "rows": rows,
            "interrupted": self.control.cancelled,
            "settings": {"seed": self.seed, "count": self.count, "meshes": sizes, **settings},
            "machine": machine(),
        }


@dataclass(frozen=True, eq=False)
class Posed:
    """A problem: the matches that it needs, by name, and what is measured of them."""

    matches: Mapping[str, batch.Row]
    measure: Callable[[Mapping[str, LedgerEntry]], Report]


def measured(
    trials: Trials, pose: Callable[[Path], Iterator[Posed]], line: Callable[[Report], str]
) -> list[Report]:
    """Pose problems in a folder, match them, and return the measurements of finished ones in order.

    Each is printed as a line when it is finished. Matches are not ended by a clock, so all numbers
    except seconds are the same in every run.
    """
    with temporary_folder() if trials.folder is None else nullcontext(trials.folder) as folder:
        trials.log("stating problems")
        posed = [*takewhile(lambda _: not trials.control.cancelled, pose(folder))]
        found, entries = dict[int, Report](), dict[str, LedgerEntry]()

        def note(entry: LedgerEntry) -> None:
            entries[entry.row.key] = entry
            for number, problem in enumerate(posed):
                keys = {name: row.key for name, row in problem.matches.items()}
                if number not in found and entries.keys() >= set(keys.values()):
                    own = {name: entries[key] for name, key in keys.items()}
                    found[number] = problem.measure(own)
                    trials.log(f"{len(found)}/{len(posed)} {line(found[number])}")

        rows = [row for problem in posed for row in problem.matches.values()]
        for entry in batch.Ledger(folder).entries(rows):
            if entry.state == "done" and not trials.control.cancelled:
                note(entry)
        batch.run(rows, folder, trials.cluster, on_change=note, control=trials.control)
        return [found[number] for number in sorted(found)]
