"""Optimal transport between source and target at the shown time, computed off the frame loop."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

from abfm.mesh import TriangleMesh
from abfm.types import FloatArray
from abfm_viewer.computing.background import Latest

if TYPE_CHECKING:
    from abfm_viewer.session.session import Session


@dataclass(frozen=True, eq=False)
class _Pair:
    mesh: TriangleMesh
    source: FloatArray
    target: FloatArray


class MassTransport:
    """Answers with the interpolation at the shown time, at tau's beyond it; lately with that of an earlier time."""

    def __init__(self) -> None:
        self._service: Latest[tuple[_Pair, FloatArray]] = Latest("optimal transport")
        self._pair: _Pair | None = None

    @property
    def error(self) -> str:
        """Why there is none, in one line; empty if there is or will be."""
        return self._service.error

    @property
    def busy(self) -> bool:
        """Whether something is still to come."""
        return self._service.busy

    def values(self, session: Session) -> FloatArray | None:
        """The interpolation (V,); None before there is any, or where there cannot be."""
        source, target = session.values("source"), session.values("target")
        if source is None or target is None:
            return None
        pair = self._pair
        if pair is None or pair.mesh is not session.mesh or pair.source is not source or pair.target is not target:
            pair = self._pair = _Pair(session.mesh, source, target)
        share = min(session.time / session.parameters.tau, 1.0)
        found = self._service.ask((pair, share), partial(_transported, pair, share)) or self._service.value
        return found[1] if found is not None and found[0] is pair else None

    def close(self) -> None:
        """Stop the thread."""
        self._service.close()


def _transported(pair: _Pair, share: float) -> tuple[_Pair, FloatArray]:
    from abfm.baselines import optimal_transport

    return pair, optimal_transport(pair.mesh, pair.source, pair.target, share, sharpen=True)
