"""Formulas: right values, and nothing but arithmetic."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from abfm.errors import FunctionError
from abfm.functions import function
from abfm.mesh import TriangleMesh
from tests.shapes import icosphere

MESH = icosphere(1)
X, Y, Z = MESH.vertices.T

FORMULAS = {
    "sin(10*x)*z": np.sin(10 * X) * Z,
    "2": np.full_like(X, 2),
    "-x ** 2 / 3 + y % 0.3": -(X**2) / 3 + np.mod(Y, 0.3),
    "1 / 4 + 0 * x": np.full_like(X, 0.25),
    "(x > 0) - (y >= 0)": (X > 0) * 1.0 - (Y >= 0),
    "where(x > 0, min(x, y), max(y, z))": np.where(X > 0, np.minimum(X, Y), np.maximum(Y, Z)),
    "arctan2(y, x) + hypot(x, y) * e ** z": np.arctan2(Y, X) + np.hypot(X, Y) * np.exp(Z),
    "abs(cos(pi * x)) + sqrt(1 + y)": np.abs(np.cos(np.pi * X)) + np.sqrt(1 + Y),
    "floor(3*x) == ceil(3*x)": (np.floor(3 * X) == np.ceil(3 * X)) * 1.0,
}

ATTACKS = (
    *("x.__class__", "().__class__.__bases__", "__import__('os').system('true')"),
    *("open('/etc/passwd')", "x.tofile", "[i for i in x]", "(i for i in x)", "[x]", "{1: x}"),
    *("lambda: x", "x[0]", "f'{x}'", "'a' * 9", "b'a'", "...", "x and y", "not x"),
    *("x if y else z", "x @ y", "x // 2", "x << 9", "~x", "x is y", "x in y", "0 < x < 1"),
    *("x = 1", "(x := 1)", "x; y", "import os", "sin(x, y)", "sin(*x)", "sin(x=x)"),
    *("sin(x, out=x)", "sin", "sin(sin)", "True", "None", "2j", "max(x)", "where(x)", "sin(x)(y)"),
    *("w", "eval(x)", "", "#", "\\", "x\0", "x y", "(x", "x)", "(" * 300 + "x" + ")" * 300),
    *("-" * 900 + "x", "9" * 900, "x+" * 4000 + "x", "sin(" * 150 + "x" + ")" * 150 + "'"),
    *("9**9**9**9", "9.0**9**9", "1e999", "1/0", "log(-1)", "x/0", "10**400", "0**-1"),
)


@pytest.mark.parametrize("formula", FORMULAS)
def test_values(formula):
    found = function(MESH, f"expression:{formula}")
    assert_allclose(found, FORMULAS[formula], rtol=1e-14, atol=1e-14)


@pytest.mark.parametrize("formula", ATTACKS, ids=lambda formula: ascii(formula[:20]))
def test_everything_else_is_refused(formula):
    before = MESH.vertices.copy()
    with pytest.raises(FunctionError) as error:
        function(MESH, f"expression:{formula}")
    assert "\n" not in str(error.value)
    assert len(str(error.value)) < 400
    assert np.array_equal(MESH.vertices, before)


def test_values_that_are_not_finite_are_counted_with_an_example():
    shifted = TriangleMesh(MESH.vertices - MESH.vertices[5], MESH.faces)
    count = np.sum(shifted.vertices[:, 0] == 0)
    told = f"not finite at {count} of {len(X)} vertices, for example inf at vertex"
    with pytest.raises(FunctionError, match=told):
        function(shifted, "expression:1/abs(x)")


@settings(deadline=None)
@given(st.text(alphabet="xyzsincoqrt0123456789.+-*/%()<>=!, e", max_size=40))
def test_any_formula_gives_finite_values_or_function_error(formula):
    try:
        f = function(MESH, f"expression:{formula}")
    except FunctionError:
        return
    assert f.shape == X.shape
    assert np.isfinite(f).all()


@pytest.mark.parametrize(
    ("formula", "told"),
    [
        ("x*sin", r"sin stands without arguments, as in sin\(x\)"),
        ("sin(cos)", "cos stands without arguments"),
        ("x + \udcff", "character 4, counting from 0, is none that a text may have"),
        ("sin(x, y=1)", "arguments of functions have no names"),
    ],
)
def test_what_is_wrong_is_told(formula, told):
    with pytest.raises(FunctionError, match=told):
        function(MESH, f"expression:{formula}")


@pytest.mark.parametrize("spec", [3, None, ["gaussian"]])
def test_what_is_no_text_is_no_function(spec):
    with pytest.raises(FunctionError, match="expected a text"):
        function(MESH, spec)
