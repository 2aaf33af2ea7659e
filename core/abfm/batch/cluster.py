"""Who solves the rows of a batch: processes of this machine, or a Dask cluster."""

from __future__ import annotations

import os
from dataclasses import dataclass

from abfm.errors import ParameterError, ResultError, brief

CONNECTING = "connecting to the scheduler"
NO_WORKERS = "waiting for workers: the cluster has none"


class LostError(ResultError):
    """The scheduler is gone; finished rows are kept."""


@dataclass(frozen=True)
class Cluster:
    """Who solves the rows.

    Parameters
    ----------
    jobs : int, optional
        So many processes of this machine; by default one for each core that this process may use.
    scheduler : str, optional
        Instead of these, the address of the scheduler of a Dask cluster, such as
        ``tcp://10.0.0.1:8786``; or
    scheduler_file : path, optional
        the file in which the scheduler has its address. Both need ``dask.distributed``, the extra
        ``cluster``.

    Raises
    ------
    ParameterError
        If more than one of them is given, or a number that is none of processes.
    """

    jobs: int | None = None
    scheduler: str | None = None
    scheduler_file: str | os.PathLike[str] | None = None

    def __post_init__(self) -> None:
        given = [each for each in (self.jobs, self.scheduler, self.scheduler_file) if each]
        if len(given) > 1:
            raise ParameterError("give one of jobs, scheduler and scheduler_file, or none")
        if self.jobs is not None and not (isinstance(self.jobs, int) and 1 <= self.jobs <= 4096):
            raise ParameterError(
                f"jobs is {brief(self.jobs)}; expected a number of processes, 1 to 4096"
            )

    @property
    def is_local(self) -> bool:
        """Whether the processes are this machine's, and started for the run."""
        return self.scheduler is None and self.scheduler_file is None

    @property
    def processes(self) -> int:
        """How many there are, where they are this machine's."""
        return self.jobs or cores()


def cores() -> int:
    """Return how many cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
