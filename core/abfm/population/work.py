"""A round: from what subjects are registered to, by rows of a batch, to their mean."""

from __future__ import annotations

import hashlib
import math
import os
import shlex
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from functools import cached_property
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from abfm.batch import Entry, Row
from abfm.calculus.operators import edge_areas, face_areas, vertex_areas
from abfm.errors import AbfmError, ParameterError, ResultError, brief, did_you_mean, one_line
from abfm.functions import quoted
from abfm.io.atomic import write_atomically
from abfm.mesh import MeshLike, TriangleMesh, as_mesh, load_mesh
from abfm.parameters import Parameters
from abfm.population.carrying import Carried, Carrying
from abfm.population.misfits import Compared, Likeness, judge, left_for_good
from abfm.population.on_template import (
    OnTemplate,
    checked_mask,
    displacement_in,
    known_functions,
    stacked,
)
from abfm.population.round import Round
from abfm.population.settings import Settings
from abfm.population.statistics import Moments, phase_and_amplitude
from abfm.population.subjects import Cohort, Subject
from abfm.population.target import Target
from abfm.reading import side_of
from abfm.sequences.noise import noise
from abfm.tasks.inputs import MESH_INPUTS, by_name, mesh_options
from abfm.types import BoolArray, FloatArray
from abfm.workers.control import checkpoint
from abfm.workers.progress import step

Solve: TypeAlias = Callable[[Sequence[Carrying], str], list[Entry]]
"""Returns what has come of rows, in their order; the text says what is done, for progress."""
_TARGETS = "targets"  # folder of templates, functions that subjects are registered to, mean fields
_LOOKS = 3  # at who fits, in a round, each with the mean field of those who did before
_LISTENED_TO = 3  # subjects, for noise
_BY_FUNCTIONS = "embedding", "landmarks"  # initial maps of which none is found without

_MESH_INPUTS = by_name(MESH_INPUTS)


class Work:
    """All that stays the same from round to round.

    ``solve`` has rows solved that carry subjects.
    """

    def __init__(
        self, cohort: Cohort, template: MeshLike, folder: Path, settings: Settings, solve: Solve
    ) -> None:
        self.cohort, self.settings, self._solve = cohort, settings, solve
        self.folder = Path(os.path.abspath(os.path.expanduser(folder)))
        options = {name: str(value) for name, value in settings.options.items()}
        self.of_meshes = {name: options[name] for name in _MESH_INPUTS if name in options}
        self.path = self._file_of(template)
        self.template = self._mesh(self.path)
        names = [cohort.channels[c].name for c in cohort.registered_by]
        for what, given in (("function", settings.functions), ("weight", settings.weights)):
            for name in given:
                if name not in names:
                    raise ParameterError(
                        f"there is a {what} of {brief(name)}, and no such channel to register by"
                        f"{did_you_mean(name, names)}"
                    )
        if missing := [
            name for name in names if settings.functions and not settings.functions.get(name)
        ]:
            raise ParameterError(
                f"the template has no function {brief(missing[0])}; give one for each channel to "
                "register by, or none"
            )
        self.channel_weights = [float(settings.weights.get(name, 1.0)) for name in names]
        self.mask = checked_mask(self.template, settings.mask, "the template")
        self.areas = vertex_areas(self.template) * self.mask
        self.weights = np.array([subject.weight for subject in cohort.subjects])

    def _options(self) -> Mapping[str, Any]:
        values = {name: _MESH_INPUTS[name].read(text) for name, text in self.of_meshes.items()}
        return mesh_options(values).given

    def _mesh(self, path: str) -> TriangleMesh:
        return load_mesh(path, **self._options())

    def _file_of(self, template: MeshLike) -> str:
        """Return the path of a template; one that is not a file is written, with all vertices of
        its input, so that functions and vertex numbers for these fit.
        """
        if isinstance(template, str | os.PathLike):
            return os.path.abspath(os.path.expanduser(template))
        options = {} if isinstance(template, TriangleMesh) else self._options()
        mesh = as_mesh(template, "template", **options)
        vertices, faces = mesh.on_file(mesh.vertices, 0.0), mesh.vertex_ids[mesh.faces]
        side = side_of(mesh.structure)
        name = f"template-{mesh.digest[:16]}{f'_hemi-{side}' if side else ''}.off"
        path = self._targets() / name
        with write_atomically(path) as temporary, temporary.open("w", encoding="ascii") as file:
            file.write(f"OFF\n{len(vertices)} {len(faces)} 0\n")
            np.savetxt(file, vertices, "%.17g")
            np.savetxt(file, faces, "3 %d %d %d")
        return os.fspath(path)

    @cached_property
    def goal(self) -> float:
        """How close registrations come, unless that is given, where functions do not count as
        measured, as on coarse meshes: no closer than the noise of the first subjects.
        """
        levels = []
        for subject in self.cohort.subjects[:_LISTENED_TO]:
            with suppress(AbfmError):  # which its registration tells
                mesh = self._mesh(subject.surface or self.path)
                texts = [subject.functions[c] for c in self.cohort.registered_by]
                f = known_functions(mesh, texts, checked_mask(mesh, subject.mask, subject.name))[1]
                sizes = f.std(axis=1)
                if sizes.all():  # of constants registrations tell
                    levels.append(float(np.sqrt(np.mean((noise(mesh, f) / sizes) ** 2))))
        # more than 1 is a bound on noise, and no goal
        return min(max(Parameters.goal, float(np.median(levels or [0.0]))), 1.0)

    def first_target(self) -> Target:
        """Return the template's own functions, or those of the subject that is most like the plain
        mean, which is blurred, so that what is matched to it is too.
        """
        given = self.settings.functions
        channels = self.cohort.registered_by
        if given:
            texts = [given[self.cohort.channels[c].name] for c in channels]
            known, functions = known_functions(self.template, texts, self.mask)
            return Target(functions, np.where(known, self.mask, 0))
        self._refuse_maps_by_functions()
        if np.count_nonzero(self.weights) < 2:
            raise ParameterError(
                "one subject alone has a weight above 0: give another one too, or the template's "
                "own functions"
            )
        rows = [self._carrying(subject) for subject in self.cohort.subjects]
        entries = self._solve(rows, "comparing")
        # why others failed their registrations tell, too
        failures = [entry.reason for entry in entries]
        found = [each.load().before if each.path else self._nothing() for each in entries]
        values, masks = stacked(found)
        judged = judge(self._compared(values, masks), None, failures)
        alike = np.array([each.correlation for each in judged.likeness])
        chosen = np.where(judged.fits & (self.weights > 0) & np.isfinite(alike), alike, -math.inf)
        best = int(np.argmax(chosen))
        if not np.isfinite(chosen[best]):
            told = next((each for each in judged.reasons if each), "their functions are unlike")
            raise ParameterError(f"no subject can be the first target: {told}")
        return Target.filled(self.template, values[best][:, channels].T, masks[best] * self.mask)

    def _refuse_maps_by_functions(self) -> None:
        """Refuse initial maps that need functions of both surfaces, or landmarks, where one of
        neither is known of the template.
        """
        word = self.settings.initial.partition(":")[0]
        if word in _BY_FUNCTIONS and not all(each.landmarks for each in self.cohort.subjects):
            needs = "by landmarks" if word == "landmarks" else "by functions of both surfaces"
            raise ParameterError(
                f"the initial map {brief(self.settings.initial)} is found {needs}: give the "
                "template's function of each channel (--function NAME=SPEC), landmarks of each "
                "subject, or another initial map"
            )

    def _compared(self, values: FloatArray, masks: FloatArray) -> Compared:
        matched = [values[:, :, c] for c in self.cohort.registered_by]
        return Compared(matched, masks, self.weights, self.areas, self.channel_weights)

    def _nothing(self) -> OnTemplate:
        count = len(self.template.vertices)
        return OnTemplate(np.full((count, len(self.cohort.channels)), np.nan), np.zeros(count))

    def rows(self, target: Target, number: int) -> list[Row]:
        """Write a target, and return a row for each subject."""
        targets = [
            self._function_written(f"round-{number}-{c}", values)
            for c, values in enumerate(target.functions, 1)
        ]
        mask = None
        if (target.mask != 1).any():
            mask = self._function_written(f"round-{number}-mask", target.mask)
        return [self._row(subject, targets, mask) for subject in self.cohort.subjects]

    def _row(self, subject: Subject, targets: Sequence[str], mask: str | None) -> Row:
        sources = [subject.functions[c] for c in self.cohort.registered_by]
        channels = list(zip(sources, targets, self.channel_weights, strict=True))
        pairs: list[tuple[str, object]] = [("a", subject.surface or self.path), ("b", self.path)]
        if self.channel_weights[0] == 1:
            source, target, _ = channels.pop(0)
            pairs += [("source", source), ("target", target)]
        pairs += [
            ("channel", shlex.join((source, target, repr(weight))))
            for source, target, weight in channels
        ]
        pairs += [("mask-a", subject.mask), ("mask-b", mask), ("landmarks", subject.landmarks)]
        pairs.append(("initial", self.settings.initial))
        options = dict(self.settings.options)
        if self.goal > Parameters.goal:
            options.setdefault("goal", self.goal)
        pairs += options.items()
        return Row(subject.name, pairs)

    def _carrying(self, subject: Subject, **by: object) -> Carrying:
        """Return a row that carries a subject, by a registration or else by its initial map."""
        first: dict[str, object] = {
            "initial": self.settings.initial,
            "landmarks": subject.landmarks,
            "one-based": self.settings.options.get("one-based", ""),
        }
        pairs = {
            "surface": subject.surface or self.path,
            "template": self.path,
            "functions": shlex.join(subject.functions),
            "mask": subject.mask,
            **self.of_meshes,
        }
        return Carrying(subject.name, pairs | (by or first))

    def round(self, entries: Sequence[Entry], before: Sequence[BoolArray], number: int) -> Round:
        """Carry all subjects by their maps less the mean field of those who fitted at the end of
        the round before, if there is one, and say who fits; again if these are others.
        """
        failures = [
            "" if entry.path else f"it was not registered: {entry.reason or 'there is no result'}"
            for entry in entries
        ]
        is_there = np.array([not each for each in failures])
        self._require_two(failures)
        fits, for_good = is_there, np.zeros_like(is_there)
        if before:
            fits, for_good = is_there & before[-1], left_for_good(before)
        found = None
        for _ in range(_LOOKS):
            found = self._look(entries, fits, failures, number, for_good)
            if (found.judged.fits == fits).all():
                break
            fits = found.judged.fits
        assert found is not None
        if not (found.judged.fits & (self.weights > 0)).any():
            raise ResultError(f"no subject fits the others: {found.judged.reasons[0]}")
        return found

    def _require_two(self, failures: Sequence[str]) -> None:
        left = sum(not each for each in failures)
        if left < 2:
            told = next(each for each in failures if each)
            raise ResultError(
                f"{left} of {len(failures)} subjects could be registered; of "
                f"{one_line(self.cohort.subjects[failures.index(told)].name, 60)}: {told}"
            )

    def _mean_field(self, entries: Sequence[Entry], fits: BoolArray) -> FloatArray:
        total, weight = np.zeros((len(self.template.faces), 3)), 0.0
        for entry, counts, each in zip(entries, fits, self.weights, strict=True):
            if entry.path is not None and counts and each:
                checkpoint()
                total, weight = total + each * displacement_in(entry.path), weight + each
        return total / weight if weight else total

    def _look(
        self,
        entries: Sequence[Entry],
        fits: BoolArray,
        failures: Sequence[str],
        number: int,
        for_good: BoolArray,
    ) -> Round:
        drift = self._mean_field(entries, fits)
        place = self._written(f"round-{number}-drift", drift)
        known = [i for i, entry in enumerate(entries) if entry.path is not None]
        rows = [
            self._carrying(self.cohort.subjects[i], registration=entries[i].path, drift=place)
            for i in known
        ]
        found = dict(zip(known, self._solve(rows, "carrying"), strict=True))
        failures = [
            f"it was not carried: {found[i].reason or 'there is no result'}"
            if i in found and found[i].path is None
            else why
            for i, why in enumerate(failures)
        ]
        self._require_two(failures)
        areas, nothing = face_areas(self.template), self._nothing()
        unknown = Carried(nothing, nothing, np.full(len(areas), np.nan))
        carried, after, logs = list[Carried](), list[OnTemplate](), list[FloatArray]()
        maps = list[Likeness]()
        with step("summing", about=f" {len(rows)} subjects") as done:
            for i, failure in enumerate(failures):
                checkpoint()
                each = unknown if failure else found[i].load()
                assert each.after is not None
                assert each.log2_area is not None
                after.append(each.after)
                logs.append(each.log2_area)
                carried.append(each)
                changed = float(np.average(np.abs(each.log2_area), weights=areas))
                maps.append(Likeness(math.nan, math.nan, changed, each.facts.folded))
                done((i + 1) / len(failures))
            values, masks = stacked(after)
            judged = judge(self._compared(values, masks), maps, failures, for_good)
        return Round(
            judged,
            stacked([each.before for each in carried]),
            (values, masks),
            np.stack(logs),
            drift,
            place,
            tuple(each.verdict for each in carried),
            tuple(
                "" if failure else entry.digest
                for failure, entry in zip(failures, entries, strict=True)
            ),
            tuple(each.facts for each in carried),
        )

    def phases(self, entries: Sequence[Entry], found: Round) -> FloatArray:
        """Part the variance of each channel, (C, 4), by the middles of edges, where values are
        means of two before and of two or three after, so that noise is smoothed alike.
        """
        ends = self.template.edges
        areas = edge_areas(self.template) * self.mask[ends].mean(axis=1)
        middles = found.middles(self)
        sums = [[Moments.at(len(ends)) for _ in middles] for _ in range(2)]
        counting = np.flatnonzero(found.judged.fits & (self.weights > 0)).tolist()
        by = {"drift": found.drift_file, "at": "edges"}
        rows = [
            self._carrying(self.cohort.subjects[i], registration=entries[i].path, **by)
            for i in counting
        ]
        for i, entry in zip(counting, self._solve(rows, "parting position and value"), strict=True):
            checkpoint()
            carried = entry.load()
            for part, there in zip(sums, (carried.before, carried.after), strict=True):
                _add(part, there, self.weights[i], middles)
        return np.array([phase_and_amplitude(x, y, areas) for x, y in zip(*sums, strict=True)])

    def _function_written(self, name: str, values: FloatArray) -> str:
        """Write values (V,), and return the text of the function that they are."""
        return f"file:{quoted(self._written(name, values))}"

    def _written(self, name: str, values: FloatArray) -> str:
        """Write an array, and return its file, whose name tells it from others, which another run
        in this folder may write meanwhile.
        """
        content = hashlib.sha256(np.ascontiguousarray(values).tobytes()).hexdigest()
        path = self._targets() / f"{name}-{content[:16]}.npy"
        with write_atomically(path) as temporary:
            np.save(temporary, values)
        return os.fspath(path)

    def _targets(self) -> Path:
        """Return the folder of what registrations read, which is made if it is not there."""
        folder = self.folder / _TARGETS
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise ResultError(
                f"cannot write in {one_line(self.folder)}: {one_line(error)}; choose a folder that "
                "is writable and has space left"
            ) from error
        return folder


def _add(sums: Sequence[Moments], there: OnTemplate, weight: float, middles: FloatArray) -> None:
    """Add a subject's values, by channels, less their middles (C,)."""
    for moments, values, middle in zip(sums, there.values.T, middles, strict=True):
        shares = weight * np.where(np.isfinite(values), there.mask, 0)
        moments.add(values - middle, shares)
