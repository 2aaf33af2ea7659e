"""How often matches succeed: random problems of many kinds, by several versions of the solver, side by side."""

from abfm.benchmark.success.meshes import success_meshes
from abfm.benchmark.success.problems import SuccessProblem, success_problems
from abfm.benchmark.success.record import BEFORE, VERSIONS, Record, run_problem
from abfm.benchmark.success.report import format_success, success_table
from abfm.benchmark.success.run import merged, run_success
from abfm.benchmark.watched import LEVEL

__all__ = [
    "BEFORE",
    "LEVEL",
    "VERSIONS",
    "Record",
    "SuccessProblem",
    "format_success",
    "merged",
    "run_problem",
    "run_success",
    "success_meshes",
    "success_problems",
    "success_table",
]
