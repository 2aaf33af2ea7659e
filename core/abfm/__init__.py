"""Advection-based function matching on surfaces: find the tangent field whose flow carries one function to another."""

from abfm.advection import advect
from abfm.energy import MatchingEnergy
from abfm.errors import AbfmError, FunctionError, MeshError, ParameterError, ResultError
from abfm.exponential import AdvectionError
from abfm.functions import function
from abfm.match import Match, load_match
from abfm.matching import Control, Iteration, match
from abfm.mesh import TriangleMesh, load_mesh
from abfm.parameters import Parameters

__all__ = [
    "AbfmError",
    "AdvectionError",
    "Control",
    "FunctionError",
    "Iteration",
    "Match",
    "MatchingEnergy",
    "MeshError",
    "ParameterError",
    "Parameters",
    "ResultError",
    "TriangleMesh",
    "advect",
    "function",
    "load_match",
    "load_mesh",
    "match",
]
