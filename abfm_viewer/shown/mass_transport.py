"""Optimal transport between source and target at the shown time, computed off the frame loop."""

from functools import partial

import abfm
from abfm.mesh import TriangleMesh
from abfm.types import FloatArray
from abfm_viewer.computing.background import Jobs, Latest
from abfm_viewer.session.session import Session


class MassTransport(Jobs):
    """Answers with the interpolation at the shown time, at tau's beyond it; lately with that of an earlier time."""

    def __init__(self, session: Session) -> None:
        super().__init__(session.at_once)
        self._session = session
        self._values: Latest[FloatArray] = self.latest("optimal transport")

    def values(self) -> FloatArray | None:
        """The interpolation (V,); None before there is any, or where there cannot be."""
        session = self._session
        source, target = session.values("source"), session.values("target")
        if source is None or target is None:
            return None
        share = min(session.time / session.parameters.tau, 1.0)
        compute = partial(_transported, session.mesh, source, target, share)
        return self._values.newest((session.mesh, source, target), share, compute)


def _transported(mesh: TriangleMesh, source: FloatArray, target: FloatArray, share: float) -> FloatArray:
    return abfm.baselines.optimal_transport(mesh, source, target, share, sharpen=True)
