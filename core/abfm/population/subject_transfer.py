"""Transfer of subjects to the template: the parallel computations after registration.

The computations read the files of registrations and write no files.
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
    SubjectData,
    TemplateValues,
    edge_midpoints,
    map_facts,
    maps,
    values_at,
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


class TransferredSubject(NamedTuple):
    """Values of a subject at P points of the template, before and after registration."""

    before: TemplateValues
    after: TemplateValues | None = None  # None if the subject is not registered
    log2_area: FloatArray | None = None  # (F,), log2 J of faces; None unless points are vertices
    verdict: str = ""  # kind of the verdict of the registration
    facts: MapFacts = MapFacts()


@dataclass(frozen=True)
class SubjectTransfer:
    """Computation that transfers a subject to the template.

    Without a registration, it uses an initial map that needs no functions. With a registration, it
    uses the registered map, corrected by the flow of the mean field.
    """

    subject: Subject
    template: str  # mesh file of the template
    # options of loading both meshes, see `abfm.tasks.inputs.MESH_INPUTS`
    options: Mapping[str, Any] = field(default_factory=dict)
    initial: str = ""  # method of the initial map; empty for automatic choice
    one_based: bool = False  # whether files of landmarks count vertices from 1
    registration: str = ""  # file of the registration; empty if the initial map is used
    drift: str = ""  # file of the mean field; empty if the initial map is used
    at_edges: bool = False  # transfer values to the midpoints of edges instead of the vertices

    def files(self) -> list[str]:
        return files_renamed(self.renamed)

    def relocated(self, places: Mapping[str, str]) -> SubjectTransfer:
        return self.renamed(lambda path: places.get(path, path))

    def compute(self) -> TransferredSubject:
        template = mesh_of(self.template, self.options)
        surface = mesh_of(self.subject.surface or self.template, self.options)
        data = SubjectData.of(surface, self.subject.functions, self.subject.mask)
        if self.registration:
            return self._registered(data, template)
        return TransferredSubject(values_at(self._first_points(surface, template), data))

    def renamed(self, rename: Rename) -> SubjectTransfer:
        subject, method = self.subject, self.initial
        subject = replace(
            subject,
            functions=tuple(text and renamed_spec(text, rename) for text in subject.functions),
            mask=subject.mask and renamed_spec(subject.mask, rename),
            surface=subject.surface and rename(subject.surface),
            landmarks=subject.landmarks and rename(subject.landmarks),
        )
        return replace(
            self,
            subject=subject,
            template=rename(self.template),
            initial=method and INITIAL_INPUT.renamed(method, rename),
            registration=self.registration and rename(self.registration),
            drift=self.drift and rename(self.drift),
        )

    def _first_points(self, surface: TriangleMesh, template: TriangleMesh) -> SurfacePoints:
        """Map the template's vertices to a subject by an initial map without functions."""
        landmarks = None
        if self.subject.landmarks:
            landmarks = read_landmarks(surface, template, self.subject.landmarks, self.one_based)
        is_embedded = self.initial.partition(":")[0] == "embedding"
        if is_embedded and (landmarks is None or len(landmarks) < LANDMARKS_MIN):
            raise ParameterError(
                "the initial map 'embedding' needs functions of the template or at least "
                f"{LANDMARKS_MIN} landmarks of each subject"
            )
        found = initial_map(self.initial or None, MapInput(surface, template, landmarks=landmarks))
        return found.correspondence.points.points

    def _registered(self, data: SubjectData, template: TriangleMesh) -> TransferredSubject:
        drift = array_from(read_bytes(self.drift, _DRIFT_BYTES_MAX))
        if drift.shape != (len(template.faces), 3):
            raise ResultError(
                "the mean field belongs to another template; run the same command again"
            )
        registration = load_registration(self.registration)
        shift = ContinuousFlow(template, drift, 1.0).destinations
        before, after = maps(registration, data.mesh, template, shift)
        points = edge_midpoints(template) if self.at_edges else vertex_points(template)
        images = after(points)
        first, last = values_at(before(points), data), values_at(images, data)
        if self.at_edges:
            return TransferredSubject(first, last)
        point_map = PointMap.of_points(template, images, after)
        log2_area, facts = map_facts(registration, point_map, drift)
        return TransferredSubject(first, last, log2_area, registration.verdict.kind, facts)
