"""A round: from what subjects are registered to, by rows of a batch, to their mean."""

from __future__ import annotations

import hashlib
import math
import os
from collections.abc import Callable, Generator, Sequence
from contextlib import closing, suppress
from dataclasses import replace
from functools import cached_property
from pathlib import Path

import numpy as np

from abfm.batch import Ledger, LedgerEntry, Row, Workers
from abfm.batch.attempt import Answer
from abfm.calculus.operators import edge_areas, face_areas, vertex_areas
from abfm.errors import AbfmError, ParameterError, ResultError, brief, did_you_mean, one_line
from abfm.functions import quoted
from abfm.functions.known import filled, known_functions
from abfm.io import write_atomically, writing_in
from abfm.mesh import MeshLike, TriangleMesh, as_mesh, load_mesh
from abfm.mesh.options import read_flag
from abfm.parameters import Parameters
from abfm.population import statistics
from abfm.population.carrying import Carried, Carrying
from abfm.population.misfits import Compared, Likeness, judge, left_for_good
from abfm.population.on_template import (
    MapFacts,
    OnTemplate,
    checked_mask,
    displacement_in,
)
from abfm.population.population import Population
from abfm.population.round import Round, Stack
from abfm.population.settings import Settings
from abfm.population.statistics import Moments, Others, Shares, phase_and_amplitude
from abfm.population.subjects import Cohort, Subject
from abfm.population.target import Target
from abfm.reading import side_of
from abfm.sequences.noise import noise
from abfm.tasks.inputs import MESH_INPUTS, absolute, mesh_options
from abfm.types import BoolArray, FloatArray, IntArray
from abfm.workers.control import checkpoint, current_control
from abfm.workers.progress import step

_TARGETS = "targets"  # folder of templates, functions that subjects are registered to, mean fields
_LOOKS = 3  # at who fits, in a round, each with the mean field of those who did before
_NOISE_SUBJECTS = 3  # subjects, for noise
_BY_FUNCTIONS = "embedding", "landmarks"  # initial maps of which none is found without


class Work:
    """All that stays the same from round to round.

    Workers register and carry subjects, under the control of this thread.
    """

    def __init__(
        self, cohort: Cohort, template: MeshLike, folder: Path, settings: Settings, workers: Workers
    ) -> None:
        self.cohort, self.settings, self._workers = cohort, settings, workers
        self.folder = Path(os.path.abspath(os.path.expanduser(folder)))
        options = {name: str(value) for name, value in settings.options.items()}
        self.of_meshes = {
            each.name: each.read(options[each.name]) for each in MESH_INPUTS if each.name in options
        }
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

    def _mesh(self, path: str) -> TriangleMesh:
        return load_mesh(path, **mesh_options(self.of_meshes).given)

    def _file_of(self, template: MeshLike) -> str:
        """Return the path of a template; one that is not a file is written, with all vertices of
        its input, so that functions and vertex numbers for these fit.
        """
        if isinstance(template, str | os.PathLike):
            return os.path.abspath(os.path.expanduser(template))
        is_checked = isinstance(template, TriangleMesh)
        options = {} if is_checked else mesh_options(self.of_meshes).given
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
        for subject in self.cohort.subjects[:_NOISE_SUBJECTS]:
            with suppress(AbfmError):  # which its registration tells
                mesh = self._mesh(subject.surface or self.path)
                texts = [subject.functions[c] for c in self.cohort.registered_by]
                mask = checked_mask(mesh, subject.mask, subject.name)
                f = filled(mesh, *known_functions(mesh, texts, subject.name, mask))
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
            functions, known = known_functions(self.template, texts, "the template", self.mask)
            functions = filled(self.template, functions, known)
            return Target(functions, np.where(known, self.mask, 0))
        self._refuse_maps_by_functions()
        if np.count_nonzero(self.weights) < 2:
            raise ParameterError(
                "one subject alone has a weight above 0: give another one too, or the template's "
                "own functions"
            )
        tasks = [self._carrying(subject) for subject in self.cohort.subjects]
        stacks, failures = [Stack(self._targets()) for _ in range(2)], list[str]()
        with closing(self._carry(tasks, "comparing")) as answers:
            for answer in answers:
                # why others failed their registrations tell, too
                failures.append(answer.record.reason)
                found = self._nothing().before if answer.value is None else answer.value.before
                for stack, array in zip(stacks, found, strict=True):
                    stack.add(array)
        values, masks = (stack.array() for stack in stacks)
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
                "template's function of each channel (--channel NAME SPEC 1), landmarks of each "
                "subject, or another initial map"
            )

    def _compared(self, values: FloatArray, masks: FloatArray) -> Compared:
        matched = [values[:, :, c] for c in self.cohort.registered_by]
        return Compared(matched, masks, self.weights, self.areas, self.channel_weights)

    def _nothing(self) -> Carried:
        """Return what is known of a subject that is not on the template."""
        count = len(self.template.vertices)
        values = np.full((count, len(self.cohort.channels)), np.nan)
        nothing = OnTemplate(values, np.zeros(count))
        return Carried(nothing, nothing, np.full(len(self.template.faces), np.nan))

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

    def registered(
        self, target: Target, number: int, on_change: Callable[[LedgerEntry], object]
    ) -> list[LedgerEntry]:
        """Register all subjects to a target, and return the entries of the ledger, which
        ``on_change`` gets as they come.
        """
        rows, ledger = self.rows(target, number), Ledger(self.folder)
        ledger.make()
        ledger.write_rows(rows, f"round {number} of a population")  # for abfm batch --status
        with step(f"round {number}: registering", len(rows), f" {len(rows)} subjects") as done:
            count = len(rows) - len({r.key for r in rows if ledger.entry(r).state != "done"})

            def report(entry: LedgerEntry) -> None:
                nonlocal count
                count += 1
                done(count / len(rows))
                on_change(entry)

            control = current_control()
            entries = self._workers.run(rows, self.folder, on_change=report, control=control)
        checkpoint()
        return entries

    def _carry(self, tasks: Sequence[Carrying], what: str) -> Generator[Answer, None, None]:
        """Yield what comes of computations, in their order."""
        with step(what, len(tasks), f" {len(tasks)} subjects") as done:
            for count, answer in enumerate(self._workers.compute(tasks, current_control()), 1):
                yield answer
                done(count / len(tasks))
        checkpoint()

    def _row(self, subject: Subject, targets: Sequence[str], mask: str | None) -> Row:
        sources = [subject.functions[c] for c in self.cohort.registered_by]
        channels = list(zip(sources, targets, self.channel_weights, strict=True))
        pairs: list[tuple[str, object]] = [("a", subject.surface or self.path), ("b", self.path)]
        if self.channel_weights[0] == 1:
            source, target, _ = channels.pop(0)
            pairs += [("source", source), ("target", target)]
        pairs += [("channel", channel) for channel in channels]
        pairs += [("mask-a", subject.mask), ("mask-b", mask), ("landmarks", subject.landmarks)]
        pairs.append(("initial", self.settings.initial))
        options = dict(self.settings.options)
        if self.goal > Parameters.goal:
            options.setdefault("goal", self.goal)
        pairs += options.items()
        return Row(subject.name, pairs)

    def _carrying(self, subject: Subject) -> Carrying:
        """Return what carries a subject by its initial map."""
        is_one_based = read_flag(str(self.settings.options.get("one-based") or "no"))
        initial, cwd = self.settings.initial, os.getcwd()
        one = Carrying(subject, self.path, self.of_meshes, initial, is_one_based)
        return one.renamed(absolute(cwd))

    def _by_registration(
        self, subject: Subject, entry: LedgerEntry, drift: str, at_edges: bool = False
    ) -> Carrying:
        """Return what carries a subject by its registration and along a mean field."""
        return replace(
            self._carrying(subject),
            initial="",
            registration=os.fspath(entry.path or ""),
            drift=drift,
            at_edges=at_edges,
        )

    def round(
        self, entries: Sequence[LedgerEntry], before: Sequence[BoolArray], number: int
    ) -> Round:
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

    def _mean_field(self, entries: Sequence[LedgerEntry], fits: BoolArray) -> FloatArray:
        total, weight = np.zeros((len(self.template.faces), 3)), 0.0
        for entry, counts, each in zip(entries, fits, self.weights, strict=True):
            if entry.path is not None and counts and each:
                checkpoint()
                total, weight = total + each * displacement_in(entry.path), weight + each
        return total / weight if weight else total

    def _look(
        self,
        entries: Sequence[LedgerEntry],
        fits: BoolArray,
        failures: Sequence[str],
        number: int,
        for_good: BoolArray,
    ) -> Round:
        drift = self._mean_field(entries, fits)
        place = self._written(f"round-{number}-drift", drift)
        known = [i for i, entry in enumerate(entries) if entry.path is not None]
        tasks = [self._by_registration(self.cohort.subjects[i], entries[i], place) for i in known]
        stacks = [Stack(self._targets()) for _ in range(5)]
        failures, others = list(failures), list[tuple[str, MapFacts, Likeness]]()
        areas = face_areas(self.template)
        with closing(self._carry(tasks, "carrying")) as answers:
            for i, entry in enumerate(entries):
                each = self._nothing()
                if entry.path is not None:
                    answer = next(answers)
                    each = answer.value or each
                    if answer.value is None:
                        failures[i] = f"it was not carried: {answer.record.reason}"
                assert each.after is not None
                assert each.log2_area is not None
                arrays = (*each.before, *each.after, each.log2_area)
                for stack, array in zip(stacks, arrays, strict=True):
                    stack.add(array)
                changed = float(np.average(np.abs(each.log2_area), weights=areas))
                like = Likeness(math.nan, math.nan, changed, each.facts.folded)
                others.append((each.verdict, each.facts, like))
        self._require_two(failures)
        before, masks_before, after, masks, log2_areas = (stack.array() for stack in stacks)
        verdicts, facts, maps = zip(*others, strict=True)
        with step("summing", about=f" {len(tasks)} subjects"):
            judged = judge(self._compared(after, masks), maps, failures, for_good)
        digests = [
            "" if failure else entry.digest
            for failure, entry in zip(failures, entries, strict=True)
        ]
        return Round(
            judged,
            before,
            masks_before,
            after,
            masks,
            log2_areas,
            drift,
            place,
            verdicts,
            tuple(digests),
            facts,
        )

    def shares(self, found: Round, masks: FloatArray) -> Shares:
        """Return how much subjects that fit count at vertices where masks (N, V) say so."""
        return Shares(self.weights * found.judged.fits, masks)

    def target(self, found: Round) -> Target:
        """Return the mean of those who fit."""
        shares = self.shares(found, found.masks)
        others = [Others.of(found.after[:, :, c], shares) for c in self.cohort.registered_by]
        means = np.stack([each.mean() for each in others])
        return Target.filled(self.template, means, self.mask * (others[0].total > 0))

    def _middles(self, found: Round) -> FloatArray:
        """Return the mean over surface and subjects of each channel, before, (C,)."""
        middles = []
        for c in range(len(self.cohort.channels)):
            own = found.before[:, :, c]
            fits = self.weights * found.judged.fits
            mean = statistics.mean(own, Shares(fits, found.masks_before, own))
            known = np.where(np.isfinite(mean), self.areas, 0)
            middles.append(known @ np.nan_to_num(mean) / known.sum() if known.any() else 0.0)
        return np.array(middles)

    def phases(self, entries: Sequence[LedgerEntry], found: Round) -> FloatArray:
        """Part the variance of each channel, (C, 4), by the middles of edges, where values are
        means of two before and of two or three after, so that noise is smoothed alike.
        """
        ends = self.template.edges
        areas = edge_areas(self.template) * self.mask[ends].mean(axis=1)
        middles = self._middles(found)
        sums = [[Moments.at(len(ends)) for _ in middles] for _ in range(2)]
        counting = np.flatnonzero(found.judged.fits & (self.weights > 0)).tolist()
        tasks = [
            self._by_registration(self.cohort.subjects[i], entries[i], found.drift_file, True)
            for i in counting
        ]
        with closing(self._carry(tasks, "parting position and value")) as answers:
            for i in counting:
                answer = next(answers)
                if answer.value is None:
                    name = one_line(self.cohort.subjects[i].name, 60)
                    raise ResultError(f"{name} was not carried: {answer.record.reason}")
                for part, there in zip(sums, answer.value[:2], strict=True):
                    _add(part, there, self.weights[i], middles)
        return np.array([phase_and_amplitude(x, y, areas) for x, y in zip(*sums, strict=True)])

    def population(
        self, found: Round, changes: Sequence[float], phases: FloatArray, order: IntArray
    ) -> Population:
        """Return what a round came to, with the subjects in another order."""
        cohort, judged = self.cohort, found.judged
        channel_weights = np.zeros(len(cohort.channels))
        channel_weights[cohort.registered_by] = self.channel_weights
        numbers = [
            [like.correlation, like.distance, like.log2_area, *facts]
            for like, facts in zip(judged.likeness, found.facts, strict=True)
        ]
        everywhere = [np.ones(len(self.template.faces))] * len(cohort.subjects)
        counts = Shares(self.weights * judged.fits, everywhere)

        def ordered(texts: Sequence[str]) -> tuple[str, ...]:
            return tuple(texts[i] for i in order)

        def stacked(arrays: FloatArray) -> FloatArray:
            if (order == np.arange(len(order))).all():
                return arrays
            stack = Stack(self._targets())
            for i in order:
                stack.add(arrays[i])
            return stack.array()

        return Population(
            self.template,
            cohort.channels,
            ordered([subject.name for subject in cohort.subjects]),
            self.weights[order],
            channel_weights,
            judged.fits[order],
            ordered(judged.reasons),
            ordered(found.verdicts),
            ordered(found.digests),
            stacked(found.before),
            stacked(found.after),
            stacked(found.masks_before),
            stacked(found.masks),
            self.mask,
            np.array(numbers)[order],
            phases,
            statistics.mean(found.log2_areas, counts),
            statistics.deviation(found.log2_areas, counts),
            found.drift,
            np.array(changes),
            self.settings.bound,
        )

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
        with writing_in(self.folder):
            folder.mkdir(parents=True, exist_ok=True)
        return folder


def _add(sums: Sequence[Moments], there: OnTemplate, weight: float, middles: FloatArray) -> None:
    """Add a subject's values, by channels, less their middles (C,)."""
    for moments, values, middle in zip(sums, there.values.T, middles, strict=True):
        shares = weight * np.where(np.isfinite(values), there.mask, 0)
        moments.add(values - middle, shares)
