"""Rows that carry a subject to the template: the steps of a round besides registrations. They are
in a folder of results of their own, and in no table.
"""

from __future__ import annotations

import os
import shlex
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from abfm.batch import Row
from abfm.errors import ParameterError, ResultError, brief
from abfm.flow.continuous_flow import ContinuousFlow
from abfm.functions import parse
from abfm.io import results
from abfm.io.results import Entry
from abfm.maps.point_maps import PointMap
from abfm.maps.surface_points import SurfacePoints, vertex_points
from abfm.matching.task import facts_of_file
from abfm.mesh import TriangleMesh
from abfm.population.on_template import (
    MapFacts,
    OnTemplate,
    Own,
    carried,
    edge_middles,
    map_facts,
    maps,
)
from abfm.reading import array_from, read_bytes
from abfm.registration import load_registration
from abfm.registration.initial import initial_map, read_landmarks
from abfm.registration.initial.given import Given
from abfm.registration.initial.turned_spheres import LANDMARKS_MIN
from abfm.registration.task import INITIAL, LANDMARKS, ONE_BASED
from abfm.tasks import task as tasks
from abfm.tasks.inputs import MESH_INPUTS, Input, Rename, file_input, function_input, renamed_spec
from abfm.tasks.meshes import mesh_of
from abfm.tasks.monitor import Monitor
from abfm.tasks.preview import Preview
from abfm.tasks.task import Task
from abfm.types import FloatArray
from abfm.workers.control import controlled

FOLDER = "carried"
"""Folder, in that of a population, of what these rows come to."""
_LARGEST_DRIFT = 1 << 32  # bytes of its file
_VALUES = Entry("real", ("P", "C"), low=-results.LARGEST, high=results.LARGEST, may_be_unknown=True)
_CARRIED = results.Kind(
    "file of a subject on a template",
    {
        "before": _VALUES,
        "before_mask": Entry("real", ("P",), low=0),
        "after": _VALUES._replace(required=False),
        "after_mask": Entry("real", ("P",), low=0, required=False),
        "log2_area": Entry("real", ("F",), required=False),
        "verdict": Entry("text", ()),
        # the last one is required: damage to a zip's directory can hide the last entry
        "numbers": Entry("real", (len(MapFacts._fields),), may_be_unknown=True),
    },
)


@dataclass(frozen=True, eq=False)
class Carried:
    """A subject on the template, at P points: by its initial map; and registered, where the row has
    a registration.

    Attributes
    ----------
    before, after : OnTemplate
    log2_area : (F,) array
        Of the faces of the template, where the points are its vertices.
    verdict : str
        Of the registration.
    facts : MapFacts
        What its map does.
    """

    before: OnTemplate
    after: OnTemplate | None = None
    log2_area: FloatArray | None = None
    verdict: str = ""
    facts: MapFacts = MapFacts()

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write a file (``.npz``, no pickles), whole or not at all, or raise ResultError."""
        arrays: dict[str, Any] = {"before": self.before.values, "before_mask": self.before.mask}
        if self.after is not None:
            arrays |= {"after": self.after.values, "after_mask": self.after.mask}
        if self.log2_area is not None:
            arrays["log2_area"] = self.log2_area
        arrays |= {"verdict": np.array(self.verdict), "numbers": np.array(self.facts)}
        results.save_arrays(path, arrays, _CARRIED)


def load_carried(path: str | os.PathLike[str]) -> Carried:
    """Read a file of `Carried.save`; ResultError if it is missing, damaged, or none."""
    arrays = results.load_arrays(path, _CARRIED)
    before, after = (
        OnTemplate(arrays[name], arrays[f"{name}_mask"]) if name in arrays else None
        for name in ("before", "after")
    )
    assert before is not None
    facts = MapFacts(*arrays["numbers"].tolist())
    return Carried(before, after, arrays.get("log2_area"), str(arrays["verdict"]), facts)


def _functions(text: str) -> tuple[str, ...]:
    try:
        texts = tuple(shlex.split(text))
    except ValueError as error:
        raise ParameterError(f"{brief(text)} are no functions in quotes: {error}") from None
    for each in filter(None, texts):
        parse(each)
    return texts


def _renamed_functions(text: str, rename: Rename) -> str:
    return shlex.join(each and renamed_spec(each, rename) for each in _functions(text))


def _first_points(
    surface: TriangleMesh, template: TriangleMesh, given: Mapping[str, Any]
) -> SurfacePoints:
    """Return where on a subject the template's vertices lie by an initial map without functions,
    since none of the template are known yet.
    """
    word, marks = given.get("initial"), None
    if "landmarks" in given:
        marks = read_landmarks(surface, template, given["landmarks"], given.get("one-based", False))
    is_embedded = word is not None and word.partition(":")[0] == "embedding"
    if is_embedded and (marks is None or len(marks) < LANDMARKS_MIN):
        raise ParameterError(
            "an initial map by embedding without the template's functions needs "
            f"{LANDMARKS_MIN} landmarks or more"
        )
    found = initial_map(word, Given(surface, template, landmarks=marks))
    return found.correspondence.points.points


def _registered(own: Own, template: TriangleMesh, given: Mapping[str, Any]) -> Carried:
    drift = array_from(read_bytes(given["drift"], _LARGEST_DRIFT))
    if drift.shape != (len(template.faces), 3):
        raise ResultError("the mean field is of another template; run the same again")
    registration = load_registration(given["registration"])
    shift = ContinuousFlow(template, drift, 1.0).destinations
    before, after = maps(registration, own.mesh, template, shift)
    if given.get("at") == "edges":
        points = edge_middles(template)
        return Carried(carried(before(points), own), carried(after(points), own))
    points = vertex_points(template)
    there = after(points)
    whole = PointMap(template, own.mesh, there.faces, there.barycentric, carried=after)
    log2_area, facts = map_facts(registration, whole, drift)
    return Carried(
        carried(before(points), own),
        carried(there, own),
        log2_area,
        registration.verdict.kind,
        facts,
    )


@dataclass(frozen=True)
class CarryTask(Task):
    """Carry a subject to the template: by an initial map that takes no functions, or by a
    registration and along the mean field, as ``drift`` has it, at vertices or in the middles of
    edges.
    """

    values: Mapping[str, Any]
    key: str

    kind: ClassVar = "carrying"
    needs: ClassVar = ("surface", "template", "functions")
    inputs: ClassVar = (
        file_input("surface", "the subject's mesh"),
        file_input("template", "the template's mesh"),
        *MESH_INPUTS,
        Input(
            name="functions",
            help="of channels, in quotes",
            read=_functions,
            renamed=_renamed_functions,
        ),
        function_input("mask", "weight of each vertex"),
        INITIAL,
        LANDMARKS,
        ONE_BASED,
        file_input("registration", "the subject's registration"),
        file_input("drift", "the mean field"),
        Input(name="at", help="vertices, or edges"),
    )
    result: ClassVar = Carried
    marks: ClassVar = frozenset({"before_mask"})

    @classmethod
    def read(cls, given: tasks.Given) -> CarryTask:
        return cls(given.values(), given.key)

    @property
    def digest(self) -> str:
        return self.key

    def solve(self, monitor: Monitor) -> Carried:
        given = self.values
        with controlled(monitor.control):
            template = mesh_of(given["template"], given)
            surface = mesh_of(given["surface"], given)
            own = Own.of(surface, given["functions"], given.get("mask"))
            if "registration" in given:
                return _registered(own, template, given)
            return Carried(carried(_first_points(own.mesh, template, given), own))

    load = staticmethod(load_carried)
    facts_of_file = staticmethod(facts_of_file)

    @staticmethod
    def preview(path: Path) -> Preview:
        raise ResultError("a carried subject has no picture of its own")

    @staticmethod
    def details(found: Carried) -> dict[str, Any]:
        return {}

    @staticmethod
    def lines(found: Carried) -> list[str]:
        return []


class Carrying(Row):
    """A row that carries a subject to the template."""

    kinds: ClassVar[Mapping[str, type[Task]]] = {CarryTask.kind: CarryTask}
