"""Steps of the registration of a population: targets, registrations, transfer, and means."""

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
from abfm.functions.missing_values import filled, known_functions
from abfm.io import write_atomically, writing_in
from abfm.mesh import MeshLike, TriangleMesh, as_mesh, load_mesh
from abfm.mesh.options import read_flag
from abfm.parameters import Parameters
from abfm.population import statistics
from abfm.population.on_template import MapFacts, TemplateValues, checked_mask, displacement_in
from abfm.population.outliers import ComparisonData, Similarity, find_outliers, repeated_outliers
from abfm.population.population import Population
from abfm.population.round_result import ArrayStack, RoundResult
from abfm.population.settings import Settings
from abfm.population.statistics import LeaveOneOut, Moments, Shares, phase_and_amplitude
from abfm.population.subject_transfer import SubjectTransfer, TransferredSubject
from abfm.population.subjects import Cohort, Subject
from abfm.population.target import Target
from abfm.reading import side_of
from abfm.sequences.noise import noise
from abfm.tasks.inputs import MESH_INPUTS, absolute, mesh_options
from abfm.types import BoolArray, FloatArray, IntArray
from abfm.wording import counted
from abfm.workers.control import checkpoint, current_control
from abfm.workers.progress import step

_TARGETS = "targets"  # subfolder of templates, target functions and mean fields
_OUTLIER_PASSES_MAX = 3  # searches for outliers in a round, each with the latest mean field
_NOISE_SUBJECTS = 3  # number of subjects from whose functions the noise is estimated
_FUNCTION_METHODS = "embedding", "landmarks"  # initial maps that need functions or landmarks


class PopulationSolver:
    """Computations of all rounds and their shared data; the thread's `Control` can cancel them."""

    def __init__(
        self, cohort: Cohort, template: MeshLike, folder: Path, settings: Settings, workers: Workers
    ) -> None:
        self.cohort, self.settings, self._workers = cohort, settings, workers
        self.folder = Path(os.path.abspath(os.path.expanduser(folder)))
        options = {name: str(value) for name, value in settings.options.items()}
        self.mesh_values = {
            each.name: each.read(options[each.name]) for each in MESH_INPUTS if each.name in options
        }
        self.path = self._template_file(template)
        self.template = self._mesh(self.path)
        names = [cohort.channels[c].name for c in cohort.registered_channels]
        for noun, given in (("function", settings.functions), ("weight", settings.weights)):
            for name in given:
                if name not in names:
                    raise ParameterError(
                        f"a {noun} is given for {brief(name)}, which is not a channel used for "
                        f"registration{did_you_mean(name, names)}"
                    )
        if missing := [
            name for name in names if settings.functions and not settings.functions.get(name)
        ]:
            raise ParameterError(
                f"the template has no function {brief(missing[0])}; give one for each channel "
                "used for registration, or none"
            )
        self.channel_weights = [float(settings.weights.get(name, 1.0)) for name in names]
        self.mask = checked_mask(self.template, settings.mask, "the template")
        self.areas = vertex_areas(self.template) * self.mask
        self.weights = np.array([subject.weight for subject in cohort.subjects])

    def _mesh(self, path: str) -> TriangleMesh:
        return load_mesh(path, **mesh_options(self.mesh_values).changed)

    def _template_file(self, template: MeshLike) -> str:
        """Return the path of the template's mesh file; write one if the template is not a file.

        It has all vertices of the input, so that functions and vertex numbers fit.
        """
        if isinstance(template, str | os.PathLike):
            return os.path.abspath(os.path.expanduser(template))
        is_checked = isinstance(template, TriangleMesh)
        options = {} if is_checked else mesh_options(self.mesh_values).changed
        mesh = as_mesh(template, "template", **options)
        vertices, faces = mesh.on_file(mesh.vertices, 0.0), mesh.vertex_ids[mesh.faces]
        side = side_of(mesh.structure)
        name = f"template-{mesh.digest[:16]}{f'_hemi-{side}' if side else ''}.off"
        path = self._targets_folder() / name
        with (
            write_atomically(path) as temporary,
            temporary.open("w", encoding="ascii", newline="\n") as file,
        ):
            file.write(f"OFF\n{len(vertices)} {len(faces)} 0\n")
            np.savetxt(file, vertices, "%.17g")
            np.savetxt(file, faces, "3 %d %d %d")
        return os.fspath(path)

    @cached_property
    def goal(self) -> float:
        """Residual at which registrations may stop, for options without ``goal``.

        It is at least the noise of the functions of the first three subjects. It has no effect on
        functions that count as measured; those on coarse meshes do not.
        """
        levels = []
        for subject in self.cohort.subjects[:_NOISE_SUBJECTS]:
            with suppress(AbfmError):  # the registration reports this error
                mesh = self._mesh(subject.surface or self.path)
                texts = [subject.functions[c] for c in self.cohort.registered_channels]
                mask = checked_mask(mesh, subject.mask, subject.name)
                f = filled(mesh, *known_functions(mesh, texts, subject.name, mask))
                sizes = f.std(axis=1)
                if sizes.all():  # if all functions are constant, the registrations report it
                    levels.append(float(np.sqrt(np.mean((noise(mesh, f) / sizes) ** 2))))
        # at most 1, since above it the noise exceeds the functions
        return min(max(Parameters.goal, float(np.median(levels or [0.0]))), 1.0)

    def first_target(self) -> Target:
        """Return the functions of the template or, without them, those of a typical subject.

        It is the subject most similar to the plain mean before registration. That mean itself is
        not the target, because it is blurred.
        """
        given = self.settings.functions
        channels = self.cohort.registered_channels
        if given:
            texts = [given[self.cohort.channels[c].name] for c in channels]
            functions, known = known_functions(self.template, texts, "the template", self.mask)
            functions = filled(self.template, functions, known)
            return Target(functions, np.where(known, self.mask, 0))
        self._refuse_maps_by_functions()
        if np.count_nonzero(self.weights) < 2:
            raise ParameterError(
                "only one subject has a positive weight; give another subject a positive weight, "
                "or give functions of the template"
            )
        tasks = [self._initial_transfer(subject) for subject in self.cohort.subjects]
        stacks, failures = [ArrayStack(self._targets_folder()) for _ in range(2)], list[str]()
        with closing(self._transfer(tasks, "comparing")) as answers:
            for answer in answers:
                # registrations report these failures again
                failures.append(answer.record.reason)
                subject = self._unknown_subject() if answer.value is None else answer.value
                for stack, array in zip(stacks, subject.before, strict=True):
                    stack.add(array)
        values, masks = (stack.array() for stack in stacks)
        outliers = find_outliers(self._comparison_data(values, masks), None, failures)
        correlations = np.array([each.correlation for each in outliers.similarities])
        can_be_target = outliers.fits & (self.weights > 0) & np.isfinite(correlations)
        best = int(np.argmax(np.where(can_be_target, correlations, -math.inf)))
        if not can_be_target[best]:
            reason = next(filter(None, outliers.reasons), "their functions are not similar")
            raise ParameterError(
                f"no subject can be the first target: {reason}. Give functions of the template"
            )
        functions = values[best][:, channels].T
        return Target.from_partial(self.template, functions, masks[best] * self.mask)

    def _refuse_maps_by_functions(self) -> None:
        method = self.settings.initial.partition(":")[0]
        if method in _FUNCTION_METHODS and not all(each.landmarks for each in self.cohort.subjects):
            needs = "landmarks" if method == "landmarks" else "functions of both surfaces"
            raise ParameterError(
                f"the initial map {brief(self.settings.initial)} needs {needs}. Give a function of "
                "the template for each channel (--channel NAME SPEC 1), landmarks of each subject, "
                "or another initial map"
            )

    def _comparison_data(self, values: FloatArray, masks: FloatArray) -> ComparisonData:
        matched = [values[:, :, c] for c in self.cohort.registered_channels]
        return ComparisonData(matched, masks, self.weights, self.areas, self.channel_weights)

    def _unknown_subject(self) -> TransferredSubject:
        """Return the values of a subject that could not be transferred: all are unknown."""
        count = len(self.template.vertices)
        values = np.full((count, len(self.cohort.channels)), np.nan)
        nothing = TemplateValues(values, np.zeros(count))
        return TransferredSubject(nothing, nothing, np.full(len(self.template.faces), np.nan))

    def rows(self, target: Target, number: int) -> list[Row]:
        """Write the target of round ``number`` to files; return a batch row for each subject."""
        targets = [
            self._write_function(f"round-{number}-{c}", values)
            for c, values in enumerate(target.functions, 1)
        ]
        mask = None
        if (target.mask != 1).any():
            mask = self._write_function(f"round-{number}-mask", target.mask)
        return [self._row(subject, targets, mask) for subject in self.cohort.subjects]

    def register_all(
        self, target: Target, number: int, on_change: Callable[[LedgerEntry], object]
    ) -> list[LedgerEntry]:
        """Register all subjects to the target of round ``number``; return their ledger entries."""
        rows, ledger = self.rows(target, number), Ledger(self.folder)
        ledger.make()
        ledger.write_rows(rows, f"round {number} of a population")  # read by `abfm batch --status`
        with step("registering", len(rows), f" {counted(len(rows), 'subject')}") as done:
            done(0.0)
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

    def _transfer(
        self, tasks: Sequence[SubjectTransfer], label: str
    ) -> Generator[Answer, None, None]:
        with step(label, len(tasks), f" {counted(len(tasks), 'subject')}") as done:
            for count, answer in enumerate(self._workers.compute(tasks, current_control()), 1):
                yield answer
                done(count / len(tasks))
        checkpoint()

    def _row(self, subject: Subject, targets: Sequence[str], mask: str | None) -> Row:
        sources = [subject.functions[c] for c in self.cohort.registered_channels]
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

    def _initial_transfer(self, subject: Subject) -> SubjectTransfer:
        is_one_based = read_flag(str(self.settings.options.get("one-based") or "no"))
        initial, cwd = self.settings.initial, os.getcwd()
        one = SubjectTransfer(subject, self.path, self.mesh_values, initial, is_one_based)
        return one.renamed(absolute(cwd))

    def _registered_transfer(
        self, subject: Subject, entry: LedgerEntry, drift: str, at_edges: bool = False
    ) -> SubjectTransfer:
        """Return the transfer of a subject by its registration and the mean field in a file."""
        first, path = self._initial_transfer(subject), os.fspath(entry.path or "")
        return replace(first, initial="", registration=path, drift=drift, at_edges=at_edges)

    def round(
        self, entries: Sequence[LedgerEntry], before: Sequence[BoolArray], number: int
    ) -> RoundResult:
        """Transfer all subjects to the template, corrected by the mean field, and find outliers.

        ``entries`` are the registrations of round ``number``, and ``before`` the included subjects
        (N,) of each previous round. The mean field is that of the subjects included last; in round
        1 it is that of all registered subjects. The transfer is repeated if the included subjects
        change.
        """
        failures = [
            "" if entry.path else f"its registration failed: {entry.reason or 'there is no result'}"
            for entry in entries
        ]
        is_registered = np.array([not each for each in failures])
        self._require_two(failures)
        fits, stays_excluded = is_registered, np.zeros_like(is_registered)
        if before:
            fits, stays_excluded = is_registered & before[-1], repeated_outliers(before)
        found = None
        for _ in range(_OUTLIER_PASSES_MAX):
            found = self._evaluate(entries, fits, failures, number, stays_excluded)
            if (found.outliers.fits == fits).all():
                break
            fits = found.outliers.fits
        assert found is not None
        if not (found.outliers.fits & (self.weights > 0)).any():
            example = f"{one_line(self.cohort.subjects[0].name, 60)}: {found.outliers.reasons[0]}"
            raise ResultError(f"all subjects are excluded, for example {example}")
        return found

    def _require_two(self, failures: Sequence[str]) -> None:
        count = sum(not each for each in failures)
        if count < 2:
            failure = next(each for each in failures if each)
            name = one_line(self.cohort.subjects[failures.index(failure)].name, 60)
            raise ResultError(
                f"only {count} of {len(failures)} subjects could be registered; expected at least "
                f"2. {name}: {failure}"
            )

    def _mean_field(self, entries: Sequence[LedgerEntry], fits: BoolArray) -> FloatArray:
        total, weight = np.zeros((len(self.template.faces), 3)), 0.0
        for entry, counts, each in zip(entries, fits, self.weights, strict=True):
            if entry.path is not None and counts and each:
                checkpoint()
                total, weight = total + each * displacement_in(entry.path), weight + each
        return total / weight if weight else total

    def _evaluate(
        self,
        entries: Sequence[LedgerEntry],
        fits: BoolArray,
        failures: Sequence[str],
        number: int,
        stays_excluded: BoolArray,
    ) -> RoundResult:
        drift = self._mean_field(entries, fits)
        drift_file = self._write_array(f"round-{number}-drift", drift)
        known = [i for i, entry in enumerate(entries) if entry.path is not None]
        subjects = self.cohort.subjects
        tasks = [self._registered_transfer(subjects[i], entries[i], drift_file) for i in known]
        stacks = [ArrayStack(self._targets_folder()) for _ in range(5)]
        failures, others = list(failures), list[tuple[str, MapFacts, Similarity]]()
        areas = face_areas(self.template)
        with closing(self._transfer(tasks, "transferring")) as answers:
            for i, entry in enumerate(entries):
                each = self._unknown_subject()
                if entry.path is not None:
                    answer = next(answers)
                    each = answer.value or each
                    if answer.value is None:
                        failures[i] = f"its transfer to the template failed: {answer.record.reason}"
                assert each.after is not None
                assert each.log2_area is not None
                arrays = (*each.before, *each.after, each.log2_area)
                for stack, array in zip(stacks, arrays, strict=True):
                    stack.add(array)
                changed = float(np.average(np.abs(each.log2_area), weights=areas))
                like = Similarity(math.nan, math.nan, changed, each.facts.folded)
                others.append((each.verdict, each.facts, like))
        self._require_two(failures)
        before, masks_before, after, masks, log2_areas = (stack.array() for stack in stacks)
        verdicts, facts, maps = zip(*others, strict=True)
        with step("summing", about=f" {counted(len(tasks), 'subject')}"):
            data = self._comparison_data(after, masks)
            outliers = find_outliers(data, maps, failures, stays_excluded)
        pairs = zip(failures, entries, strict=True)
        digests = ["" if failure else entry.digest for failure, entry in pairs]
        return RoundResult(
            outliers,
            before,
            masks_before,
            after,
            masks,
            log2_areas,
            drift,
            drift_file,
            verdicts,
            tuple(digests),
            facts,
        )

    def shares(self, found: RoundResult, masks: FloatArray) -> Shares:
        return Shares(self.weights * found.outliers.fits, masks)

    def target(self, found: RoundResult) -> Target:
        """Return the mean of the included subjects, as the target of the next round."""
        shares = self.shares(found, found.masks)
        channels = self.cohort.registered_channels
        others = [LeaveOneOut.of(found.after[:, :, c], shares) for c in channels]
        means = np.stack([each.mean() for each in others])
        return Target.from_partial(self.template, means, self.mask * (others[0].total > 0))

    def _channel_means(self, found: RoundResult) -> FloatArray:
        channel_means = []
        for c in range(len(self.cohort.channels)):
            values = found.before[:, :, c]
            fits = self.weights * found.outliers.fits
            mean = statistics.mean(values, Shares(fits, found.masks_before, values))
            known = np.where(np.isfinite(mean), self.areas, 0)
            channel_means.append(known @ np.nan_to_num(mean) / known.sum() if known.any() else 0.0)
        return np.array(channel_means)

    def phases(self, entries: Sequence[LedgerEntry], found: RoundResult) -> FloatArray:
        """Return total, phase, amplitude and factor of the variance of each channel, (C, 4).

        They are computed at the midpoints of edges, see `statistics.phase_and_amplitude`. There,
        values are means of two vertices before registration, and of two or three after it. Both
        smooth noise in a similar way.
        """
        ends = self.template.edges
        areas = edge_areas(self.template) * self.mask[ends].mean(axis=1)
        channel_means = self._channel_means(found)
        sums = [[Moments.at(len(ends)) for _ in channel_means] for _ in range(2)]
        included = np.flatnonzero(found.outliers.fits & (self.weights > 0)).tolist()
        tasks = [
            self._registered_transfer(self.cohort.subjects[i], entries[i], found.drift_file, True)
            for i in included
        ]
        with closing(self._transfer(tasks, "splitting the variance")) as answers:
            for i in included:
                answer = next(answers)
                if answer.value is None:
                    name = one_line(self.cohort.subjects[i].name, 60)
                    reason = answer.record.reason
                    raise ResultError(f"the transfer of {name} to the template failed: {reason}")
                for part, transferred in zip(sums, answer.value[:2], strict=True):
                    _add(part, transferred, self.weights[i], channel_means)
        return np.array([phase_and_amplitude(x, y, areas) for x, y in zip(*sums, strict=True)])

    def population(
        self, found: RoundResult, changes: Sequence[float], phases: FloatArray, order: IntArray
    ) -> Population:
        """Return the population after the last round, with the subjects in the table's order.

        ``order`` (N,) has the index in the cohort, which is sorted by name, for each of them.
        """
        cohort, outliers = self.cohort, found.outliers
        channel_weights = np.zeros(len(cohort.channels))
        channel_weights[cohort.registered_channels] = self.channel_weights
        numbers = [
            [like.correlation, like.distance, like.log2_area, *facts]
            for like, facts in zip(outliers.similarities, found.facts, strict=True)
        ]
        everywhere = [np.ones(len(self.template.faces))] * len(cohort.subjects)
        counts = Shares(self.weights * outliers.fits, everywhere)

        def ordered(texts: Sequence[str]) -> tuple[str, ...]:
            return tuple(texts[i] for i in order)

        def stacked(arrays: FloatArray) -> FloatArray:
            if (order == np.arange(len(order))).all():
                return arrays
            stack = ArrayStack(self._targets_folder())
            for i in order:
                stack.add(arrays[i])
            return stack.array()

        return Population(
            self.template,
            cohort.channels,
            ordered([subject.name for subject in cohort.subjects]),
            self.weights[order],
            channel_weights,
            outliers.fits[order],
            ordered(outliers.reasons),
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

    def _write_function(self, name: str, values: FloatArray) -> str:
        """Write values (V,) to a file; return the function specification that reads them."""
        return f"file:{quoted(self._write_array(name, values))}"

    def _write_array(self, name: str, values: FloatArray) -> str:
        """Write an array to a file, whose name has a hash of the values; return the path.

        The hash distinguishes the files of several runs in the same folder.
        """
        content = hashlib.sha256(np.ascontiguousarray(values).tobytes()).hexdigest()
        path = self._targets_folder() / f"{name}-{content[:16]}.npy"
        with write_atomically(path) as temporary:
            np.save(temporary, values)
        return os.fspath(path)

    def _targets_folder(self) -> Path:
        folder = self.folder / _TARGETS
        with writing_in(self.folder):
            folder.mkdir(parents=True, exist_ok=True)
        return folder


def _add(
    sums: Sequence[Moments], transferred: TemplateValues, weight: float, channel_means: FloatArray
) -> None:
    """Add a subject's values, minus the channel means (C,), to the moments of each channel."""
    for moments, values, mean in zip(sums, transferred.values.T, channel_means, strict=True):
        shares = weight * np.where(np.isfinite(values), transferred.mask, 0)
        moments.add(values - mean, shares)
