"""Functions defined by a formula in x, y and z."""

import ast
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from abfm.errors import FunctionError, brief, did_you_mean, one_line
from abfm.functions.family import Family, ValueKind, parameter
from abfm.mesh import TriangleMesh
from abfm.types import FloatArray
from abfm.wording import counted

_LENGTH_MAX = 1000  # characters of a formula
_DEPTH_MAX = 495  # nested operations of a formula
_CONSTANTS = {"pi": np.float64(np.pi), "e": np.float64(np.e)}


def _comparison(compare: Callable[[Any, Any], Any]) -> Callable[[Any, Any], Any]:
    return lambda a, b: np.where(compare(a, b), 1.0, 0.0)


_OPERATORS: dict[type, Callable[..., Any]] = {
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
_UNARY = (
    *("sin", "cos", "tan", "arcsin", "arccos", "arctan", "sinh", "cosh", "tanh"),
    *("exp", "log", "sqrt", "abs", "sign", "floor", "ceil"),
)
# numbers of arguments and functions by name; one more argument would be NumPy's ``out``
_FUNCTIONS: dict[str, tuple[int, Callable[..., Any]]] = {
    **{name: (1, getattr(np, name)) for name in _UNARY},
    "arctan2": (2, np.arctan2),
    "hypot": (2, np.hypot),
    "min": (2, np.minimum),
    "max": (2, np.maximum),
    "where": (3, lambda condition, a, b: np.where(condition != 0, a, b)),
}


@dataclass(frozen=True, kw_only=True)
class Expression(Family):
    """Formula in the coordinates x, y, z of the vertices, such as sin(10*x)*z.

    Coordinates have the unit of length of the mesh. A formula may contain:

    - numbers, ``pi``, ``e``, parentheses, and the operators ``+ - * / % **``
    - comparisons, which are 1 if true and 0 otherwise
    - ``sin cos tan arcsin arccos arctan arctan2 sinh cosh tanh exp log sqrt abs sign floor ceil
      hypot``, min(a, b), max(a, b) and where(condition, a, b)

    In a spec, the formula extends to the end of the text, or of the parentheses around it.
    """

    family = "expression"
    positional = "formula"
    is_open_ended = True
    example = "expression:sin(10*x)*z"
    formula: str = parameter(
        ValueKind("a formula", lambda text: " ".join(text.split())),
        "formula in x, y and z, with functions such as sin, exp, sqrt, abs, min and where, and "
        "comparisons. Press Enter to apply it",
    )

    def check(self) -> None:
        _value(self.formula, np.full((2, 3), 0.5))

    def __str__(self) -> str:
        return f"{self.family}:{self.formula}"

    def evaluate(self, mesh: TriangleMesh) -> FloatArray:
        return _value(self.formula, mesh.vertices)


def _value(formula: str, points: FloatArray) -> FloatArray:
    """Return the values (n,) of a formula at points (n, 3); they may be infinite or NaN."""
    names = dict(zip("xyz", points.T, strict=True)) | _CONSTANTS
    try:
        with np.errstate(all="ignore"):
            value = np.asarray(_computed(_parsed(formula), names), dtype=np.float64)
    except (TypeError, ValueError, OverflowError, RecursionError) as error:
        advice = (
            "A formula extends to the end of the text. Put parentheses around it to add another "
            "function"
            if ":" in formula
            else "A formula may use x, y, z, pi, e, numbers, + - * / % **, comparisons and "
            "functions such as sin, exp, abs, where"
        )
        reason = " ".join(one_line(error).split())
        raise FunctionError(
            f"expression: {brief(formula)} cannot be evaluated: {reason}. {advice}"
        ) from None
    return np.broadcast_to(value, len(points))


def _parsed(formula: str) -> ast.expr:
    if len(formula) > _LENGTH_MAX:
        raise ValueError(
            f"the formula has {len(formula)} characters; expected at most {_LENGTH_MAX}"
        )
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            tree = ast.parse(formula, mode="eval").body
    except SyntaxError as error:
        raise ValueError(error.msg) from None
    except MemoryError:
        raise ValueError("it is nested too deeply") from None
    levels: list[list[ast.AST]] = [[tree]]
    while levels[-1]:
        levels.append([each for node in levels[-1] for each in ast.iter_child_nodes(node)])
    if len(levels) > _DEPTH_MAX:
        raise ValueError("it is nested too deeply")
    nodes = [node for level in levels for node in level]
    if any(isinstance(node, ast.Compare) and len(node.ops) > 1 for node in nodes):
        raise ValueError("comparisons cannot be chained; write (0 < x) * (x < 1) for 0 < x < 1")
    calls = [node for node in nodes if isinstance(node, ast.Call)]
    if any(call.keywords for call in calls):
        raise ValueError("arguments of functions cannot have names")
    called = [call.func for call in calls]
    for node in nodes:
        if isinstance(node, ast.Name) and node.id in _FUNCTIONS and node not in called:
            raise ValueError(f"{node.id} has no arguments; expected for example {node.id}(x)")
    return tree


def _computed(node: ast.expr, names: dict[str, Any]) -> Any:
    """Evaluate a node of the syntax tree of a formula; ``names`` has the values of variables.

    Raises ValueError for anything except arithmetic.
    """
    match node:
        case ast.Constant(bool() | complex() | str() | bytes() | None as other):
            raise ValueError(f"{brief(other)} is not a real number")
        case ast.Constant(int() | float() as number):
            return np.float64(number)  # unlike with int, 9**9**9 is infinite without delay
        case ast.Name(name) if name in names:
            return names[name]
        case ast.UnaryOp(op, operand) if type(op) in _OPERATORS:
            return _OPERATORS[type(op)](_computed(operand, names))
        case ast.BinOp(a, op, b) | ast.Compare(a, [op], [b]) if type(op) in _OPERATORS:
            return _OPERATORS[type(op)](_computed(a, names), _computed(b, names))
        case ast.Call(ast.Name(name), arguments) if name in _FUNCTIONS:
            count, compute = _FUNCTIONS[name]
            values = [_computed(argument, names) for argument in arguments]
            if len(values) != count:
                raise ValueError(f"{name} has {counted(len(values), 'argument')}; expected {count}")
            return compute(*values)
        case ast.Name(name) | ast.Call(ast.Name(name)):
            valid_names = ["x", "y", "z", *_CONSTANTS, *_FUNCTIONS]
            raise ValueError(f"{brief(name)} is unknown{did_you_mean(name, valid_names)}")
    raise ValueError("only numbers, operators, comparisons and function calls are allowed")
