"""Text form of functions: meaning, round trips, errors, and formulas without code."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from abfm.errors import FunctionError
from abfm.functions import Family, Sum, families, function, parse
from abfm.functions.circular import Circular
from abfm.functions.expression import Expression
from abfm.functions.files import Permuted, ValuesFile
from abfm.functions.local_shape import Curvature, ShapeDiameter
from abfm.functions.places import Coordinate, Gaussian, Geodesic, Indicator
from abfm.functions.spec import Scaled, Smoothed, scaled
from abfm.functions.spectral import Eigenfunction, HeatKernelSignature, WaveKernelSignature
from abfm.mesh import TriangleMesh
from tests.messages import raises
from tests.shapes import icosphere

HKS, WKS = HeatKernelSignature(), WaveKernelSignature()
ALONG_X = Coordinate(axis="x")
MEANINGS = {
    "gaussian:vertex=12,width=0.1": Gaussian(vertex=(12,), width=0.1),
    "gaussian:x=1,y=-2e-3,z=.5,metric=euclidean,height=-2": Gaussian(
        x=1.0, y=-0.002, z=0.5, metric="euclidean", height=-2.0
    ),
    "  gaussian : vertex = 1 , width = 1e+2 ": Gaussian(vertex=(1,), width=100.0),
    "eigenfunction:7": Eigenfunction(index=7),
    "eigenfunction:index=7": Eigenfunction(index=7),
    "hks": HKS,
    "hks:time=0.5,eigenpairs=50": HeatKernelSignature(time=0.5, eigenpairs=50),
    "wks:energy=3,width=0.2": WaveKernelSignature(energy=3.0, width=0.2),
    "curvature:mean": Curvature(kind="mean"),
    "coordinate:y": Coordinate(axis="y"),
    "geodesic:vertex=1,5, 9": Geodesic(vertex=(1, 5, 9)),
    "shape-diameter": ShapeDiameter(),
    "indicator:vertex=3,radius=0.2": Indicator(vertex=(3,), radius=0.2),
    "indicator:axis=x,above=0.2,below=1": Indicator(axis="x", above=0.2, below=1.0),
    "file:values.npy": ValuesFile(path="values.npy"),
    "file:C:\\data\\a b.csv,column=depth": ValuesFile(path="C:\\data\\a b.csv", column="depth"),
    "file:lh.aparc.annot,label=G_and_S": ValuesFile(path="lh.aparc.annot", label="G_and_S"),
    "file:a+b,c (1).txt": ValuesFile(path="a+b,c (1).txt"),
    'file:"a + hks, column=2 ""x"".csv"': ValuesFile(path='a + hks, column=2 "x".csv'),
    "expression:sin(10*x)*z": Expression(formula="sin(10*x)*z"),
    "expression:max(x, y) + (z)": Expression(formula="max(x, y) + (z)"),
    "permuted:p.txt(geodesic:vertex=1)": Permuted(path="p.txt", function=Geodesic(vertex=(1,))),
    "permuted:mirror(hks)": Permuted(path="mirror", function=HKS),
    "permuted:a b.txt(expression:(x+1)*y)": Permuted(
        path="a b.txt", function=Expression(formula="(x+1)*y")
    ),
    'permuted:"p(1).txt"(permuted:q.npy(hks))': Permuted(
        path="p(1).txt", function=Permuted(path="q.npy", function=HKS)
    ),
    "scaled:2(hks)": Scaled(factor=2.0, function=HKS),
    "scaled:-0.5, offset=1e-3(hks + wks) + wks": Sum(
        (Scaled(factor=-0.5, offset=1e-3, function=Sum((HKS, WKS))), WKS)
    ),
    "smoothed:0.05(scaled:2(hks))": Smoothed(
        length=0.05, function=Scaled(factor=2.0, function=HKS)
    ),
    "circular:period=360(hks)": Circular(period=360.0, function=HKS),
    "circular:(hks + wks)": Circular(function=Sum((HKS, WKS))),
    "scaled:2(permuted:mirror(hks))": Scaled(
        factor=2.0, function=Permuted(path="mirror", function=HKS)
    ),
    "gaussian:vertex=1,width=0.1 + gaussian:vertex=9": Sum(
        (Gaussian(vertex=(1,), width=0.1), Gaussian(vertex=(9,)))
    ),
    "hks+wks": Sum((HKS, WKS)),
    "((hks) + (wks + coordinate:x))": Sum((HKS, WKS, Coordinate(axis="x"))),
    "(expression:x+y)+hks": Sum((Expression(formula="x+y"), HKS)),
    "hks + expression:x + y": Sum((HKS, Expression(formula="x + y"))),
    "permuted:p.txt(hks + expression:x+y) + wks": Sum(
        (Permuted(path="p.txt", function=Sum((HKS, Expression(formula="x+y")))), WKS)
    ),
}

GAUSSIAN_KEYS = ("vertex", "x", "y", "z", "width", "height", "metric")
ERRORS = {  # invalid text: words that its message contains
    "": ("gaussian", "circular"),
    "gausian:vertex=1": ("gausian", "gaussian"),
    "Shape_Diameter": ("Shape_Diameter", "shape-diameter"),
    "gaussian vertex=1": ("':'", "gaussian"),
    "gaussian:vertex=1 +": ("gaussian", "circular"),
    "gaussian:vertex=1 + foo": ("foo",),
    "gaussian:12": ("12", "key=value", *GAUSSIAN_KEYS),
    "gaussian:vertex=1,widht=2": ("widht", "width"),
    "gaussian:vertex=1,vertex=2": ("vertex", "twice"),
    "gaussian:vertex=-1": ("vertex", -1, 0),
    "gaussian:vertex=1.5": ("vertex", 1.5),
    "gaussian:vertex=99999999999999999999": ("vertex", 99999999999999999999),
    "gaussian:vertex=1,width=0": ("width", 0, "fraction of sqrt(area)"),
    "gaussian:vertex=1,width=nan": ("width", "nan"),
    "gaussian:vertex=1,height=inf": ("height", "inf", "finite"),
    "gaussian:vertex=1,metric=geodsic": ("metric", "geodsic", "geodesic", "euclidean"),
    "gaussian": ("vertex", "x", "y", "z"),
    "gaussian:x=1,y=2": ("vertex", "x", "y", "z"),
    "gaussian:vertex=1,x=0,y=0,z=0": ("vertex", "x", "y", "z", "either"),
    "eigenfunction": ("index", "missing", 0),
    "eigenfunction:-1": ("index", -1),
    "hks:time=0": ("time", 0, "area"),
    "hks:eigenpairs=0": ("eigenpairs", 0, 1),
    "wks:eigenpairs=1": ("eigenpairs", 2),
    "curvature:gausian": ("kind", "gausian", "gaussian", "mean"),
    "coordinate:w": ("axis", "w", "x", "y", "z"),
    "shape-diameter:rays=3": ("rays",),
    "indicator": ("disc", "half-space"),
    "indicator:vertex=1": ("radius=",),
    "indicator:radius=1": ("vertex=",),
    "indicator:axis=x": ("above=", "below="),
    "indicator:vertex=1,radius=1,axis=x,above=0": ("either", "disc", "half-space"),
    "file:": ("path",),
    'file:"a.npy': ("quote",),
    "permuted:p.txt": ("'('",),
    "permuted:p.txt(hks": ("')'", "end"),
    "scaled:2": ("'('",),
    "scaled:offset=1(hks)": ("factor", "missing"),
    "scaled:x(hks)": ("factor", "x", "finite"),
    "scaled:2,ofset=1(hks)": ("ofset", "offset"),
    "(hks": ("')'",),
    "hks)": ("'+'", "end", "')'"),
    "hks hks": ("':'", "hks"),
    "expression:x + gaussian:vertex=1": ("parentheses",),
    "(" * 60 + "hks": (50, "parentheses"),
    "hks + " * 2000 + "hks": (10000,),
}


@pytest.mark.parametrize("text", MEANINGS)
def test_text_and_spec_round_trip(text):
    assert parse(text) == MEANINGS[text]
    assert parse(str(MEANINGS[text])) == MEANINGS[text]


@pytest.mark.parametrize("text", ERRORS)
def test_parse_errors_have_the_words_in_one_line(text):
    with raises(FunctionError, *ERRORS[text]) as error:
        parse(text)
    assert "\n" not in str(error.value)
    assert len(str(error.value)) < 300


def test_file_name_alone_is_corrected(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name, advised in (("lh.sulc", "file:lh.sulc"), ("a,b.txt", 'file:"a,b.txt"')):
        with raises(FunctionError, "unknown" if name == "lh.sulc" else ""):
            parse(name)
        (tmp_path / name).touch()
        with raises(FunctionError, name, advised):
            parse(name)


def test_python_specs_are_checked_like_text():
    with raises(FunctionError, "width", 0):
        Gaussian(vertex=(1,), width=-1.0)
    assert Gaussian(vertex=3, width="0.5") == Gaussian(vertex=(3,), width=0.5)


def test_families_have_summaries_and_parameters():
    described = {cls.family: cls for cls in families()}
    assert set(described) == {spec.family for spec in MEANINGS.values() if isinstance(spec, Family)}
    assert set(described) == {*TERMS, "permuted", "scaled", "smoothed", "circular"}
    for cls in described.values():
        assert cls.summary()
        assert all(p.summary for p in cls.parameters())
    of_gaussian = {p.name: p for p in described["gaussian"].parameters()}
    width = of_gaussian["width"]
    assert (width.default, width.required, width.unit) == (0.1, False, "fraction of sqrt(area)")
    assert of_gaussian["metric"].kind.choices == ("geodesic", "euclidean")
    (index,) = described["eigenfunction"].parameters()
    assert index.required
    assert described["eigenfunction"].positional == "index"


def test_two_scalings_are_combined():
    once = scaled(ALONG_X, 3.0, 1.0)
    twice = scaled(once, -2.0, 0.5)
    assert (twice.factor, twice.offset, twice.function) == (-6.0, -1.5, ALONG_X)
    np.testing.assert_allclose(twice.evaluate(MESH), -2 * (3 * X + 1) + 0.5, atol=1e-15)
    np.testing.assert_array_equal(function(MESH, str(twice)), twice.evaluate(MESH))


def test_sum_of_functions_is_evaluated():
    mesh = icosphere(2)
    total = function(mesh, "coordinate:z + (expression:x*y) + eigenfunction:0")
    x, y, z = mesh.vertices.T
    assert_allclose(total, z + x * y + 1, atol=1e-15)
    assert_array_equal(mesh.vertices, icosphere(2).vertices)


@pytest.mark.parametrize(
    "text", ["coordinate:x", "eigenfunction:0", "expression:2", "curvature:mean", "shape-diameter"]
)
def test_results_are_new_writable_contiguous_arrays(text):
    mesh = icosphere(1)
    f = function(mesh, parse(text))
    assert f.dtype == np.float64
    assert f.shape == (len(mesh.vertices),)
    assert f.flags.c_contiguous
    f[:] = 7.0
    assert not np.any(function(mesh, text) == 7.0)


numbers = st.floats(allow_nan=False, allow_infinity=False)
positives = st.floats(min_value=0, exclude_min=True, allow_infinity=False)
indices = st.integers(0, 2**31 - 1)
names = st.text(min_size=1).filter(lambda s: s == s.strip() and "\0" not in s)
points = st.one_of(
    st.fixed_dictionaries({"vertex": st.lists(indices, min_size=1, max_size=3).map(tuple)}),
    st.fixed_dictionaries({"x": numbers, "y": numbers, "z": numbers}),
)
formulas = st.sampled_from(["x", "sin(10*x)*z", "(x + 1) * -y", "where(x > 0, min(x, y), 1e-3)"])
TERMS = {
    "gaussian": st.builds(
        lambda p, **others: Gaussian(**p, **others),
        points,
        width=positives,
        height=numbers,
        metric=st.sampled_from(["geodesic", "euclidean"]),
    ),
    "eigenfunction": st.builds(Eigenfunction, index=indices),
    "hks": st.builds(HeatKernelSignature, time=positives, eigenpairs=st.integers(1, 2000)),
    "wks": st.builds(
        WaveKernelSignature,
        energy=numbers,
        width=st.none() | positives,
        eigenpairs=st.integers(2, 2000),
    ),
    "curvature": st.builds(Curvature, kind=st.sampled_from(["gaussian", "mean"])),
    "coordinate": st.builds(Coordinate, axis=st.sampled_from("xyz")),
    "geodesic": st.builds(lambda p: Geodesic(**p), points),
    "shape-diameter": st.just(ShapeDiameter()),
    "indicator": st.builds(lambda p, radius: Indicator(**p, radius=radius), points, positives)
    | st.builds(Indicator, axis=st.sampled_from("xyz"), above=numbers, below=st.none() | numbers),
    "file": st.builds(ValuesFile, path=names, column=st.none() | names),
    "expression": st.builds(Expression, formula=formulas),
}
specs = st.recursive(
    st.one_of(*TERMS.values()),
    lambda inner: st.one_of(
        st.builds(Permuted, path=names, function=inner),
        st.builds(Scaled, factor=numbers, offset=numbers, function=inner),
        st.builds(Smoothed, length=positives, function=inner),
        st.builds(Circular, period=positives, part=st.none() | st.just("sine"), function=inner),
        st.lists(inner.filter(lambda s: not isinstance(s, Sum)), min_size=2, max_size=3).map(
            lambda t: Sum(tuple(t))
        ),
    ),
    max_leaves=4,
)


@given(specs)
def test_any_spec_round_trips(spec):
    assert parse(str(spec)) == spec


@given(
    st.text()
    | st.lists(st.sampled_from([*MEANINGS, "(", ")", "+", ",", "=", '"', "vertex=1"])).map("".join)
)
def test_any_text_parses_or_raises_function_error(text):
    try:
        spec = parse(text)
    except FunctionError:
        return
    assert parse(str(spec)) == spec


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
def test_formulas_have_their_values(formula):
    found = function(MESH, f"expression:{formula}")
    assert_allclose(found, FORMULAS[formula], rtol=1e-14, atol=1e-14)


@pytest.mark.parametrize("formula", ATTACKS, ids=lambda formula: ascii(formula[:20]))
def test_formulas_other_than_arithmetic_are_refused(formula):
    before = MESH.vertices.copy()
    with pytest.raises(FunctionError) as error:
        function(MESH, f"expression:{formula}")
    assert "\n" not in str(error.value)
    assert len(str(error.value)) < 400
    assert np.array_equal(MESH.vertices, before)


def test_values_that_are_not_finite_are_counted():
    shifted = TriangleMesh(MESH.vertices - MESH.vertices[5], MESH.faces)
    count = np.sum(shifted.vertices[:, 0] == 0)
    with raises(FunctionError, count, len(X)):
        function(shifted, "expression:1/abs(x)")


@given(st.text(alphabet="xyzsincoqrt0123456789.+-*/%()<>=!, e", max_size=40))
def test_any_formula_is_finite_or_refused(formula):
    try:
        f = function(MESH, f"expression:{formula}")
    except FunctionError:
        return
    assert f.shape == X.shape
    assert np.isfinite(f).all()


@pytest.mark.parametrize(
    ("formula", "named"),
    [("x*sin", ()), ("sin(cos)", ()), ("x + \udcff", (4, 0)), ("sin(x, y=1)", ())],
)
def test_invalid_formulas_are_refused(formula, named):
    with raises(FunctionError, *named):
        function(MESH, f"expression:{formula}")


@pytest.mark.parametrize("spec", [3, None, ["gaussian"]])
def test_function_must_be_text_or_spec(spec):
    with raises(FunctionError):
        function(MESH, spec)
