"""Functions as text: ``family:key=value,...``, sums with ``+``, parentheses, and vertex maps.

::

    spec     = term { "+" term }
    term     = family [ ":" argument { "," argument } ]
             | "expression:" formula     up to the end of the spec or of the parentheses around it
             | "permuted:" path "(" spec ")"
             | "scaled:" argument { "," argument } "(" spec ")"
             | "circular:" [ argument { "," argument } ] "(" spec ")"
             | "(" spec ")"
    argument = key "=" value | value            the key may be left out before the positional value

Blanks around signs are free. A comma separates arguments where ``key=`` follows, a plus separates
terms where a family or a parenthesis follows, so ``vertex=1,5``, ``1e+3`` and most file names need
no quotes; a value in double quotes may hold anything (a double quote inside is doubled).
"""

import os
import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NoReturn

import numpy as np

from abfm.errors import FunctionError, brief, did_you_mean
from abfm.functions.circular import Circular
from abfm.functions.expression import Expression
from abfm.functions.family import NUMBER, Family, Spec, parameter, quoted
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
class Scaled(Family):
    """Another function times a factor, plus an offset, in the unit of the function."""

    family = "scaled"
    positional = "factor"
    factor: float = parameter(NUMBER, "what values are multiplied by")
    offset: float = parameter(NUMBER, "what is added to them after that", default=0.0)
    function: Spec  # given in parentheses after the numbers

    def __str__(self) -> str:
        return f"{super().__str__()}({self.function})"

    def evaluate(self, mesh: TriangleMesh) -> FloatArray:
        return self.factor * self.function.evaluate(mesh) + self.offset


_FAMILIES: dict[str, type[Family]] = {
    cls.family: cls
    for cls in (
        *(Gaussian, Eigenfunction, HeatKernelSignature, WaveKernelSignature, Curvature),
        *(Coordinate, Geodesic, ShapeDiameter, Indicator, ValuesFile, Expression, Permuted, Scaled),
        Circular,
    )
}


def scaled(spec: Spec, factor: float, offset: float) -> Scaled:
    """Return a function times a factor, plus an offset; one that is scaled already once only."""
    if isinstance(spec, Scaled):
        offset += factor * spec.offset
        factor, spec = factor * spec.factor, spec.function
    return Scaled(factor=factor, offset=offset, function=spec)


def families() -> tuple[type[Family], ...]:
    """Return all families, each with its name, ``summary()``, ``parameters()``, ``positional``."""
    return tuple(_FAMILIES.values())


@lru_cache(maxsize=256)
def parse(text: str) -> Spec:
    """Read the text form of a function; nothing about a mesh is checked yet.

    Raises
    ------
    FunctionError
        If the text is no spec: what was found, what was expected, and the nearest known name.
    """
    if len(text) > LENGTH_MAX:
        raise FunctionError(
            f"function {brief(text)} has {len(text)} characters; at most {LENGTH_MAX} are allowed"
        )
    parser = _Parser(text)
    try:
        spec = parser.spec(depth=0)
        if parser.position < len(text):
            parser.fail("'+' or the end")
    except FunctionError:
        if os.path.isfile(text):
            raise FunctionError(f"{brief(text)} is a file: write file:{quoted(text)}") from None
        raise
    return spec


def function(mesh: MeshLike, spec: str | Spec, *, may_be_unknown: bool = False) -> FloatArray:
    """Return values of a function at the vertices, (V,), finite, a new array every time.

    Parameters
    ----------
    mesh : TriangleMesh, or whatever `abfm.load_mesh` takes
    spec : str or Spec
        Text such as ``"gaussian:vertex=12,width=0.1 + gaussian:vertex=3"``, or what :func:`parse`
        makes of it; :func:`families` lists the families with their parameters.
    may_be_unknown : bool
        Let a file have NaN at some vertices, not at all of them; such values come back.

    Raises
    ------
    FunctionError
        If the text is no spec, names a vertex or file that does not fit the mesh, or gives values
        that are not finite.
    """
    mesh, tree = as_mesh(mesh), parse(spec) if isinstance(spec, str) else spec
    if not isinstance(tree, Spec):
        raise FunctionError(
            f"function is {brief(spec)}; expected a text such as 'gaussian:vertex=12', or a "
            "parsed one"
        )
    with np.errstate(over="ignore", invalid="ignore"):
        values = np.array(tree.evaluate(mesh), dtype=np.float64, order="C")
    bad = np.flatnonzero(~np.isfinite(values))
    is_of_file = len(bad) > 0 and bool(files_in(tree))
    if may_be_unknown and is_of_file and len(bad) < len(values) and not np.isinf(values).any():
        return values
    if len(bad):
        mend = ": write a number there, and hide it by a mask if it means nothing"
        raise FunctionError(
            f"function {brief(str(tree))} is not finite at {len(bad)} of {len(values)} vertices, "
            f"for example {values[bad[0]]} at vertex {mesh.vertex_ids[bad[0]]}; every vertex "
            f"needs a finite value{mend if is_of_file else ''}"
        )
    return values


def files_in(given: object) -> list[str]:
    """Return the files of values in a function, its text, or a sequence of these."""
    if isinstance(given, str):
        return files_in(parse(given)) if given else []
    if isinstance(given, list | tuple):
        return [path for part in given for path in files_in(part)]
    parts = functions_in(given) if isinstance(given, Spec) else ()
    return [part.path for part in parts if isinstance(part, ValuesFile)]


def functions_in(spec: Spec) -> Iterator[Spec]:
    """Yield a function, and all functions that it is made of."""
    yield spec
    inner = spec.terms if isinstance(spec, Sum) else ()
    for each in (spec.function,) if isinstance(spec, Permuted | Scaled | Circular) else inner:
        yield from functions_in(each)


class _Parser:
    """Recursive descent over the text; ``position`` is where the next character is read."""

    def __init__(self, text: str) -> None:
        self.text, self.position = text, 0

    def fail(self, expected: str) -> NoReturn:
        left = self.text[self.position :]
        found = brief(left) if left else "nothing more"
        raise FunctionError(f"function {brief(self.text)}: expected {expected}, found {found}")

    def take(self, pattern: re.Pattern[str] | str) -> str:
        """Skip blanks, then consume and return what matches here; empty if nothing does."""
        while self.text[self.position : self.position + 1].isspace():
            self.position += 1
        match = re.compile(pattern).match(self.text, self.position)
        if match is None:
            return ""
        self.position = match.end()
        return match.group()

    def spec(self, depth: int) -> Spec:
        if depth > DEPTH_MAX:
            self.fail(f"at most {DEPTH_MAX} parentheses inside each other")
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
        if issubclass(cls, Scaled | Circular):
            return self.wrapped(cls, depth)
        if cls is not Permuted:
            return cls(**_values(cls, self.arguments()))
        path = _unquoted(self.take(_QUOTED_TEXT) or self.take(r"[^(]*"))
        if not self.take(r"\("):
            self.fail("'(' and the function to compose, as in permuted:map.txt(gaussian:vertex=1)")
        return Permuted(path=path, function=self.inner(depth))

    def wrapped(self, cls: type[Scaled | Circular], depth: int) -> Spec:
        """Return a family of another function, which follows its arguments in parentheses."""
        arguments = self.take(r"[^(]*").split(",")
        if not self.take(r"\("):
            example = "scaled:2" if cls is Scaled else "circular:period=360"
            self.fail(f"'(' and the function, as in {example}(gaussian:vertex=1)")
        values = _values(cls, [argument.strip() for argument in arguments])
        return cls(function=self.inner(depth), **values)

    def inner(self, depth: int) -> Spec:
        """Return the spec up to the parenthesis that closes it."""
        found = self.spec(depth + 1)
        if not self.take(r"\)"):
            self.fail("')'")
        return found

    def formula(self) -> str:
        """Return what comes before the end or a parenthesis that the formula did not open."""
        start, depth = self.position, 0
        for sign in self.text[start:]:
            depth += (sign == "(") - (sign == ")")
            if depth < 0:
                break
            self.position += 1
        return self.text[start : self.position]

    def arguments(self) -> list[str]:
        """Return the texts between separating commas, up to the end of the term."""
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
    """Return the parameters of a family by their keys, as text."""
    keys = [p.name for p in cls.parameters()]
    expected = f"keys are {', '.join(keys)}" if keys else "it takes no parameters"
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
            raise FunctionError(f"{cls.family}: {key}= is given twice")
        values[key] = _unquoted(value)
    for p in cls.parameters():
        if p.required and p.name not in values:
            form = f"{cls.family}:..." if p.name == cls.positional else f"{p.name}="
            raise FunctionError(f"{cls.family}: {p.name} is missing; give {p.kind.name}, as {form}")
    return values


def _unquoted(text: str) -> str:
    return text[1:-1].replace('""', '"') if _QUOTED_TEXT.fullmatch(text) else text.strip()
