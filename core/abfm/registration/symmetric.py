"""Symmetric registration: the mean of the registrations of A to B and of B to A."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from abfm.errors import ParameterError, brief
from abfm.io import results
from abfm.io.results import Entry, FileKind
from abfm.maps.point_maps import PointMap
from abfm.outcome import Facts, Outcome
from abfm.registration import report
from abfm.registration.correspondence import Correspondence, correspondence_of
from abfm.registration.registration import Registration
from abfm.registration.task import RegistrationTask
from abfm.tasks.monitor import Monitor
from abfm.tasks.task import Preview, Report, ResultFile, Task, TaskInputs
from abfm.types import File, FloatArray
from abfm.wording import share
from abfm.workers.progress import phase

SYMMETRIC_KIND = FileKind(
    "symmetric registration file",
    {
        **results.CORRESPONDENCE.entries,
        "asymmetry": Entry("real", ("V",), low=0),
        "facts": Entry("text", ()),
    },
)
_EXPECTED_METHOD = "expected a method without files, such as auto or closest"
_DESCRIPTION = """\
Register surface A to surface B and B to A, and average both maps. The result does not depend on
which surface comes first. Its asymmetry, the distance between the two images of a vertex, shows
where the map can be trusted.

Example:
  abfm symmetric lh.sphere fsaverage.sphere.surf.gii --source lh.sulc --target avg.gii \\
      --out mean.npz

Options and exit status are those of `abfm register`; the worse direction decides the status.
"""


class SymmetricRegistration(Correspondence):
    """The mean of a registration of A to B and one of B to A.

    If both registrations map a vertex to different points, the mean map uses their midpoint in
    space, projected to the closest point of the surface. ``points`` and ``back`` are the mean maps
    from B to A, and from A to B. ``asymmetry`` (V_B,) is the distance in space between both images
    of each vertex of B, in sqrt(area) of A. ``facts`` are those of the registration with the worse
    outcome.
    """

    def __init__(
        self, points: PointMap, back: PointMap, asymmetry: FloatArray, facts: Facts
    ) -> None:
        super().__init__(points, back)
        self.asymmetry, self.facts = asymmetry, facts

    @classmethod
    def average(cls, forward: Registration, backward: Registration) -> SymmetricRegistration:
        offsets = forward.points.positions - backward.back.positions
        asymmetry = np.linalg.norm(offsets, axis=1) / forward.a.length_scale
        facts = max((forward.facts, backward.facts), key=lambda each: each.outcome.rank)
        median, p95 = np.percentile(asymmetry, (50, 95)).tolist()
        numbers = {**facts.numbers, "asymmetry_median": median, "asymmetry_95": p95}
        agreement = f"within {share(p95)} of sqrt(area) at 95% of the vertices"
        headline = f"{facts.headline}, both directions agree {agreement}"
        facts = replace(facts, headline=headline, short_headline=headline, numbers=numbers)
        points = _mean(forward.points, backward.back)
        return cls(points, _mean(forward.back, backward.points), np.asarray(asymmetry), facts)

    def arrays(self) -> dict[str, Any]:
        """Return the arrays that `save` writes: both meshes, both maps, asymmetry and facts."""
        facts = asdict(self.facts)
        del facts["short_headline"]
        text = np.array(json.dumps(facts))
        return super().arrays() | {"asymmetry": self.asymmetry, "facts": text}

    def save(self, path: File) -> None:
        """Write a ``.npz`` file without pickles, completely or not at all, or raise ResultError."""
        results.save_arrays(path, self.arrays(), SYMMETRIC_KIND)

    def save_parts(self, path: str | os.PathLike[str]) -> tuple[str, ...]:
        """Write the same file as `save`, which has no parts to omit."""
        self.save(path)
        return ()

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.points, self.back, self.asymmetry, self.facts)


def _mean(first: PointMap, second: PointMap) -> PointMap:
    middle = (first.positions + second.positions) / 2
    return PointMap.project(first.domain, first.codomain, middle)


def load_symmetric(path: File) -> SymmetricRegistration:
    """Read a file that `SymmetricRegistration.save` wrote; ResultError if missing or damaged."""

    def made(arrays: dict[str, Any]) -> SymmetricRegistration:
        found = correspondence_of(arrays)
        facts = _facts(str(arrays["facts"]))
        return SymmetricRegistration(found.points, found.back, arrays["asymmetry"], facts)

    return results.loaded(path, SYMMETRIC_KIND, made)


def _facts(text: str) -> Facts:
    values = json.loads(text)
    values |= {name: tuple(values[name]) for name in ("warnings", "topics")}
    values["outcome"] = Outcome(values["outcome"])
    return Facts(**values)


def _facts_of_file(path: Path) -> Facts:
    with results.open_archive(path, SYMMETRIC_KIND.name, results.REMEDY) as archive:
        text = SYMMETRIC_KIND.entries["facts"].check("facts", archive["facts"], {})
    return _facts(str(text))


def _preview(path: Path) -> Preview:
    found = load_symmetric(path)
    return Preview(found.b, [found.asymmetry])


def _details(found: SymmetricRegistration) -> dict[str, Any]:
    facts = found.facts
    verdict = {"kind": facts.outcome, "reason": facts.reason, "advice": facts.advice}
    head = {**facts.numbers, "headline": facts.headline, "warnings": list(facts.warnings)}
    return {**head, "verdict": verdict, "map": report.map_details(found)}


def _lines(found: SymmetricRegistration) -> list[str]:
    return [*found.facts.lines, *report.map_lines(found)]


@dataclass(frozen=True)
class SymmetricTask(Task):
    """Task of registering A to B and B to A, and of averaging both maps."""

    forward: RegistrationTask
    backward: RegistrationTask
    key: str  # name of the result

    kind: ClassVar = "symmetric"
    summary: ClassVar = "register two surfaces in both directions and average the maps"
    description: ClassVar = _DESCRIPTION
    details: ClassVar = RegistrationTask.details
    main_options: ClassVar = RegistrationTask.main_options
    output_help: ClassVar = (
        "symmetric registration (.npz); faces of A on B (.gii, .ply); vertices of A for those of "
        "B (.txt, .csv, .npy); or page (.html)"
    )
    needs: ClassVar = RegistrationTask.needs
    inputs: ClassVar = RegistrationTask.inputs
    exports: ClassVar = RegistrationTask.exports
    result: ClassVar = SymmetricRegistration
    file: ClassVar = ResultFile(
        frozenset({"a_vertices", "asymmetry"}), load_symmetric, _facts_of_file, _preview
    )
    report: ClassVar = Report(_details, _lines)
    preview_labels: ClassVar = ("asymmetry",)

    @classmethod
    def check(cls, values: Mapping[str, Any]) -> None:
        """Check the values as `RegistrationTask` does, and refuse an initial map from a file."""
        RegistrationTask.check(values)
        initial = values.get("initial", "")
        if initial.startswith("file:") or initial.count(","):
            raise ParameterError(
                f"column initial: {brief(initial)} gives a map in one direction only; "
                f"{_EXPECTED_METHOD}"
            )

    @classmethod
    def read(cls, given: TaskInputs) -> SymmetricTask:
        forward = RegistrationTask.read(given)
        options = dict(forward.options)
        options["f"], options["g"] = options["g"], options["f"]
        options["mask_a"], options["mask_b"] = options["mask_b"], options["mask_a"]
        if (pairs := options["landmarks"]) is not None:
            options["landmarks"] = replace(pairs, a=pairs.b, b=pairs.a)
        backward = replace(forward, a=forward.b, b=forward.a, options=options)
        return cls(forward, backward, forward.key)

    def solve(self, monitor: Monitor) -> SymmetricRegistration:
        with phase("A to B", repeats=1):
            forward = self.forward.solve(monitor)
        with phase("B to A"):
            backward = self.backward.solve(monitor)
        return SymmetricRegistration.average(forward, backward)

    def notes(self) -> list[str]:
        return self.forward.notes()
