"""Functions given by a formula in x, y and z."""

import ast
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from simpleeval import (
    FeatureNotAvailable,
    FunctionNotDefined,
    InvalidExpression,
    NameNotDefined,
    OperatorNotDefined,
    SimpleEval,
)

from abfm.errors import FunctionError, brief, did_you_mean, one_line
from abfm.functions.family import Family, Kind, parameter
from abfm.mesh import TriangleMesh
from abfm.types import FloatArray

LONGEST = 1000  # characters: bounds the time and the depth of any expression

CONSTANTS = {"pi": np.float64(np.pi), "e": np.float64(np.e)}
COORDINATES = ("x", "y", "z")
_REFUSED = (InvalidExpression, TypeError, ValueError, OverflowError, RecursionError, KeyError)


def _comparison(compare: Callable[[Any, Any], Any]) -> Callable[[Any, Any], Any]:
    return lambda a, b: np.where(compare(a, b), 1.0, 0.0)


OPERATORS = {
    ast.Add: np.add,
    ast.Sub: np.subtract,
    ast.Mult: np.multiply,
    ast.Div: np.true_divide,
    ast.Mod: np.mod,
    ast.Pow: np.power,
    ast.UAdd: np.positive,
    ast.USub: np.negative,
    ast.Lt: _comparison(np.less),
    ast.LtE: _comparison(np.less_equal),
    ast.Gt: _comparison(np.greater),
    ast.GtE: _comparison(np.greater_equal),
    ast.Eq: _comparison(np.equal),
    ast.NotEq: _comparison(np.not_equal),
}


def _of(count: int, compute: Callable[..., Any]) -> Callable[..., Any]:
    """Take exactly that many arguments: one more would be NumPy's ``out``."""

    def call(*arguments: Any) -> Any:
        if len(arguments) != count:
            raise InvalidExpression(
                f"a function that takes {count} argument(s) got {len(arguments)}"
            )
        return compute(*arguments)

    return call


FUNCTIONS = {
    **{
        name: _of(1, getattr(np, name))
        for name in (
            *("sin", "cos", "tan", "arcsin", "arccos", "arctan", "sinh", "cosh", "tanh"),
            *("exp", "log", "sqrt", "abs", "sign", "floor", "ceil"),
        )
    },
    "arctan2": _of(2, np.arctan2),
    "hypot": _of(2, np.hypot),
    "min": _of(2, np.minimum),
    "max": _of(2, np.maximum),
    "where": _of(3, lambda condition, a, b: np.where(condition != 0, a, b)),
}


@dataclass(frozen=True, kw_only=True)
class Expression(Family):
    """Value of a formula in the coordinates x, y, z (the mesh's units of length) at each vertex, as
    in sin(10*x)*z.

    It may use numbers, ``pi``, ``e``, ``+ - * / % **``, comparisons (1 where true, 0 elsewhere),
    parentheses and the functions sin, cos, tan, arcsin, arccos, arctan, arctan2, sinh, cosh, tanh,
    exp, log, sqrt, abs, sign, floor, ceil, hypot, min(a, b), max(a, b) and where(condition, a, b).
    In a spec it extends to the end of the text, or of the parentheses around it. Nothing else is
    evaluated: simpleeval walks the formula with these operators and functions.
    """

    family = "expression"
    positional = "formula"
    is_open_ended = True
    example = "expression:sin(10*x)*z"
    formula: str = parameter(
        Kind("a formula", lambda text: " ".join(text.split())),
        "in x, y and z, with sin, exp, sqrt, abs, min, where and the like, and comparisons. Enter "
        "takes it",
    )

    def check(self) -> None:
        _value(self.formula, np.full((2, 3), 0.5))

    def __str__(self) -> str:
        return f"{self.family}:{self.formula}"

    def evaluate(self, mesh: TriangleMesh) -> FloatArray:
        return _value(self.formula, mesh.vertices)


def _value(formula: str, points: FloatArray) -> FloatArray:
    """Return values at points (n, 3), (n,); they may be infinite or NaN."""
    evaluator = SimpleEval(
        operators=OPERATORS,
        functions=FUNCTIONS,
        names={**CONSTANTS, **dict(zip(COORDINATES, points.T, strict=True))},
    )
    available = (ast.Name, ast.BinOp, ast.UnaryOp, ast.Compare, ast.Call)
    evaluator.nodes = {node: evaluator.nodes[node] for node in available} | {ast.Constant: _number}
    try:
        with np.errstate(all="ignore"):
            value = np.asarray(evaluator.eval(formula, _parse(formula)), dtype=np.float64)
    except (NameNotDefined, FunctionNotDefined) as error:
        name = error.name if isinstance(error, NameNotDefined) else error.func_name
        known = [*COORDINATES, *CONSTANTS, *FUNCTIONS]
        raise _refusal(formula, f"{brief(name)} is not known{did_you_mean(name, known)}") from None
    except (FeatureNotAvailable, OperatorNotDefined):
        raise _refusal(formula, "it is more than arithmetic") from None
    except _REFUSED as error:
        raise _refusal(formula, one_line(error)) from None
    return np.broadcast_to(value, len(points))


def _parse(formula: str) -> ast.expr:
    if len(formula) > LONGEST:
        raise InvalidExpression(f"it has {len(formula)} characters, at most {LONGEST} are allowed")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            tree = ast.parse(formula, mode="eval").body
    except (SyntaxError, MemoryError) as error:
        raise InvalidExpression(
            error.msg if isinstance(error, SyntaxError) else "it is nested too deeply"
        ) from None
    if any(isinstance(node, ast.Compare) and len(node.ops) > 1 for node in ast.walk(tree)):
        raise InvalidExpression("write (0 < x) * (x < 1) for 0 < x < 1")
    calls = [node for node in ast.walk(tree) if isinstance(node, ast.Call)]
    if any(call.keywords for call in calls):
        raise InvalidExpression("arguments of functions have no names")
    called = [call.func for call in calls]
    for node in ast.walk(tree):
        if isinstance(node, ast.Name) and node.id in FUNCTIONS and node not in called:
            raise InvalidExpression(f"{node.id} stands without arguments, as in {node.id}(x)")
    return tree


def _number(node: ast.Constant) -> np.float64:
    if not isinstance(node.value, int | float) or isinstance(node.value, bool):
        raise InvalidExpression(f"{brief(node.value)} is not a real number")
    return np.float64(node.value)  # not int: 9**9**9 ends at once, as infinity


def _refusal(formula: str, reason: str) -> FunctionError:
    advice = (
        "it ends with the text: put parentheses around it to add another function"
        if ":" in formula
        else "it may use x, y, z, pi, e, numbers, + - * / % **, comparisons and functions such as "
        "sin, exp, abs, where"
    )
    return FunctionError(
        f"expression: {brief(formula)} cannot be evaluated: {' '.join(reason.split())}; {advice}"
    )
