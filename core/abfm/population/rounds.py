"""Iterative registration of subjects to a template.

Each round registers all subjects to a target. The mean of the registered subjects is the target of
the next round.

The mean is unbiased to first order. The fields of the registrations are stationary velocities, and
their mean measures the offset of the target from the centre of all subjects. To prevent a drift of
the template, the flow of the negative mean field is applied to all maps. The mean field of the next
round is then about 0. Guimond, Meunier and Thirion (CVIU 2000) do this with displacements. The
method is of first order, because the mean of fields is not the field of a mean flow.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import numpy as np

from abfm.batch import Cluster, LedgerEntry, Workers
from abfm.mesh import MeshLike
from abfm.population.population import Population
from abfm.population.settings import Settings
from abfm.population.solver import PopulationSolver
from abfm.population.subjects import Cohort
from abfm.types import BoolArray
from abfm.workers.control import Control, controlled
from abfm.workers.progress import phase

_LATER_ROUNDS = 2  # number of further rounds that are expected, unless fewer are allowed


def register_population(
    cohort: Cohort,
    template: MeshLike,
    folder: str | os.PathLike[str],
    settings: Settings | None = None,
    cluster: Cluster | None = None,
    *,
    on_change: Callable[[LedgerEntry], object] = lambda entry: None,
    control: Control | None = None,
) -> Population:
    """Register subjects to a template by their functions, and compute their mean.

    Each registration of each round is a row of a batch with its result in the folder. A repeated
    call therefore resumes and registers no subject twice. Results have the same bits for any choice
    of workers and any order of subjects.

    Parameters
    ----------
    cohort : Cohort
        The subjects, see `abfm.population.read_subjects`.
    template : path or object
        Surface to register to: a mesh file, or a mesh that `load_mesh` accepts. A mesh is written
        to the folder.
    folder : path
        Folder of results, created if it does not exist.
    settings : Settings, optional
        Settings of the registrations and of the stopping criterion.
    cluster : Cluster, optional
        Workers that solve the rows; by default the cores of this machine.
    on_change : callable
        Function that is called with the entry of each registration when it is finished.
    control : Control, optional
        Object that cancels the computation by a `CancelledError`; finished rows are preserved.

    Raises
    ------
    AbfmError
        If files, functions or settings are invalid, or fewer than two subjects can be registered.
    """
    # a fixed order makes sums independent of the order in the table
    order = sorted(range(len(cohort.subjects)), key=lambda i: cohort.subjects[i].name)
    by_name = Cohort(cohort.channels, tuple(cohort.subjects[i] for i in order))
    control = control or Control()
    with Workers(cluster) as workers, controlled(control):
        solver = PopulationSolver(by_name, template, Path(folder), settings or Settings(), workers)
        target, changes = solver.first_target(), list[float]()
        fits = list[BoolArray]()
        while True:
            number = len(changes) + 1
            later = min(solver.settings.rounds - number, _LATER_ROUNDS)
            with phase(f"round {number}", repeats=later):
                entries = solver.register_all(target, number, on_change)
                found = solver.round(entries, fits, number)
                fits.append(found.outliers.fits)
                mean = solver.target(found)
            changes.append(mean.distance(target, solver.areas, solver.channel_weights))
            target = mean
            if changes[-1] <= solver.settings.bound or number == solver.settings.rounds:
                phases = solver.phases(entries, found)
                return solver.population(found, changes, phases, np.argsort(order))
