"""Functions as text: ``family:key=value,...``, sums with ``+``, parentheses and vertex maps.

::

    spec     = term { "+" term }
    term     = family [ ":" argument { "," argument } ]
             | "expression:" formula     to the end of the spec or of the parentheses around it
             | "permuted:" path "(" spec ")"
             | "scaled:" argument { "," argument } "(" spec ")"
             | "smoothed:" argument "(" spec ")"
             | "circular:" [ argument { "," argument } ] "(" spec ")"
             | "(" spec ")"
    argument = key "=" value | value            the key of the positional parameter is optional

Blanks around operators are ignored. A comma separates arguments if ``key=`` follows it. A plus
separates terms if a family or a parenthesis follows it. Therefore ``vertex=1,5``, ``1e+3`` and most
file names need no quotes. A value in double quotes may have any characters (a double quote inside
is doubled).
"""

import os
import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NoReturn

import numpy as np

from abfm.calculus.smoothing import smoothed
from abfm.errors import FunctionError, brief, did_you_mean
from abfm.functions.circular import Circular
from abfm.functions.expression import Expression
from abfm.functions.family import NUMBER, POSITIVE_REAL, Family, Spec, Wrapper, parameter, quoted
from abfm.functions.files import Permuted, ValuesFile
from abfm.functions.local_shape import Curvature, ShapeDiameter
from abfm.functions.places import Coordinate, Gaussian, Geodesic, Indicator
from abfm.functions.spectral import Eigenfunction, HeatKernelSignature, WaveKernelSignature
from abfm.mesh import MeshLike, TriangleMesh, as_mesh
from abfm.types import FloatArray

LENGTH_MAX = 10_000
DEPTH_MAX = 50

_NAME = re.compile(r"[A-Za-z][\w-]*", re.ASCII)
_QUOTED_TEXT = re.compile(r'"(?:[^"]|"")*"')
_NEXT_TERM = re.compile(r"\+\s*(\(|$|[A-Za-z][\w-]*\s*([:+)]|$))", re.ASCII)
_NEXT_ARGUMENT = re.compile(r",\s*[A-Za-z_][\w-]*\s*=", re.ASCII)
_KEY_AND_VALUE = re.compile(r"([A-Za-z_][\w-]*)\s*=\s*(.*)", re.ASCII | re.DOTALL)


@dataclass(frozen=True)
class Sum(Spec):
    """Sum of functions; their units should agree."""

    terms: tuple[Spec, ...]

    def __str__(self) -> str:
        return " + ".join(
            f"({term})" if isinstance(term, Family) and term.is_open_ended else str(term)
            for term in self.terms
        )

    def evaluate(self, mesh: TriangleMesh) -> FloatArray:
        total = self.terms[0].evaluate(mesh).copy()
        for term in self.terms[1:]:
            total += term.evaluate(mesh)
        return total


@dataclass(frozen=True, kw_only=True)
class Scaled(Wrapper):
    """Another function times a factor, plus an offset, in the unit of the function."""

    family = "scaled"
    positional = "factor"
    factor: float = parameter(NUMBER, "factor of the values")
    offset: float = parameter(NUMBER, "offset added after the multiplication", default=0.0)

    def evaluate(self, mesh: TriangleMesh) -> FloatArray:
        return self.factor * self.function.evaluate(mesh) + self.offset


@dataclass(frozen=True, kw_only=True)
class Smoothed(Wrapper):
    """Another function, smoothed by heat over a length, in the unit of the function.

    Missing values stay missing, and do not count for the others.
    """

    family = "smoothed"
    positional = "length"
    length: float = parameter(
        POSITIVE_REAL, "length over which values are averaged", unit="fraction of sqrt(area)"
    )

    def evaluate(self, mesh: TriangleMesh) -> FloatArray:
        values = self.function.evaluate(mesh)
        known = np.isfinite(values)
        parts = np.stack([np.where(known, values, 0.0), known], axis=1)
        total, share = smoothed(mesh, parts, self.length * mesh.length_scale).T
        return np.where(known, total / np.where(known, share, 1.0), np.nan)


_FAMILIES: dict[str, type[Family]] = {
    cls.family: cls
    for cls in (
        *(Gaussian, Eigenfunction, HeatKernelSignature, WaveKernelSignature, Curvature),
        *(Coordinate, Geodesic, ShapeDiameter, Indicator, ValuesFile, Expression, Permuted, Scaled),
        *(Smoothed, Circular),
    )
}


def scaled(spec: Spec, factor: float, offset: float) -> Scaled:
    """Return the function ``factor * spec + offset``; combine two scalings to one."""
    if isinstance(spec, Scaled):
        offset += factor * spec.offset
        factor, spec = factor * spec.factor, spec.function
    return Scaled(factor=factor, offset=offset, function=spec)


def families() -> tuple[type[Family], ...]:
    """Return the classes of all families of functions."""
    return tuple(_FAMILIES.values())


@lru_cache(maxsize=256)
def parse(text: str) -> Spec:
    """Parse the text form of a function, without any check against a mesh.

    Raises
    ------
    FunctionError
        If the text is not valid, with the position, the expected text, and similar valid names.
    """
    if len(text) > LENGTH_MAX:
        raise FunctionError(
            f"function {brief(text)} has {len(text)} characters; expected at most {LENGTH_MAX}"
        )
    parser = _Parser(text)
    try:
        spec = parser.spec(depth=0)
        if parser.position < len(text):
            parser.fail("'+' or the end")
    except FunctionError:
        if os.path.isfile(text):
            raise FunctionError(
                f"{brief(text)} is the name of a file. Write file:{quoted(text)}"
            ) from None
        raise
    return spec


def function(mesh: MeshLike, spec: str | Spec, *, allow_missing: bool = False) -> FloatArray:
    """Return the values of a function at the vertices, (V,), as a new array of finite numbers.

    Parameters
    ----------
    mesh : TriangleMesh, or anything that `abfm.load_mesh` accepts
    spec : str or Spec
        Text such as ``"gaussian:vertex=12,width=0.1 + gaussian:vertex=3"``, or the result of
        `abfm.functions.parse`. `abfm.functions.families` lists the families with their parameters.
    allow_missing : bool
        Whether values from a file may be NaN at some vertices, but not at all of them.

    Raises
    ------
    FunctionError
        If the text is not valid, if a vertex or file does not fit the mesh, or if values are not
        finite.
    """
    mesh, tree = as_mesh(mesh), parse(spec) if isinstance(spec, str) else spec
    if not isinstance(tree, Spec):
        raise FunctionError(
            f"function is {brief(spec)}; expected a text such as 'gaussian:vertex=12', or a "
            "parsed function"
        )
    with np.errstate(over="ignore", invalid="ignore"):
        values = np.array(tree.evaluate(mesh), dtype=np.float64, order="C")
    bad = np.flatnonzero(~np.isfinite(values))
    is_of_file = len(bad) > 0 and bool(files_in(tree))
    if allow_missing and is_of_file and len(bad) < len(values) and not np.isinf(values).any():
        return values
    if len(bad):
        advice = ". Replace missing values by numbers, and exclude them by a mask"
        raise FunctionError(
            f"function {brief(str(tree))} is not finite at {len(bad)} of {len(values)} vertices, "
            f"for example {values[bad[0]]} at vertex {mesh.vertex_ids[bad[0]]}; expected a finite "
            f"value at every vertex{advice if is_of_file else ''}"
        )
    return values


def files_in(functions: object) -> list[str]:
    """Return the names of the value files that functions read; functions may be texts."""
    if isinstance(functions, str):
        return files_in(parse(functions)) if functions else []
    if isinstance(functions, list | tuple):
        return [path for part in functions for path in files_in(part)]
    parts = functions_in(functions) if isinstance(functions, Spec) else ()
    return [part.path for part in parts if isinstance(part, ValuesFile)]


def functions_in(spec: Spec) -> Iterator[Spec]:
    """Yield a function and, recursively, all functions that it contains."""
    yield spec
    inner = spec.terms if isinstance(spec, Sum) else ()
    for each in (spec.function,) if isinstance(spec, Wrapper) else inner:
        yield from functions_in(each)


class _Parser:
    """Recursive descent parser of functions; ``position`` is the index of the next character."""

    def __init__(self, text: str) -> None:
        self.text, self.position = text, 0

    def fail(self, expected: str) -> NoReturn:
        rest = self.text[self.position :]
        found = brief(rest) if rest else "the end of the text"
        raise FunctionError(f"function {brief(self.text)}: expected {expected}, found {found}")

    def take(self, pattern: re.Pattern[str] | str) -> str:
        """Skip blanks, then consume and return the text that matches ``pattern``; empty if none."""
        while self.text[self.position : self.position + 1].isspace():
            self.position += 1
        match = re.compile(pattern).match(self.text, self.position)
        if match is None:
            return ""
        self.position = match.end()
        return match.group()

    def spec(self, depth: int) -> Spec:
        if depth > DEPTH_MAX:
            self.fail(f"at most {DEPTH_MAX} nested parentheses")
        terms: list[Spec] = []
        while not terms or self.take(r"\+"):
            term = self.term(depth)
            terms += term.terms if isinstance(term, Sum) else (term,)
        return terms[0] if len(terms) == 1 else Sum(tuple(terms))

    def term(self, depth: int) -> Spec:
        if self.take(r"\("):
            return self.inner(depth)
        name = self.take(_NAME)
        if not name:
            self.fail(f"a family ({', '.join(_FAMILIES)})")
        if name not in _FAMILIES:
            expected = did_you_mean(name, _FAMILIES) or f"; families are {', '.join(_FAMILIES)}"
            raise FunctionError(f"unknown function family {brief(name)}{expected}")
        cls = _FAMILIES[name]
        if not self.take(":"):
            if not re.compile(r"[+)]|$").match(self.text, self.position):
                self.fail(f"':' after {name}")
            return cls(**_values(cls, []))
        if cls.is_open_ended:
            return cls(**{str(cls.positional): self.formula()})
        if issubclass(cls, Wrapper) and cls is not Permuted:
            return self.wrapped(cls, depth)
        if cls is not Permuted:
            return cls(**_values(cls, self.arguments()))
        path = _unquoted(self.take(_QUOTED_TEXT) or self.take(r"[^(]*"))
        if not self.take(r"\("):
            self.fail("'(' and the function to compose, as in permuted:map.txt(gaussian:vertex=1)")
        return Permuted(path=path, function=self.inner(depth))

    def wrapped(self, cls: type[Wrapper], depth: int) -> Spec:
        """Parse the arguments of a function that changes another one, and that inner function."""
        arguments = self.take(r"[^(]*").split(",")
        if not self.take(r"\("):
            example = {"scaled": "2", "smoothed": "0.05"}.get(cls.family, "period=360")
            self.fail(f"'(' and the function, as in {cls.family}:{example}(gaussian:vertex=1)")
        values = _values(cls, [argument.strip() for argument in arguments])
        return cls(function=self.inner(depth), **values)

    def inner(self, depth: int) -> Spec:
        """Parse a function up to the closing parenthesis around it."""
        found = self.spec(depth + 1)
        if not self.take(r"\)"):
            self.fail("')'")
        return found

    def formula(self) -> str:
        """Return the text of a formula, up to the end or the parenthesis that closes around it."""
        start, depth = self.position, 0
        for sign in self.text[start:]:
            depth += (sign == "(") - (sign == ")")
            if depth < 0:
                break
            self.position += 1
        return self.text[start : self.position]

    def arguments(self) -> list[str]:
        """Return the texts between commas that separate arguments, up to the end of the term."""
        found, start, depth = [], self.position, 0
        while self.position < len(self.text):
            sign = self.text[self.position]
            if sign == '"':
                if not (quoted := _QUOTED_TEXT.match(self.text, self.position)):
                    self.fail("a closing double quote")
                self.position = quoted.end()
                continue
            depth += (sign == "(") - (sign == ")")
            if depth < 0 or (depth == 0 and _NEXT_TERM.match(self.text, self.position)):
                break
            if depth == 0 and _NEXT_ARGUMENT.match(self.text, self.position):
                found.append(self.text[start : self.position])
                start = self.position + 1
            self.position += 1
        found.append(self.text[start : self.position])
        return [argument.strip() for argument in found]


def _values(cls: type[Family], arguments: list[str]) -> dict[str, Any]:
    """Return the texts of the parameters of a family, by name, from its parsed arguments."""
    keys = [p.name for p in cls.parameters()]
    expected = f"keys are {', '.join(keys)}" if keys else "it has no parameters"
    values: dict[str, Any] = {}
    for place, argument in enumerate(arguments):
        match = _KEY_AND_VALUE.fullmatch(argument)
        if match:
            key, value = match.groups()
        elif place == 0 and cls.positional:
            key, value = cls.positional, argument
        elif argument or place:
            raise FunctionError(f"{cls.family}: {brief(argument)} is not key=value; {expected}")
        else:
            continue
        if key not in keys:
            raise FunctionError(
                f"{cls.family}: unknown key {brief(key)}{did_you_mean(key, keys)}; {expected}"
            )
        if key in values:
            raise FunctionError(f"{cls.family}: {key}= occurs twice; expected once")
        values[key] = _unquoted(value)
    for p in cls.parameters():
        if p.required and p.name not in values:
            form = f"{cls.family}:..." if p.name == cls.positional else f"{p.name}="
            raise FunctionError(
                f"{cls.family}: {p.name} is missing; expected {p.kind.name}, as {form}"
            )
    return values


def _unquoted(text: str) -> str:
    return text[1:-1].replace('""', '"') if _QUOTED_TEXT.fullmatch(text) else text.strip()
