"""The coarser meshes that a match begins on, made while the user looks at the mesh."""

from __future__ import annotations

from functools import partial

from abfm import Parameters, TriangleMesh
from abfm_viewer.computing.background import Latest


class CoarseMeshes:
    """Makes them off the frame loop; a match that begins earlier waits for them."""

    def __init__(self) -> None:
        self._made: Latest[bool] = Latest("coarse meshes")

    def prepare(self, mesh: TriangleMesh, parameters: Parameters) -> None:
        """Make those of a mesh for these parameters, unless they are made or being made."""
        if not Latest.at_once:  # pictures off the screen solve nothing
            self._made.ask((mesh, parameters.levels), partial(_prepared, mesh, parameters))

    @property
    def busy(self) -> bool:
        """Whether they are being made."""
        return self._made.busy

    def close(self) -> None:
        """End the thread."""
        self._made.close()


def _prepared(mesh: TriangleMesh, parameters: Parameters) -> bool:
    from abfm.matching.solving.levels import prepare  # not before: it loads what the first frame does without

    prepare(mesh, parameters)
    return True
