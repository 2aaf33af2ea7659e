"""A population on a template: its means, how it varies, and what each subject is like."""

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
from abfm.population.settings import BOUND
from abfm.population.statistics import Others, Phase, Shares
from abfm.population.subjects import Channel
from abfm.types import BoolArray, FloatArray
from abfm.wording import counted

_NUMBERS = ("correlation", "distance", "log2_area", *MapFacts._fields)
_VALUE_MAX = results.SIZE_MAX
_TEXT_ENTRY = Entry("text", ("N",))
_NAN_ALLOWED = {"may_be_unknown": True}
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
        # the last one is required: damage to a zip's directory can hide the last entry
        "numbers": Entry("real", ("N", len(_NUMBERS)), **_NAN_ALLOWED),
    },
)


@dataclass(frozen=True, eq=False)
class Population(Display):
    """Subjects registered to a template, and their values on it.

    Attributes
    ----------
    template : TriangleMesh
        Of V vertices and F faces.
    channels : tuple of Channel
        C functions, by which subjects were registered, or held out.
    names : tuple of str
        Of the N subjects.
    weights : (N,) array
        How much each counts in means, if it fits.
    channel_weights : (C,) array
        How much each channel counted; 0 where it is held out.
    fits : (N,) array of bool
        Who counts in the mean.
    reasons : tuple of str
        Why a subject does not fit, a line each; empty where it does.
    verdicts : tuple of str
        What each registration of the last round came to, see `abfm.Match.verdict`.
    digests : tuple of str
        The names of the files of these registrations, ``<digest>.npz``; empty where one failed.
    before, values : (N, V, C) arrays
        The subjects' values on the template by their initial maps, and registered; NaN where a
        channel is not known, or a subject could not be registered.
    masks_before, masks : (N, V) arrays
        How much each subject is known at each vertex, by its mask, carried alike.
    template_mask : (V,) array
        How much vertices of the template count.
    numbers : (N, 7) array
        For each subject what ``correlation``, ``distance``, ``log2_area``, ``folded``,
        ``residual``, ``displacement`` and ``landmarks`` are.
    phases : (C, 4) array
        For each channel what `phase_and_amplitude` tells.
    log2_area_mean, log2_area_deviation : (F,) arrays
        Mean and standard deviation over those who fit of log2 J, with J the area of a face where it
        lies on a subject over its own, both surfaces scaled to unit area.
    drift : (F, 3) array
        The mean field that was taken off in the last round.
    changes : (R,) array
        How much the mean changed in each round, over its deviation, in L2.
    bound : float
        The change of the mean at which the rounds end.
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
    bound: float = BOUND

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if isinstance(value, np.ndarray):
                view = value.view()
                view.flags.writeable = False
                object.__setattr__(self, name, view)

    @property
    def correlation(self) -> FloatArray:
        """Of each subject with the mean of the others that fit, (N,), mean over channels that it
        was registered by, by their weights.
        """
        return self._number("correlation")

    @property
    def distance(self) -> FloatArray:
        """From the mean of the others that fit, over its deviation, in L2, (N,)."""
        return self._number("distance")

    @property
    def log2_area(self) -> FloatArray:
        """Mean ``|log2 J|`` of each subject's map, (N,)."""
        return self._number("log2_area")

    @property
    def folded(self) -> FloatArray:
        """Share of the faces, 0 to 1, that each subject's flow folds, (N,); NaN if unknown."""
        return self._number("folded")

    @property
    def displacement(self) -> FloatArray:
        """How far the flow moves each subject, without what all move, (N,): root of the mean square
        over the surface, as a fraction of sqrt(area).
        """
        return self._number("displacement")

    @property
    def residual(self) -> FloatArray:
        """What each registration leaves, by the worse witness, (N,)."""
        return self._number("residual")

    @property
    def landmarks(self) -> FloatArray:
        """How far landmarks are left from their places on the template, (N,), on average, in
        sqrt(area); NaN where there are none.
        """
        return self._number("landmarks")

    @property
    def headline(self) -> str:
        """How many subjects fit, and how much the mean changed in the last round, in one line."""
        rounds = counted(len(self.changes), "round")
        return (
            f"{np.count_nonzero(self.fits)} of {len(self.names)} subjects fit; the mean changed by "
            f"{self.changes[-1]:.2g} of its deviation in the last of {rounds}"
        )

    @property
    def facts(self) -> Facts:
        """What is reported of the population: outcome, headline, reason, advice, warnings."""
        advice = ""
        if not all(self.digests):
            outcome, reason = Outcome.FAILED, "a subject could not be registered"
        elif self.changes[-1] <= self.bound:
            outcome, reason = Outcome.REGISTERED, "the mean hardly changed in the last round"
        else:
            outcome = Outcome.NOT_REACHED
            reason = f"the mean changed by more than {self.bound:g} in the last round"
            advice = "more rounds, which resume from these results"
        outliers = [
            f"left out: {one_line(self.names[i])}: {self.reasons[i]}"
            for i in self.worst_first()
            if not self.fits[i]
        ]
        return Facts(outcome, self.headline, reason, advice, warnings=tuple(outliers))

    @property
    def main_channel(self) -> int:
        """The number of the first channel that subjects were registered by."""
        return int(np.flatnonzero(self.channel_weights)[0])

    def mean(self, channel: str | int = 0) -> FloatArray:
        """The mean of a channel, by name or number, over those who fit, (V,); NaN where nobody is
        known.
        """
        return statistics.mean(*self._after(channel))

    def deviation(self, channel: str | int = 0) -> FloatArray:
        """The standard deviation over those who fit, (V,), the root of the unbiased variance; NaN
        where fewer than two are known.
        """
        return statistics.deviation(*self._after(channel))

    def plain_mean(self, channel: str | int = 0) -> FloatArray:
        """The mean by the initial maps, (V,)."""
        return statistics.mean(*self._before(channel))

    def mean_of_others(self, subject: int, channel: str | int = 0) -> FloatArray:
        """The mean of those who fit without a subject, (V,): what it is compared with."""
        return Others.of(*self._after(channel)).without(subject)

    def scores(self, channel: str | int = 0) -> FloatArray:
        """How each subject correlates with the mean of the others that fit, before and after it was
        registered, (N, 2): of a channel that is held out what registering is worth.
        """
        found = []
        for (values, shares), masks in (
            (self._before(channel), self.masks_before),
            (self._after(channel), self.masks),
        ):
            others = Others.of(values, shares)
            found.append(
                [
                    statistics.correlation(
                        values[i], others.without(i), self.areas * (masks[i] > 0)
                    )
                    for i in range(len(values))
                ]
            )
        return np.array(found).T

    def phase_and_amplitude(self, channel: str | int = 0) -> Phase:
        """How much of the variance over those who fit is position, and how much is value, by the
        points in the middles of edges, see `abfm.population.statistics.phase_and_amplitude`.
        """
        return Phase(*self.phases[self._channel(channel)].tolist())

    @property
    def areas(self) -> FloatArray:
        """Areas of the template's vertices, times its mask, (V,)."""
        return np.asarray(vertex_areas(self.template) * self.template_mask)

    def subject(self, name: str) -> int:
        """Return the number of a subject, or raise a ParameterError."""
        if name not in self.names:
            raise ParameterError(
                f"there is no subject {brief(name)}{did_you_mean(name, self.names)}"
            )
        return self.names.index(name)

    def worst_first(self) -> list[int]:
        """Return the subjects' numbers: first who does not fit, then by rising correlation, the
        least like first.
        """
        alike = np.nan_to_num(self.correlation, nan=-2)
        return [int(i) for i in np.lexsort((np.array(self.names), alike, self.fits))]

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write a file (``.npz``, no pickles), whole or not at all, or raise ResultError."""
        names = POPULATION.entries.keys() - results.MESH_ENTRIES.keys()
        own = {name: getattr(self, name) for name in names if hasattr(self, name)}
        own |= {
            "channels": np.array([channel.name for channel in self.channels]),
            "held_out": np.array([channel.is_held_out for channel in self.channels]),
            "subject_weights": self.weights,
        }
        own = {name: own[name] for name in POPULATION.entries if name in own}
        results.save_arrays(path, results.mesh_arrays(self.template) | own, POPULATION)

    def _number(self, name: str) -> FloatArray:
        return np.asarray(self.numbers[:, _NUMBERS.index(name)])

    def _before(self, channel: str | int) -> tuple[FloatArray, Shares]:
        return self._counted(self.before, self.masks_before, channel)

    def _after(self, channel: str | int) -> tuple[FloatArray, Shares]:
        return self._counted(self.values, self.masks, channel)

    def _counted(
        self, values: FloatArray, masks: FloatArray, channel: str | int
    ) -> tuple[FloatArray, Shares]:
        """Return values of a channel, (N, V), and how much each counts."""
        own = values[:, :, self._channel(channel)]
        return own, Shares(self.weights * self.fits, masks, own)

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
    """Read a file of `Population.save`, or that in a folder of results; ResultError if it is
    missing, damaged, or none. The subjects' values and masks stay in the file.
    """
    if Path(path).is_dir():
        folder, path = path, Path(path) / "population.npz"
        if not path.is_file():
            raise ResultError(
                f"{results.name_of(folder)} is a folder without population.npz; give a file of "
                "results in it"
            )
    return results.loaded(path, POPULATION, _population_of)


def _population_of(arrays: dict[str, Any]) -> Population:
    template = results.mesh_of(arrays)
    for name in results.MESH_ENTRIES:
        arrays.pop(name, None)
    pairs = zip(arrays.pop("channels").tolist(), arrays.pop("held_out").tolist(), strict=True)
    texts: dict[str, Any] = {
        name: tuple(arrays.pop(name).tolist())
        for name in ("names", "reasons", "verdicts", "digests")
    }
    bound = float(arrays.pop("bound"))
    weights, channels = arrays.pop("subject_weights"), tuple(Channel(*pair) for pair in pairs)
    return Population(template, channels, weights=weights, bound=bound, **texts, **arrays)
