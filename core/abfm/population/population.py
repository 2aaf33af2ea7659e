"""Result of registering a population: means, variability and values of each subject."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from abfm.calculus.operators import vertex_areas
from abfm.display import Display
from abfm.errors import ParameterError, ResultError, brief, did_you_mean, one_line
from abfm.io import results
from abfm.io.results import Entry, FileKind
from abfm.mesh import TriangleMesh
from abfm.outcome import Facts, Outcome
from abfm.population import statistics
from abfm.population.on_template import MapFacts
from abfm.population.settings import CHANGE_BOUND
from abfm.population.statistics import LeaveOneOut, Phase, Shares
from abfm.population.subjects import Channel
from abfm.types import BoolArray, FloatArray
from abfm.wording import counted

_NUMBERS = ("correlation", "distance", "log2_area", *MapFacts._fields)
_VALUE_MAX = results.SIZE_MAX
_TEXT_ENTRY = Entry("text", ("N",))
_NAN_ALLOWED = {"allow_missing": True}
_MAPPED = {"is_mapped": True}
_VALUES = Entry(
    "real", ("N", "V", "C"), low=-_VALUE_MAX, high=_VALUE_MAX, **_NAN_ALLOWED, **_MAPPED
)
_MASKS = Entry("real", ("N", "V"), low=0, **_MAPPED)
POPULATION = FileKind(
    "population file",
    results.MESH_ENTRIES
    | {
        "names": _TEXT_ENTRY,
        "reasons": _TEXT_ENTRY,
        "verdicts": _TEXT_ENTRY,
        "digests": _TEXT_ENTRY,
        "subject_weights": Entry("real", ("N",), low=0),
        "fits": Entry("boolean", ("N",)),
        "channels": Entry("text", ("C",)),
        "held_out": Entry("boolean", ("C",)),
        "channel_weights": Entry("real", ("C",), low=0),
        "before": _VALUES,
        "values": _VALUES,
        "masks_before": _MASKS,
        "masks": _MASKS,
        "template_mask": Entry("real", ("V",), low=0),
        "phases": Entry("real", ("C", len(Phase._fields)), **_NAN_ALLOWED),
        "log2_area_mean": Entry("real", ("F",), **_NAN_ALLOWED),
        "log2_area_deviation": Entry("real", ("F",), **_NAN_ALLOWED),
        "drift": Entry("real", ("F", 3)),
        "changes": Entry("real", ("R",), low=0, **_NAN_ALLOWED),
        "bound": Entry("real", (), low=0),
        # the last entry is required: a damaged zip directory can hide the last entry
        "numbers": Entry("real", ("N", len(_NUMBERS)), **_NAN_ALLOWED),
    },
)


@dataclass(frozen=True, eq=False)
class Population(Display):
    """Subjects registered to a template, and their values on it.

    A subject is included in means and standard deviations unless it is an outlier or its
    registration failed.

    Attributes
    ----------
    template : TriangleMesh
        Surface with V vertices and F faces.
    channels : tuple of Channel
        The C functions of each subject, used for registration or held out.
    names : tuple of str
        Names of the N subjects.
    weights : (N,) array
        Weight of each subject in means, if it is included.
    channel_weights : (C,) array
        Weight of each channel in the registrations; 0 if it is held out.
    fits : (N,) array of bool
        Whether each subject is included in the mean.
    reasons : tuple of str
        Reason for the exclusion of each subject, in one line; empty if it is included.
    verdicts : tuple of str
        Kind of the verdict of each registration of the last round, see `abfm.Match.verdict`.
    digests : tuple of str
        Digest of each registration of the last round, which is stored in ``<digest>.npz``; empty if
        it failed.
    before, values : (N, V, C) arrays
        Values of the subjects on the template, by their initial maps and after registration. NaN if
        a channel is unknown or a subject could not be registered.
    masks_before, masks : (N, V) arrays
        Mask of each subject, transferred to the template by the same maps.
    template_mask : (V,) array
        Weight of the vertices of the template.
    numbers : (N, 7) array
        Measures of each subject. The columns are the properties ``correlation``, ``distance``,
        ``log2_area``, ``folded``, ``residual``, ``displacement`` and ``landmarks``.
    phases : (C, 4) array
        Result of `phase_and_amplitude` for each channel: total, phase, amplitude and factor.
    log2_area_mean, log2_area_deviation : (F,) arrays
        Mean and standard deviation over included subjects of log2 J. J is the area of a face on the
        subject divided by its area on the template, with both surfaces scaled to unit area.
    drift : (F, 3) array
        Mean field of the registrations of the last round, subtracted from each of their fields.
    changes : (R,) array
        Change of the mean in each of R rounds: the L2 norm of its difference from the previous
        mean. It is divided by the L2 norm of the mean minus its average over the surface.
    bound : float
        Change of the mean, in the same measure, below which the rounds stop.
    """

    template: TriangleMesh
    channels: tuple[Channel, ...]
    names: tuple[str, ...]
    weights: FloatArray = field(repr=False)
    channel_weights: FloatArray = field(repr=False)
    fits: BoolArray = field(repr=False)
    reasons: tuple[str, ...] = field(repr=False)
    verdicts: tuple[str, ...] = field(repr=False)
    digests: tuple[str, ...] = field(repr=False)
    before: FloatArray = field(repr=False)
    values: FloatArray = field(repr=False)
    masks_before: FloatArray = field(repr=False)
    masks: FloatArray = field(repr=False)
    template_mask: FloatArray = field(repr=False)
    numbers: FloatArray = field(repr=False)
    phases: FloatArray = field(repr=False)
    log2_area_mean: FloatArray = field(repr=False)
    log2_area_deviation: FloatArray = field(repr=False)
    drift: FloatArray = field(repr=False)
    changes: FloatArray = field(repr=False)
    bound: float = CHANGE_BOUND

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if isinstance(value, np.ndarray):
                view = value.view()
                view.flags.writeable = False
                object.__setattr__(self, name, view)

    @property
    def correlation(self) -> FloatArray:
        """Correlation of each subject with the mean of the other included subjects, (N,).

        The correlation is a weighted mean over the channels that were used for registration.
        """
        return self._number("correlation")

    @property
    def distance(self) -> FloatArray:
        """L2 distance of each subject to the mean of the other included subjects, (N,).

        The distance is divided by the L2 norm of that mean minus its average over the surface.
        """
        return self._number("distance")

    @property
    def log2_area(self) -> FloatArray:
        """Mean ``|log2 J|`` of the map of each subject, (N,)."""
        return self._number("log2_area")

    @property
    def folded(self) -> FloatArray:
        """Fraction of the faces, 0 to 1, that each registration's flow folds, (N,), or NaN."""
        return self._number("folded")

    @property
    def displacement(self) -> FloatArray:
        """RMS of each subject's displacement minus the mean field, (N,), in sqrt(area)."""
        return self._number("displacement")

    @property
    def residual(self) -> FloatArray:
        """Residual of each registration, (N,): discrete or flow-line residual, the larger one."""
        return self._number("residual")

    @property
    def landmarks(self) -> FloatArray:
        """Mean landmark error on the template, (N,), in sqrt(area); NaN without landmarks."""
        return self._number("landmarks")

    @property
    def headline(self) -> str:
        """One line with the number of included subjects and the last change of the mean."""
        rounds = counted(len(self.changes), "round")
        return (
            f"{np.count_nonzero(self.fits)} of {len(self.names)} subjects included; the mean "
            f"changed by {self.changes[-1]:.2g} of its standard deviation in the last of {rounds}"
        )

    @property
    def facts(self) -> Facts:
        """Outcome, headline, reason, advice and warnings of the population."""
        advice, limit = "", f"{self.bound:g} of its standard deviation"
        if not all(self.digests):
            outcome, reason = Outcome.FAILED, "a subject could not be registered"
        elif self.changes[-1] <= self.bound:
            outcome = Outcome.REGISTERED
            reason = f"the mean changed by at most {limit} in the last round"
        else:
            outcome = Outcome.NOT_REACHED
            reason = f"the mean changed by more than {limit} in the last round"
            advice = "allow more rounds; they continue from these results"
        outliers = [
            f"excluded: {one_line(self.names[i])}: {self.reasons[i]}"
            for i in self.worst_first()
            if not self.fits[i]
        ]
        topics = (str(outcome), *([Outcome.OUTLIER] if outliers else []))
        warnings = tuple(outliers)
        return Facts(outcome, self.headline, reason, advice, warnings=warnings, topics=topics)

    @property
    def main_channel(self) -> int:
        """Index of the first channel that was used for registration."""
        return int(np.flatnonzero(self.channel_weights)[0])

    def mean(self, channel: str | int = 0) -> FloatArray:
        """Return the mean of a channel, by name or index, over included subjects, (V,).

        The value is NaN where no subject is known.
        """
        return statistics.mean(*self._registered(channel))

    def deviation(self, channel: str | int = 0) -> FloatArray:
        """Return the standard deviation of a channel over included subjects, (V,).

        It is the root of the unbiased variance; NaN where fewer than two subjects are known.
        """
        return statistics.deviation(*self._registered(channel))

    def plain_mean(self, channel: str | int = 0) -> FloatArray:
        """Return the mean of a channel over included subjects before registration, (V,)."""
        return statistics.mean(*self._initial(channel))

    def mean_of_others(self, subject: int, channel: str | int = 0) -> FloatArray:
        """Return the mean of a channel over the included subjects except one, (V,)."""
        return LeaveOneOut.of(*self._registered(channel)).without(subject)

    def scores(self, channel: str | int = 0) -> FloatArray:
        """Return the correlation of each subject with the mean of other included subjects, (N, 2).

        Column 0 is before registration (by the initial maps), column 1 is after it. For a held-out
        channel their difference measures the benefit of registration.
        """
        found, areas = [], self.areas
        initial, registered = self._initial(channel), self._registered(channel)
        for (values, shares), masks in ((initial, self.masks_before), (registered, self.masks)):
            others = LeaveOneOut.of(values, shares)
            each = (
                (values[i], others.without(i), areas * (masks[i] > 0)) for i in range(len(values))
            )
            found.append([statistics.correlation(*pair) for pair in each])
        return np.array(found).T

    def phase_and_amplitude(self, channel: str | int = 0) -> Phase:
        """Split the variance of a channel over subjects: phase (position) and amplitude (value).

        Only included subjects count. The split is computed at the midpoints of edges, see
        ``abfm.population.statistics.phase_and_amplitude``.
        """
        return Phase(*self.phases[self._channel(channel)].tolist())

    @property
    def areas(self) -> FloatArray:
        """Areas of the template's vertices, multiplied by its mask, (V,)."""
        return np.asarray(vertex_areas(self.template) * self.template_mask)

    def subject(self, name: str) -> int:
        """Return the index of the subject with this name, or raise a ParameterError."""
        if name not in self.names:
            raise ParameterError(
                f"there is no subject {brief(name)}{did_you_mean(name, self.names)}"
            )
        return self.names.index(name)

    def worst_first(self) -> list[int]:
        """Return the indices of subjects, excluded ones first, then by ascending correlation."""
        correlation = np.nan_to_num(self.correlation, nan=-2)
        return [int(i) for i in np.lexsort((np.array(self.names), correlation, self.fits))]

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write a file (``.npz``, no pickles), completely or not at all, or raise ResultError."""
        names = POPULATION.entries.keys() - results.MESH_ENTRIES.keys()
        arrays = {name: getattr(self, name) for name in names if hasattr(self, name)}
        arrays |= {
            "channels": np.array([channel.name for channel in self.channels]),
            "held_out": np.array([channel.is_held_out for channel in self.channels]),
            "subject_weights": self.weights,
        }
        arrays = {name: arrays[name] for name in POPULATION.entries if name in arrays}
        results.save_arrays(path, results.mesh_arrays(self.template) | arrays, POPULATION)

    def _number(self, name: str) -> FloatArray:
        return np.asarray(self.numbers[:, _NUMBERS.index(name)])

    def _initial(self, channel: str | int) -> tuple[FloatArray, Shares]:
        return self._values_and_shares(self.before, self.masks_before, channel)

    def _registered(self, channel: str | int) -> tuple[FloatArray, Shares]:
        return self._values_and_shares(self.values, self.masks, channel)

    def _values_and_shares(
        self, values: FloatArray, masks: FloatArray, channel: str | int
    ) -> tuple[FloatArray, Shares]:
        arrays = values[:, :, self._channel(channel)]
        return arrays, Shares(self.weights * self.fits, masks, arrays)

    def _channel(self, channel: str | int) -> int:
        names = [each.name for each in self.channels]
        if isinstance(channel, str) and channel in names:
            return names.index(channel)
        if isinstance(channel, int) and 0 <= channel < len(names):
            return channel
        raise ParameterError(
            f"there is no channel {brief(channel)}; expected one of "
            f"{', '.join(one_line(name, 30) for name in names[:8])}"
        )


def load_population(path: str | os.PathLike[str]) -> Population:
    """Load a file of `abfm.Population.save`, or the one in a folder of results.

    The values and masks of the subjects stay in the file and are memory-mapped.

    Raises
    ------
    ResultError
        If the file is missing or damaged, or contains no population.
    """
    if Path(path).is_dir():
        folder, path = path, Path(path) / "population.npz"
        if not path.is_file():
            raise ResultError(
                f"the folder {results.name_of(folder)} has no file population.npz; expected the "
                "folder of a population, or the file of one of its results"
            )
    return results.loaded(path, POPULATION, _population_of)


def _population_of(arrays: dict[str, Any]) -> Population:
    template = results.mesh_of(arrays)
    for name in results.MESH_ENTRIES:
        arrays.pop(name, None)
    pairs = zip(arrays.pop("channels").tolist(), arrays.pop("held_out").tolist(), strict=True)
    names = "names", "reasons", "verdicts", "digests"
    texts: dict[str, Any] = {name: tuple(arrays.pop(name).tolist()) for name in names}
    bound = float(arrays.pop("bound"))
    weights, channels = arrays.pop("subject_weights"), tuple(Channel(*pair) for pair in pairs)
    return Population(template, channels, weights=weights, bound=bound, **texts, **arrays)
