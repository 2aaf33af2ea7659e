"""Problems of a measurement as rows of a batch: matched by whoever, kept, and told as they come."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from time import perf_counter
from typing import Any

from abfm import Control, batch
from abfm.batch import Cluster, Entry
from abfm.io import temporary_folder

Row = dict[str, Any]
"""What a report says of a problem: numbers, text, lists and dictionaries."""
Tell = Callable[[str], None]

_SAID_EVERY = 5.0  # seconds


@dataclass(frozen=True)
class Place:
    """Where problems are matched, by whom, and how to end that early; without a folder nothing is
    kept.
    """

    folder: Path | None = None
    cluster: Cluster = Cluster(jobs=1)
    control: Control = field(default_factory=Control)


@dataclass(frozen=True, eq=False)
class Posed:
    """A problem: the matches that it asks for, by name, and what is made of them."""

    matches: Mapping[str, batch.Row]
    judge: Callable[[Mapping[str, Entry]], Row]


def by_batch(
    pose: Callable[[Path], Iterator[Posed]], line: Callable[[Row], str], tell: Tell, place: Place
) -> list[Row]:
    """Pose problems in a folder, match all, and return the rows of those that were finished, in
    their order; each is told in a line as it comes.

    Matches go on to their end, so that what comes is the same whatever else runs, but for seconds;
    what the folder has of an earlier run is not matched again.
    """
    own = temporary_folder()
    with own if place.folder is None else nullcontext(place.folder) as folder:
        posed, said = list[Posed](), 0.0
        for problem in pose(folder):
            if place.control.cancelled:
                break
            posed.append(problem)
            if perf_counter() - said > _SAID_EVERY:
                said = perf_counter()
                tell(f"stating problems: {len(posed)}")
        return _solved(posed, line, tell, folder, place)


def _solved(
    posed: list[Posed], line: Callable[[Row], str], tell: Tell, folder: Path, place: Place
) -> list[Row]:
    found, came = dict[int, Row](), dict[str, Entry]()

    def note(entry: Entry) -> None:
        came[entry.row.key] = entry
        for number, problem in enumerate(posed):
            keys = {name: row.key for name, row in problem.matches.items()}
            if number not in found and came.keys() >= set(keys.values()):
                found[number] = problem.judge({name: came[key] for name, key in keys.items()})
                tell(f"{len(found)}/{len(posed)} {line(found[number])}")

    rows = [row for problem in posed for row in problem.matches.values()]
    for entry in batch.Ledger(folder).entries(rows):
        if entry.state == "done" and not place.control.cancelled:
            note(entry)
    batch.run(rows, folder, place.cluster, on_change=note, control=place.control)
    return [found[number] for number in sorted(found)]
