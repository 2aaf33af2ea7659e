"""Choice of workers of a batch: processes of this machine, or a Dask cluster."""

from __future__ import annotations

import os
from dataclasses import dataclass

from abfm.errors import ParameterError, ResultError, brief

CONNECTING = "connecting to the scheduler"
NO_WORKERS = "waiting for workers: the cluster has none"


class ConnectionLostError(ResultError):
    """The connection to the scheduler is lost; finished rows are preserved."""


@dataclass(frozen=True)
class Cluster:
    """Workers that solve the rows.

    Parameters
    ----------
    jobs : int, optional
        Number of processes on this machine. The default is one process for each core that this
        process may use.
    scheduler : str, optional
        Address of the scheduler of a Dask cluster, such as ``tcp://10.0.0.1:8786``.
    scheduler_file : path, optional
        File to which the scheduler wrote its address. A Dask cluster needs ``dask.distributed``,
        which ``pip install 'abfm[cluster]'`` installs.

    Raises
    ------
    ParameterError
        If more than one parameter is given, or the number of processes is invalid.
    """

    jobs: int | None = None
    scheduler: str | None = None
    scheduler_file: str | os.PathLike[str] | None = None

    def __post_init__(self) -> None:
        given = [each for each in (self.jobs, self.scheduler, self.scheduler_file) if each]
        if len(given) > 1:
            raise ParameterError("expected at most one of jobs, scheduler and scheduler_file")
        if self.jobs is not None and not (isinstance(self.jobs, int) and 1 <= self.jobs <= 4096):
            raise ParameterError(
                f"jobs is {brief(self.jobs)}; expected a number of processes from 1 to 4096"
            )

    @property
    def processes(self) -> int:
        """Number of processes on this machine."""
        return self.jobs or cores()


def cores() -> int:
    """Return the number of cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
