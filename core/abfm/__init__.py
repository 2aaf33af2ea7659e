"""Advection-based function matching on surfaces: find the tangent field whose flow carries one function to another.

A name is imported when it is first used, so that a program that only reads meshes starts without the solver.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from abfm.errors import AbfmError as AbfmError
    from abfm.errors import AdvectionError as AdvectionError
    from abfm.errors import FunctionError as FunctionError
    from abfm.errors import MeshError as MeshError
    from abfm.errors import ParameterError as ParameterError
    from abfm.errors import ResultError as ResultError
    from abfm.flow.advection import advect as advect
    from abfm.flow.flow import Flow as Flow
    from abfm.functions import function as function
    from abfm.matching.energy.energy import MatchingEnergy as MatchingEnergy
    from abfm.matching.judging.verification import Verification as Verification
    from abfm.matching.judging.verification import verify as verify
    from abfm.matching.match import match as match
    from abfm.matching.result import Match as Match
    from abfm.matching.result import load_match as load_match
    from abfm.matching.solving.control import Control as Control
    from abfm.matching.solving.record import Iteration as Iteration
    from abfm.mesh import TriangleMesh as TriangleMesh
    from abfm.mesh import load_mesh as load_mesh
    from abfm.parameters import Parameters as Parameters

_MODULES = {
    "AbfmError": "errors",
    "AdvectionError": "errors",
    "Control": "matching.solving.control",
    "Flow": "flow.flow",
    "FunctionError": "errors",
    "Iteration": "matching.solving.record",
    "Match": "matching.result",
    "MatchingEnergy": "matching.energy.energy",
    "MeshError": "errors",
    "ParameterError": "errors",
    "Parameters": "parameters",
    "ResultError": "errors",
    "TriangleMesh": "mesh",
    "Verification": "matching.judging.verification",
    "advect": "flow.advection",
    "function": "functions",
    "load_match": "matching.result",
    "load_mesh": "mesh",
    "match": "matching.match",  # so no submodule may be called match: its import would take the name
    "verify": "matching.judging.verification",
}

if not TYPE_CHECKING:  # mypy would take every name for one of this package
    __all__ = list(_MODULES)

    def __getattr__(name: str) -> Any:
        if name not in _MODULES:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        value = getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)
        globals()[name] = value
        return value

    def __dir__() -> list[str]:
        return sorted({*globals(), *_MODULES})
