"""Task of registering a population to a template."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from abfm.batch.cluster import Cluster
from abfm.batch.ledger import LedgerEntry
from abfm.errors import ColumnError, ParameterError, ResultError, brief, one_line, printable
from abfm.io import check_values_name
from abfm.matching.task import MAX_DISTORTION
from abfm.parameters import Parameters
from abfm.population import report
from abfm.population.population import Population, load_population
from abfm.population.rounds import register_population
from abfm.population.settings import CHANGE_BOUND, ROUNDS_DEFAULT, Settings
from abfm.population.subjects import Cohort, read_subjects
from abfm.registration.task import INITIAL_INPUT, ONE_BASED_INPUT
from abfm.tasks.inputs import (
    MESH_FORMATS,
    MESH_INPUTS,
    Input,
    Rename,
    channel_input,
    channel_weight,
    channel_words,
    file_input,
    mask_input,
    number_input,
    parameter_inputs,
    parameters_in,
    read_function,
    renamed_function,
)
from abfm.tasks.monitor import Monitor
from abfm.tasks.task import Export, Preview, Report, ResultFile, Table, Task, TaskInputs

ROUNDS_MAX = 1000
AUTO_TARGET = "auto"  # target of a channel whose function is chosen from the subjects
_CHANNEL = "NAME DST WEIGHT"
_MEAN = "template and mean"


def _channel(text: str) -> tuple[str, str, float]:
    name, target, weight = channel_words(text, _CHANNEL)
    return name, "" if target == AUTO_TARGET else read_function(target), channel_weight(weight)


def _renamed_channel(text: str, rename: Rename) -> str:
    name, target, weight = channel_words(text, _CHANNEL)
    if target != AUTO_TARGET:
        target = renamed_function(target, rename)
    return shlex.join((name, target, repr(channel_weight(weight))))


def _rounds(text: str) -> int:
    if not text.isdecimal() or not 1 <= int(text) <= ROUNDS_MAX:
        raise ParameterError(f"{brief(text)} is not an integer from 1 to {ROUNDS_MAX}")
    return int(text)


def _preview(path: Path) -> Preview:
    found = load_population(path)
    return Preview(found.template, [found.mean(), found.deviation()])


@dataclass(frozen=True)
class PopulationTask(Task):
    """Task of registering subjects to a template iteratively, and of computing their mean.

    The monitor's checkpoint is the folder into which the task writes the result and all
    registrations.
    """

    cohort: Cohort
    template: str  # path of the template's mesh file
    settings: Settings
    key: str  # hash of the inputs
    cluster: Cluster | None = None  # workers; by default the cores of this machine

    kind: ClassVar = "population"
    needs: ClassVar = ("table", "template")
    inputs: ClassVar = (
        file_input("table", "table of subjects, one per row", "SUBJECTS.csv", is_argument=True),
        file_input("template", f"template surface, a {MESH_FORMATS}", "SURFACE"),
        *MESH_INPUTS,
        channel_input(
            "channel for registration: column of the table; function of the template, or auto for "
            "all channels; weight above 0 (default: auto, 1)",
            _CHANNEL,
            _channel,
            _renamed_channel,
        ),
        mask_input("mask", "weight of each vertex of the template"),
        INITIAL_INPUT,
        number_input(
            "bound",
            "stop when the mean changes by less than this fraction of its standard deviation",
            "X",
            "above 0 and at most 1000",
            lambda bound: 1e-9 <= bound <= 1000,
            group=_MEAN,
            default=f"{CHANGE_BOUND:g}",
        ),
        Input(
            name="rounds",
            help="largest number of rounds",
            read=_rounds,
            metavar="N",
            group=_MEAN,
            default=str(ROUNDS_DEFAULT),
        ),
        MAX_DISTORTION,
        ONE_BASED_INPUT,
        *parameter_inputs(),
    )
    main_options: ClassVar = (
        *("channel", "mask", "initial"),
        *("bound", "rounds", "max-distortion", "set"),
    )
    result: ClassVar = Population
    file: ClassVar = ResultFile(
        frozenset({"subject_weights", "template_mask"}),
        load_population,
        lambda path: load_population(path).facts,
        _preview,
    )
    preview_labels: ClassVar = ("mean", "standard deviation")
    exports: ClassVar = {
        ".vtu": Export(report.export_mean_vtu),
        ".gii": Export(report.export_mean_values, check_values_name),
    }
    tables: ClassVar = {"subjects": Table("write a table of the subjects", report.export_subjects)}
    report: ClassVar = Report(report.details, report.lines)

    @classmethod
    def check(cls, values: Mapping[str, Any]) -> None:
        """Raise a ParameterError for inconsistent parameters and repeated names."""
        Parameters.of(**parameters_in(values))
        names = [name for name, *_ in values.get("channel", ())]
        for name in names:
            if names.count(name) > 1:
                raise ColumnError("channel", f": {one_line(name, 40)} is repeated")

    @classmethod
    def read(cls, given: TaskInputs) -> PopulationTask:
        values = given.values()
        channels = values.get("channel", ())
        options = {
            each.name: "auto" if values[each.name] is None else values[each.name]
            for each in (*parameter_inputs(), *MESH_INPUTS, MAX_DISTORTION, ONE_BASED_INPUT)
            if each.name in values
        }
        settings = Settings(
            {name: target for name, target, _ in channels if target},
            values.get("mask", ""),
            values.get("initial", ""),
            options,
            values.get("bound", CHANGE_BOUND),
            values.get("rounds", ROUNDS_DEFAULT),
            {name: weight for name, _, weight in channels},
        )
        return cls(read_subjects(values["table"]), values["template"], settings, given.key)

    def solve(self, monitor: Monitor) -> Population:
        """Return the population; if cancelled, raise CancelledError and preserve finished rows."""
        if monitor.checkpoint is None:
            raise ResultError(
                "a population needs a folder for its registrations; set the checkpoint "
                "of the monitor"
            )

        def report_failure(entry: LedgerEntry) -> None:
            if entry.reason:
                monitor.on_note(f"{printable(entry.row.name)} failed: {entry.reason}")

        return register_population(
            self.cohort,
            self.template,
            monitor.checkpoint,
            self.settings,
            self.cluster,
            on_change=report_failure,
            control=monitor.control,
        )
