"""The task of registering a population to a template."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from abfm.batch.cluster import Cluster
from abfm.batch.ledger import LedgerEntry
from abfm.errors import ParameterError, ResultError, brief, one_line, printable
from abfm.io import check_values_name
from abfm.matching.task import MAX_DISTORTION
from abfm.parameters import Parameters
from abfm.population import report
from abfm.population.population import Population, load_population
from abfm.population.rounds import register_population
from abfm.population.settings import BOUND, MOST_ROUNDS, Settings
from abfm.population.subjects import Cohort, function_text, read_subjects
from abfm.registration.task import INITIAL_INPUT, ONE_BASED_INPUT
from abfm.tasks.inputs import (
    MESH_FORMATS,
    MESH_INPUTS,
    Input,
    Rename,
    file_input,
    number_input,
    parameter_inputs,
    parameters_in,
    renamed_spec,
    weight_input,
)
from abfm.tasks.monitor import Monitor
from abfm.tasks.task import Export, Given, Preview, Report, ResultFile, Table, Task

ROUNDS_MAX = 1000
_MEAN = "template and mean"


def _named(text: str, what: str) -> tuple[str, str]:
    name, equals, value = text.partition("=")
    if not equals or not name or not value:
        raise ParameterError(f"{brief(text)}: expected NAME={what}")
    return name, value


def _function(text: str) -> tuple[str, str]:
    name, spec = _named(text, "SPEC")
    return name, function_text(spec, ".")


def _renamed_function(text: str, rename: Rename) -> str:
    name, spec = _named(text, "SPEC")
    return f"{name}={renamed_spec(function_text(spec, '.'), rename)}"


def _weight(text: str) -> tuple[str, float]:
    name, number = _named(text, "N")
    try:
        return name, float(number)
    except ValueError:
        raise ParameterError(f"{brief(text)}: expected a number after =") from None


def _rounds(text: str) -> int:
    if not text.isdecimal() or not 1 <= int(text) <= ROUNDS_MAX:
        raise ParameterError(f"{brief(text)} is not a whole number from 1 to {ROUNDS_MAX}")
    return int(text)


def _preview(path: Path) -> Preview:
    """Return the mean and the deviation of the first channel on the template."""
    found = load_population(path)
    return Preview(found.template, [found.mean(), found.deviation()])


@dataclass(frozen=True)
class PopulationTask(Task):
    """Register subjects to a template iteratively, and make their mean.

    Its results and those of its registrations are files in a folder, the checkpoint of the monitor.

    Attributes
    ----------
    cohort : Cohort
    template : str
        Its mesh file.
    settings : Settings
    key : str
        Name of the task.
    cluster : Cluster, optional
        Where it is solved; by default on this machine's cores.
    """

    cohort: Cohort
    template: str
    settings: Settings
    key: str
    cluster: Cluster | None = None

    kind: ClassVar = "population"
    needs: ClassVar = ("table", "template")
    inputs: ClassVar = (
        file_input("table", "a subject a row", "SUBJECTS.csv", is_argument=True),
        file_input("template", f"the surface that subjects come to, a {MESH_FORMATS}", "SURFACE"),
        *MESH_INPUTS,
        Input(
            name="function",
            help="the template's own function of a channel, the first target; one for each, or "
            "none",
            read=_function,
            metavar="NAME=SPEC",
            group=_MEAN,
            renamed=_renamed_function,
            repeats=True,
        ),
        weight_input("mask", "weight of each vertex of the template", _MEAN),
        Input(
            name="weight",
            help="weight of a channel among those that are registered by, above 0 (1)",
            read=_weight,
            metavar="NAME=N",
            group=_MEAN,
            repeats=True,
        ),
        INITIAL_INPUT,
        number_input(
            "bound",
            "end when the mean changes by less, over its deviation",
            "X",
            "above 0 and at most 1000",
            lambda bound: 1e-9 <= bound <= 1000,
            group=_MEAN,
            default=f"{BOUND:g}",
        ),
        Input(
            name="rounds",
            help="the most rounds",
            read=_rounds,
            metavar="N",
            group=_MEAN,
            default=str(MOST_ROUNDS),
        ),
        MAX_DISTORTION,
        ONE_BASED_INPUT,
        *parameter_inputs(),
    )
    result: ClassVar = Population
    file: ClassVar = ResultFile(
        frozenset({"subject_weights", "template_mask"}),
        load_population,
        lambda path: load_population(path).facts,
        _preview,
    )
    preview_labels: ClassVar = ("mean", "deviation")
    exports: ClassVar = {
        ".vtu": Export(report.export_mean_vtu),
        ".gii": Export(report.export_mean_values, check_values_name),
    }
    tables: ClassVar = {"subjects": Table("table of the subjects", report.export_subjects)}
    report: ClassVar = Report(report.details, report.lines)

    @classmethod
    def check(cls, values: Mapping[str, Any]) -> None:
        """Refuse parameters that do not fit each other, and names that are given twice."""
        Parameters.of(**parameters_in(values))
        for option in ("function", "weight"):
            names = [name for name, _ in values.get(option, ())]
            for name in names:
                if names.count(name) > 1:
                    text = f"{one_line(name, 40)} is given twice"
                    raise ParameterError(f"column {option}: {text}")

    @classmethod
    def read(cls, given: Given) -> PopulationTask:
        values = given.values()
        options = {
            each.name: "auto" if values[each.name] is None else values[each.name]
            for each in (*parameter_inputs(), *MESH_INPUTS, MAX_DISTORTION, ONE_BASED_INPUT)
            if each.name in values
        }
        settings = Settings(
            dict(values.get("function", ())),
            values.get("mask", ""),
            values.get("initial", ""),
            options,
            values.get("bound", BOUND),
            values.get("rounds", MOST_ROUNDS),
            dict(values.get("weight", ())),
        )
        return cls(read_subjects(values["table"]), values["template"], settings, given.key)

    def solve(self, monitor: Monitor) -> Population:
        """Return the population; a `CancelledError` ends it early, and finished rows are kept."""
        if monitor.checkpoint is None:
            raise ResultError("a population needs a folder for its registrations")

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
