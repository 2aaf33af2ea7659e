"""Carry subjects to the template: the computations of a round besides registrations. They write no
files.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

from abfm.batch.rows import files_renamed
from abfm.errors import ParameterError, ResultError
from abfm.flow.continuous_flow import ContinuousFlow
from abfm.maps.point_maps import PointMap
from abfm.maps.surface_points import SurfacePoints, vertex_points
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
from abfm.population.subjects import Subject
from abfm.reading import array_from, read_bytes
from abfm.registration import load_registration
from abfm.registration.initial import initial_map, read_landmarks
from abfm.registration.initial.map_input import MapInput
from abfm.registration.initial.sphere_maps import LANDMARKS_MIN
from abfm.registration.task import INITIAL_INPUT
from abfm.tasks.inputs import Rename, renamed_spec
from abfm.tasks.meshes import mesh_of
from abfm.types import FloatArray

_DRIFT_BYTES_MAX = 1 << 32


class Carried(NamedTuple):
    """A subject on the template, at P points: by its initial map; and registered, if it is.

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


@dataclass(frozen=True)
class Carrying:
    """A subject that is carried to the template: by an initial map that takes no functions, or by a
    registration and along the mean field, at vertices or in the middles of edges.

    Attributes
    ----------
    subject : Subject
    template : str
        Its file.
    options : mapping
        Of reading both meshes, as `abfm.tasks.inputs.MESH_INPUTS` has them.
    initial : str
        The word of the initial map; empty for one that is chosen.
    one_based : bool
        Whether landmarks count vertices from 1.
    registration, drift : str
        The files of the registration and of the mean field; empty for an initial map.
    at_edges : bool
    """

    subject: Subject
    template: str
    options: Mapping[str, Any] = field(default_factory=dict)
    initial: str = ""
    one_based: bool = False
    registration: str = ""
    drift: str = ""
    at_edges: bool = False

    def files(self) -> list[str]:
        """Return the absolute names of the files that it reads."""
        return files_renamed(self.renamed)

    def moved(self, places: Mapping[str, str]) -> Carrying:
        """Return the same with files elsewhere."""
        return self.renamed(lambda path: places.get(path, path))

    def computed(self) -> Carried:
        """Carry it."""
        template = mesh_of(self.template, self.options)
        surface = mesh_of(self.subject.surface or self.template, self.options)
        own = Own.of(surface, self.subject.functions, self.subject.mask)
        if self.registration:
            return self._registered(own, template)
        return Carried(carried(self._first_points(surface, template), own))

    def renamed(self, rename: Rename) -> Carrying:
        """Return the same with other names of files."""
        own, word = self.subject, self.initial
        subject = replace(
            own,
            functions=tuple(text and renamed_spec(text, rename) for text in own.functions),
            mask=own.mask and renamed_spec(own.mask, rename),
            surface=own.surface and rename(own.surface),
            landmarks=own.landmarks and rename(own.landmarks),
        )
        return replace(
            self,
            subject=subject,
            template=rename(self.template),
            initial=word and INITIAL_INPUT.renamed(word, rename),
            registration=self.registration and rename(self.registration),
            drift=self.drift and rename(self.drift),
        )

    def _first_points(self, surface: TriangleMesh, template: TriangleMesh) -> SurfacePoints:
        """Return where on a subject the template's vertices lie by an initial map that needs no
        functions, since none of the template are known yet.
        """
        marks = None
        if self.subject.landmarks:
            marks = read_landmarks(surface, template, self.subject.landmarks, self.one_based)
        is_embedded = self.initial.partition(":")[0] == "embedding"
        if is_embedded and (marks is None or len(marks) < LANDMARKS_MIN):
            raise ParameterError(
                "an initial map by embedding without the template's functions needs "
                f"{LANDMARKS_MIN} landmarks or more"
            )
        found = initial_map(self.initial or None, MapInput(surface, template, landmarks=marks))
        return found.correspondence.points.points

    def _registered(self, own: Own, template: TriangleMesh) -> Carried:
        drift = array_from(read_bytes(self.drift, _DRIFT_BYTES_MAX))
        if drift.shape != (len(template.faces), 3):
            raise ResultError("the mean field is of another template; run the same again")
        registration = load_registration(self.registration)
        shift = ContinuousFlow(template, drift, 1.0).destinations
        before, after = maps(registration, own.mesh, template, shift)
        if self.at_edges:
            points = edge_middles(template)
            return Carried(carried(before(points), own), carried(after(points), own))
        points = vertex_points(template)
        there = after(points)
        whole = PointMap(template, own.mesh, there.faces, there.barycentric, interior_map=after)
        log2_area, facts = map_facts(registration, whole, drift)
        return Carried(
            carried(before(points), own),
            carried(there, own),
            log2_area,
            registration.verdict.kind,
            facts,
        )
