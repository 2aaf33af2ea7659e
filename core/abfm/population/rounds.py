"""Register all subjects to a template, take their mean for the next target, and again.

The mean is unbiased to first order: subjects are registered to a target, and the mean of their
fields, stationary velocities, says by how much the target lies beside the middle of all. The flow
of minus the mean field is applied to all maps, and so to the mean, so that the template does not
drift; the mean field of the next round is about 0 [Guimond, Meunier and Thirion, CVIU 2000, do so
with displacements; first order, as the mean of fields is not the field of a mean of flows].
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
from abfm.population.subjects import Cohort
from abfm.population.work import Work
from abfm.types import BoolArray
from abfm.workers.control import Control, controlled


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
    """Register subjects to a template by their functions, and make their mean.

    Each registration of each round is a row of a batch, whose results are in the folder: run again,
    it registers no subject twice, and it gives the same bits, whoever solves them and in whatever
    order the subjects stand.

    Parameters
    ----------
    cohort : Cohort
        The subjects, see `read_subjects`.
    template : path or object
        The surface that they come to: a mesh file, or a mesh that `load_mesh` accepts, which is
        written to the folder.
    folder : path
        For results; it is made if it is not there.
    settings : Settings, optional
    cluster : Cluster, optional
        Who solves the rows; by default this machine's cores.
    on_change : callable
        Called with the entry of each registration as it comes.
    control : Control, optional
        To end before all is done, by a `CancelledError`; what is done is kept.

    Raises
    ------
    AbfmError
        If files, functions or settings do not fit, or not two subjects can be registered.
    """
    # sums come out alike in whatever order the table has them
    order = sorted(range(len(cohort.subjects)), key=lambda i: cohort.subjects[i].name)
    by_name = Cohort(cohort.channels, tuple(cohort.subjects[i] for i in order))
    control = control or Control()
    with Workers(cluster) as workers, controlled(control):
        work = Work(by_name, template, Path(folder), settings or Settings(), workers)
        target, changes = work.first_target(), list[float]()
        fits = list[BoolArray]()
        while True:
            number = len(changes) + 1
            entries = work.registered(target, number, on_change)
            found = work.round(entries, fits, number)
            fits.append(found.judged.fits)
            mean = work.target(found)
            changes.append(mean.distance(target, work.areas, work.channel_weights))
            target = mean
            if changes[-1] <= work.settings.bound or number == work.settings.rounds:
                phases = work.phases(entries, found)
                return work.population(found, changes, phases, np.argsort(order))
