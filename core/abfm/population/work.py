"""A round: from what subjects are registered to, by rows of a batch, to their mean."""

from __future__ import annotations

import hashlib
import math
import os
import shlex
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

from abfm.batch import Entry, Row
from abfm.calculus.channels import extend
from abfm.calculus.operators import edge_areas, face_areas, vertex_areas
from abfm.errors import AbfmError, ParameterError, ResultError, brief, did_you_mean, one_line
from abfm.flow.continuous_flow import ContinuousFlow
from abfm.functions import function, quoted
from abfm.io.atomic import write_atomically
from abfm.mesh import TriangleMesh, load_mesh
from abfm.population import statistics
from abfm.population.misfits import Compared, Judged, Likeness, judge
from abfm.population.on_template import (
    OnTemplate,
    Own,
    carried,
    edge_middles,
    maps,
    mean_field,
    registered,
    stacked,
)
from abfm.population.population import Population
from abfm.population.settings import Settings
from abfm.population.statistics import Moments, phase_and_amplitude, relative_distance
from abfm.population.subjects import Cohort, Subject
from abfm.registration.correspondence import Correspondence
from abfm.registration.initial import initial_map
from abfm.registration.initial.given import Given
from abfm.types import BoolArray, FloatArray, IntArray
from abfm.workers.control import checkpoint
from abfm.workers.progress import step

_MESHES_KEPT = 4  # of subjects, with what was computed from them
_TARGETS = "targets"  # folder of the functions that subjects are registered to
_LOOKS = 3  # at who fits, in a round, each with the mean field of those who did before


class Target(NamedTuple):
    """What subjects are registered to: functions on the template, where they are known."""

    functions: FloatArray  # (C, V), of the channels to register by
    mask: FloatArray  # (V,)

    def distance(self, before: Target, areas: FloatArray) -> float:
        """Return how far it is from another one, over its deviation: of channels the root mean
        square.
        """
        seen = np.where((self.mask > 0) & (before.mask > 0), areas, 0)
        pairs = zip(before.functions, self.functions, strict=True)
        squares = [relative_distance(old, new, seen) ** 2 for old, new in pairs]
        return math.sqrt(np.mean(squares))


class Work:
    """All that stays the same from round to round."""

    def __init__(self, cohort: Cohort, template: Path, folder: Path, settings: Settings) -> None:
        self.cohort, self.settings = cohort, settings
        self.path = os.path.abspath(os.path.expanduser(template))
        self.folder = Path(os.path.abspath(os.path.expanduser(folder)))
        self.template = load_mesh(self.path)
        names = [cohort.channels[c].name for c in cohort.registered_by]
        for name in settings.functions:
            if name not in names:
                raise ParameterError(
                    f"the template has a function {brief(name)}, and there is no such channel to "
                    f"register by{did_you_mean(name, names)}"
                )
        if missing := [
            name for name in names if settings.functions and not settings.functions.get(name)
        ]:
            raise ParameterError(
                f"the template has no function {brief(missing[0])}; give one for each channel to "
                "register by, or none"
            )
        self.mask = _mask(self.template, settings.mask, "the template")
        self.areas = vertex_areas(self.template) * self.mask
        self.weights = np.array([subject.weight for subject in cohort.subjects])
        self._mesh = lru_cache(maxsize=_MESHES_KEPT)(load_mesh)
        self._first_map = lru_cache(maxsize=_MESHES_KEPT)(self._found_first_map)

    def own(self, subject: Subject) -> Own:
        """Read what is known of a subject; an AbfmError names it."""
        try:
            own = self.surface(subject)
            columns = [
                function(own, text) if text else np.full(len(own.vertices), np.nan)
                for text in subject.functions
            ]
            mask = _mask(own, subject.mask, "it")
        except AbfmError as error:
            raise ResultError(f"subject {one_line(subject.name, 60)}: {error}") from error
        return Own(own, np.stack(columns, axis=1), mask)

    def surface(self, subject: Subject) -> TriangleMesh:
        path = subject.surface
        return self._mesh(path) if path and path != self.path else self.template

    def first_target(self) -> Target:
        """Return the template's own functions, or those of the subject that is most like the plain
        mean, which is blurred, so that what is matched to it is too.
        """
        given = self.settings.functions
        channels = self.cohort.registered_by
        if given:
            texts = [given[self.cohort.channels[c].name] for c in channels]
            return Target(np.stack([function(self.template, each) for each in texts]), self.mask)
        found, failures = [], []
        with step("comparing", about=f" {len(self.cohort.subjects)} subjects") as done:
            for i, subject in enumerate(self.cohort.subjects):
                checkpoint()
                try:
                    own = self.own(subject)
                    first = self._first_map(own.mesh).points
                    found.append(carried(first.points, own))
                    failures.append("")
                except AbfmError as error:  # its row tells
                    found.append(self.nothing())
                    failures.append(str(error))
                done((i + 1) / len(self.cohort.subjects))
        values, masks = stacked(found)
        judged = judge(self._compared(values, masks), None, failures)
        alike = np.array([each.correlation for each in judged.likeness])
        chosen = np.where(judged.fits & (self.weights > 0) & np.isfinite(alike), alike, -math.inf)
        best = int(np.argmax(chosen))
        if np.count_nonzero(self.weights) < 2:
            raise ParameterError(
                "one subject alone has a weight above 0: give another one too, or the template's "
                "own functions"
            )
        if not np.isfinite(chosen[best]):
            told = next((each for each in judged.reasons if each), "their functions are unlike")
            raise ParameterError(f"no subject can be the first target: {told}")
        return _filled(self.template, values[best][:, channels].T, masks[best] * self.mask)

    def _compared(self, values: FloatArray, masks: FloatArray) -> Compared:
        matched = [values[:, :, c] for c in self.cohort.registered_by]
        return Compared(matched, masks, self.weights, self.areas)

    def _found_first_map(self, mesh: TriangleMesh) -> Correspondence:
        word = self.settings.initial
        if word.partition(":")[0] in ("embedding", "spectral", "landmarks"):
            raise ParameterError(
                f"the initial map {brief(word)} is found by functions on both surfaces: give the "
                "template's own"
            )
        return initial_map(word or None, Given(mesh, self.template)).correspondence

    def nothing(self) -> OnTemplate:
        count = len(self.template.vertices)
        return OnTemplate(np.full((count, len(self.cohort.channels)), np.nan), np.zeros(count))

    def rows(self, target: Target, number: int) -> list[Row]:
        """Write a target, and return a row for each subject."""
        folder = self.folder / _TARGETS
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise ResultError(
                f"cannot write in {one_line(self.folder)}: {one_line(error)}; choose a folder that "
                "is writable and has space left"
            ) from error
        targets = []
        for c, values in enumerate(target.functions, 1):
            targets.append(_written(folder, f"round-{number}-{c}", values))
        mask = None
        if (target.mask != 1).any():
            mask = _written(folder, f"round-{number}-mask", target.mask)
        return [self._row(subject, targets, mask) for subject in self.cohort.subjects]

    def _row(self, subject: Subject, targets: Sequence[str], mask: str | None) -> Row:
        sources = [subject.functions[c] for c in self.cohort.registered_by]
        pairs: list[tuple[str, object]] = [
            ("a", subject.surface or self.path),
            ("b", self.path),
            ("source", sources[0]),
            ("target", targets[0]),
        ]
        pairs += [
            ("channel", shlex.join((source, target, "1")))
            for source, target in zip(sources[1:], targets[1:], strict=True)
        ]
        pairs += [("mask-a", subject.mask), ("mask-b", mask), ("initial", self.settings.initial)]
        pairs += self.settings.options.items()
        return Row(subject.name, pairs)

    def round(self, entries: Sequence[Entry], before: BoolArray | None) -> Round:
        """Carry all subjects by their maps less the mean field of those who fitted before, if that
        is known, and say who fits; again if these are others.
        """
        failures = [
            "" if entry.path else f"it was not registered: {entry.reason or 'there is no result'}"
            for entry in entries
        ]
        is_there = np.array([not each for each in failures])
        if is_there.sum() < 2:
            told = next(each for each in failures if each)
            raise ResultError(
                f"{is_there.sum()} of {len(entries)} subjects could be registered; of "
                f"{one_line(self.cohort.subjects[failures.index(told)].name, 60)}: {told}"
            )
        fields = [None if entry.path is None else mean_field(entry.path) for entry in entries]
        fits, found = is_there if before is None else is_there & before, None
        for _ in range(_LOOKS):
            drift = self._mean_of_fields(fields, fits)
            found = self._look(entries, fields, drift, failures)
            if (found.judged.fits == fits).all():
                break
            fits = found.judged.fits
        assert found is not None
        if not (found.judged.fits & (self.weights > 0)).any():
            raise ResultError(f"no subject fits the others: {found.judged.reasons[0]}")
        return found

    def _mean_of_fields(self, fields: Sequence[FloatArray | None], fits: BoolArray) -> FloatArray:
        total, weight = np.zeros((len(self.template.faces), 3)), 0.0
        for own, counts, each in zip(fields, fits, self.weights, strict=True):
            if own is not None and counts:
                total, weight = total + each * own, weight + each
        return total / weight if weight else total

    def _look(
        self,
        entries: Sequence[Entry],
        fields: Sequence[FloatArray | None],
        drift: FloatArray,
        failures: Sequence[str],
    ) -> Round:
        shift = ContinuousFlow(self.template, drift, 1.0).destinations
        of_maps, before, after, logs = list[Likeness](), [], [], []
        verdicts, displacement, mismatch = list[str](), [], []
        areas, scale = face_areas(self.template), self.template.length_scale
        with step("carrying", len(entries), f" {len(entries)} subjects") as done:
            for i, (entry, own) in enumerate(zip(entries, fields, strict=True)):
                checkpoint()
                found = None
                if own is not None:
                    subject = self.own(self.cohort.subjects[i])
                    found = registered(entry.load(), subject, self.template, shift)
                before.append(self.nothing() if found is None else found.before)
                after.append(self.nothing() if found is None else found.after)
                logs.append(np.full(len(areas), np.nan) if found is None else found.log2_area)
                verdicts.append("" if found is None else found.verdict)
                mismatch.append(math.nan if found is None else found.mismatch)
                of_maps.append(_no_map() if found is None else found.likeness(areas))
                moved = math.nan
                if own is not None:
                    squares = ((own - drift) ** 2).sum(axis=1)
                    moved = math.sqrt(np.average(squares, weights=areas)) / scale
                displacement.append(moved)
                done((i + 1) / len(entries))
        values, masks = stacked(after)
        judged = judge(self._compared(values, masks), of_maps, failures)
        return Round(
            judged,
            stacked(before),
            (values, masks),
            np.stack(logs),
            drift,
            tuple(verdicts),
            tuple(entry.digest if entry.path else "" for entry in entries),
            np.array(displacement),
            np.array(mismatch),
        )

    def phases(self, entries: Sequence[Entry], found: Round) -> FloatArray:
        """Part the variance of each channel, (C, 4), by the middles of edges, where values are
        means of two before and of two or three after, so that noise is smoothed alike.
        """
        points, ends = edge_middles(self.template), self.template.edges
        areas = edge_areas(self.template) * self.mask[ends].mean(axis=1)
        middles = found.middles(self)
        sums = [[Moments.at(len(ends)) for _ in middles] for _ in range(2)]
        shift = ContinuousFlow(self.template, found.drift, 1.0).destinations
        with step("parting position and value", about=f" of {len(entries)} subjects") as done:
            for i, (entry, weight) in enumerate(zip(entries, self.weights, strict=True)):
                checkpoint()
                if found.judged.fits[i] and weight:
                    own = self.own(self.cohort.subjects[i])
                    both = maps(entry.load(), own, self.template, shift)
                    for part, by in zip(sums, both, strict=True):
                        _add(part, carried(by(points), own), weight, middles)
                done((i + 1) / len(entries))
        return np.array([phase_and_amplitude(x, y, areas) for x, y in zip(*sums, strict=True)])


class Round(NamedTuple):
    """What a round came to."""

    judged: Judged
    before: tuple[FloatArray, FloatArray]  # values (N, V, C) and masks (N, V)
    after: tuple[FloatArray, FloatArray]
    log2_areas: FloatArray  # (N, F)
    drift: FloatArray
    verdicts: tuple[str, ...]
    digests: tuple[str, ...]
    displacement: FloatArray  # (N,)
    mismatch: FloatArray

    def target(self, work: Work) -> Target:
        """Return the mean of those who fit."""
        values, masks = self.after
        shares = (work.weights * self.judged.fits)[:, None] * masks
        means = np.stack(
            [statistics.mean(values[:, :, c], shares) for c in work.cohort.registered_by]
        )
        return _filled(work.template, means, work.mask * (shares > 0).any(axis=0))

    def middles(self, work: Work) -> FloatArray:
        """Return the mean over surface and subjects of each channel, before, (C,)."""
        values, masks = self.before
        shares = (work.weights * self.judged.fits)[:, None] * masks
        found = []
        for own in np.moveaxis(values, 2, 0):
            mean = statistics.mean(own, np.where(np.isfinite(own), shares, 0))
            known = np.where(np.isfinite(mean), work.areas, 0)
            found.append(known @ np.nan_to_num(mean) / known.sum() if known.any() else 0.0)
        return np.array(found)

    def population(
        self, work: Work, changes: Sequence[float], phases: FloatArray, order: IntArray
    ) -> Population:
        """Return it with the subjects in another order."""
        cohort, judged = work.cohort, self.judged
        counts = (work.weights * judged.fits)[:, None] * np.ones(self.log2_areas.shape[1])
        found = [
            [each.correlation, each.distance, each.log2_area, each.folded]
            for each in judged.likeness
        ]
        numbers = np.column_stack([found, self.displacement, self.mismatch])
        numbers[~np.isfinite(numbers)] = np.nan  # as of flow lines that lead too far

        def ordered(texts: Sequence[str]) -> tuple[str, ...]:
            return tuple(texts[i] for i in order)

        return Population(
            work.template,
            cohort.channels,
            ordered([subject.name for subject in cohort.subjects]),
            work.weights[order],
            judged.fits[order],
            ordered(judged.reasons),
            ordered(self.verdicts),
            ordered(self.digests),
            self.before[0][order],
            self.after[0][order],
            self.before[1][order],
            self.after[1][order],
            work.mask,
            numbers[order],
            phases,
            statistics.mean(self.log2_areas, counts),
            statistics.deviation(self.log2_areas, counts),
            self.drift,
            np.array(changes),
        )


def _add(sums: Sequence[Moments], there: OnTemplate, weight: float, middles: FloatArray) -> None:
    """Add a subject's values, by channels, less their middles (C,)."""
    for moments, values, middle in zip(sums, there.values.T, middles, strict=True):
        shares = weight * np.where(np.isfinite(values), there.mask, 0)
        moments.add(values - middle, shares)


def _no_map() -> Likeness:
    return Likeness(math.nan, math.nan)


def _filled(mesh: TriangleMesh, functions: FloatArray, mask: FloatArray) -> Target:
    """Return a target whose functions (C, V) are filled in from around where they are unknown."""
    known = np.isfinite(functions).all(axis=0) & (mask > 0)
    if not known.any():
        raise ResultError("the masks of subjects and template have nothing in common")
    filled = [extend(mesh, np.where(known, each, 0), known) for each in functions]
    return Target(np.stack(filled), np.where(known, mask, 0))


def _mask(mesh: TriangleMesh, text: str, whose: str) -> FloatArray:
    if not text:
        return np.ones(len(mesh.vertices))
    found = function(mesh, text)
    if (found < 0).any() or not found.any():
        raise ParameterError(f"the mask of {whose} is negative somewhere, or 0 everywhere")
    return found


def _written(folder: Path, name: str, values: FloatArray) -> str:
    """Write values (V,), and return the text of the function that they are; the file's name tells
    them from others, which another run in this folder may write meanwhile.
    """
    content = hashlib.sha256(np.ascontiguousarray(values).tobytes()).hexdigest()
    path = folder / f"{name}-{content[:16]}.npy"
    with write_atomically(path) as temporary:
        np.save(temporary, values)
    return f"file:{quoted(os.fspath(path))}"
