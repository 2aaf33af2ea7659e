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
    """Settings of random problems and of their matches.

    Attributes
    ----------
    meshes : dict
        Meshes by name; problems depend on the name.
    seed, count : int
        Seed of random numbers, and number of problems on each mesh.
    folder : path, optional
        Folder of results, which later runs reuse; None for a temporary folder.
    cluster : Cluster
        The processes or cluster that solve the matches.
    control : Control
        Cancels the run; the report then has the finished problems.
    """

    meshes: Mapping[str, TriangleMesh]
    log: Log = lambda line: None
    seed: int = 0
    count: int = 6
    folder: Path | None = None
    cluster: Cluster = Cluster(jobs=1)
    control: Control = field(default_factory=Control)

    def report(self, rows: list[Report], **settings: Any) -> Report:
        sizes = {name: len(mesh.vertices) for name, mesh in self.meshes.items()}
        return {
            "rows": rows,
            "interrupted": self.control.cancelled,
            "settings": {"seed": self.seed, "count": self.count, "meshes": sizes, **settings},
            "machine": machine(),
        }


@dataclass(frozen=True, eq=False)
class MeasuredProblem:
    """The matches of a problem by name, and a function that measures their results."""

    matches: Mapping[str, batch.Row]
    measure: Callable[[Mapping[str, LedgerEntry]], Report]


def measured(
    trials: Trials,
    create: Callable[[Path], Iterator[MeasuredProblem]],
    line: Callable[[Report], str],
) -> list[Report]:
    """Solve problems in the folder of ``trials``; return the measurements of the finished ones.

    No time limit ends a match, so that all numbers except seconds are the same in every run.

    Parameters
    ----------
    create : function
        Function that takes a folder, writes the files of the problems there and yields them.
    line : function
        Function that takes the measurement of a problem and returns a line, which is printed.
    """
    with temporary_folder() if trials.folder is None else nullcontext(trials.folder) as folder:
        trials.log("preparing problems")
        problems = [*takewhile(lambda _: not trials.control.cancelled, create(folder))]
        found, entries = dict[int, Report](), dict[str, LedgerEntry]()

        def note(entry: LedgerEntry) -> None:
            entries[entry.row.key] = entry
            for number, problem in enumerate(problems):
                keys = {name: row.key for name, row in problem.matches.items()}
                if number not in found and entries.keys() >= set(keys.values()):
                    matched = {name: entries[key] for name, key in keys.items()}
                    found[number] = problem.measure(matched)
                    trials.log(f"{len(found)}/{len(problems)} {line(found[number])}")

        rows = [row for problem in problems for row in problem.matches.values()]
        for entry in batch.Ledger(folder).entries(rows):
            if entry.state == "done" and not trials.control.cancelled:
                note(entry)
        batch.run(rows, folder, trials.cluster, on_change=note, control=trials.control)
        return [found[number] for number in sorted(found)]
