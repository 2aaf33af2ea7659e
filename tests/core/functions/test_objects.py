from types import SimpleNamespace as Object

import nibabel
import numpy as np
import pandas
import pytest
from nibabel.gifti import GiftiDataArray, GiftiImage, GiftiMetaData
from nilearn.surface import InMemoryMesh, PolyMesh, SurfaceImage
from numpy.testing import assert_allclose, assert_array_equal

import abfm
from abfm import FunctionError, ParameterError
from abfm.errors import AbfmWarning
from abfm.functions import as_values
from abfm.sequences.frames import check_frames
from abfm.sequences.reading.reading_frames import frames_of
from tests.messages import raises
from tests.shapes import icosphere

BALL = icosphere(1)
COUNT = len(BALL.vertices)
X, Y = BALL.vertices[:, 0], BALL.vertices[:, 1]
ORDER = np.random.default_rng(3).permutation(COUNT)
# its file begins with an unused vertex
GAP = abfm.TriangleMesh(np.vstack([[9.0, 9.0, 9.0], BALL.vertices]), BALL.faces + 1)


class Tensor:
    """Object that behaves like a PyTorch tensor that requires a gradient."""

    def __init__(self, array, attached=True):
        self.array, self.attached = array, attached

    def detach(self):
        return Tensor(self.array, attached=False)

    def cpu(self):
        return self

    def __array__(self, dtype=None, copy=None):
        if self.attached:
            raise RuntimeError("Can't call numpy() on Tensor that requires grad.")
        return self.array


class PolarsFrame(dict):
    """Object that behaves like a DataFrame of Polars."""

    def __len__(self):
        return len(self.to_numpy())

    @property
    def columns(self):
        return [*self]

    def to_numpy(self):
        return np.column_stack([*self.values()])


def xarray_of(data):
    """Return an object that behaves like an xarray DataArray of the same pandas object."""
    convert = {"to_pandas": lambda: data, "__array__": data.to_numpy}
    return Object(dims=(), coords={}, ndim=data.ndim, **convert)


def gifti(*arrays, indices=None, labels=False):
    intent = "NIFTI_INTENT_LABEL" if labels else "NIFTI_INTENT_SHAPE"
    found = [GiftiDataArray(np.float32(array), intent) for array in arrays]
    if labels:
        found = [GiftiDataArray(np.int32(array), intent) for array in arrays]
    if indices is not None:
        found.insert(0, GiftiDataArray(np.int32(indices), "NIFTI_INTENT_NODE_INDEX"))
    return GiftiImage(darrays=found, meta=GiftiMetaData())


def cifti(values):
    """Return a .dscalar.nii of both hemispheres, without 3 vertices on the left."""
    left = nibabel.cifti2.BrainModelAxis.from_mask(
        np.arange(COUNT) >= 3, name="CIFTI_STRUCTURE_CORTEX_LEFT"
    )
    right = nibabel.cifti2.BrainModelAxis.from_mask(
        np.ones(2 * COUNT, bool), name="CIFTI_STRUCTURE_CORTEX_RIGHT"
    )
    row = np.concatenate([values[3:], np.zeros(2 * COUNT)])
    scalars = nibabel.cifti2.ScalarAxis(["sulc"])
    return nibabel.Cifti2Image(row[None], (scalars, left + right))


def source_estimate(left=(), right=(), data=(), times=(0.0,)):
    """Return an object with the attributes of MNE's SourceEstimate."""
    vertices = [np.array(left, int), np.array(right, int)]
    arrays = {"data": np.array(data), "times": np.array(times)}
    return Object(vertices=vertices, tmin=times[0], tstep=0.1, **arrays)


PLACED = {
    "masked": (np.ma.array(X, mask=X > 0.5), np.where(X > 0.5, np.nan, X)),
    "mask of nothing": (np.ma.array(X), X),
    "tensor": (Tensor(X), X),
    "series": (pandas.Series(X), X),
    "permuted series": (pandas.Series(X[ORDER], index=ORDER), X),
    "some vertices": (pandas.Series(X)[X > 0], np.where(X > 0, X, np.nan)),
    "missing numbers": (pandas.Series(X, dtype="Float64").where(X > 0), np.where(X > 0, X, np.nan)),
    "frame": (pandas.DataFrame({"x": X, "y": Y}), np.stack([X, Y], axis=1)),
    "permuted frame": (
        pandas.DataFrame({"x": X[ORDER], "y": Y[ORDER]}, index=ORDER),
        np.stack([X, Y], axis=1),
    ),
    "polars": (PolarsFrame(x=X, y=Y), np.stack([X, Y], axis=1)),
    "column of vertices in polars": (PolarsFrame(vertex=ORDER, x=X[ORDER]), X[:, None]),
    "arrow": (
        Object(
            column_names=["vertex", "x"],
            to_pandas=lambda: pandas.DataFrame({"vertex": ORDER, "x": X[ORDER]}),
        ),
        X[:, None],
    ),
    "xarray": (xarray_of(pandas.Series(X[ORDER], index=ORDER)), X),
    "column of vertices": (pandas.DataFrame({"vertex": ORDER, "x": X[ORDER]}), X[:, None]),
    "gifti": (gifti(X), np.float32(X)),
    "gifti of two": (gifti(X, Y), np.float32(np.stack([X, Y], axis=1))),
    "node indices": (gifti(X[ORDER], indices=ORDER), np.float32(X)),
    "mgh": (nibabel.MGHImage(np.float32(X)[:, None, None], np.eye(4)), np.float32(X)),
    "cifti": (cifti(X), np.where(np.arange(COUNT) < 3, np.nan, np.float32(X))),
    "source estimate": (source_estimate(ORDER, (), X[ORDER][:, None]), X),
    "right sources": (source_estimate((), ORDER, X[ORDER][:, None]), X),
    "surface image": (
        SurfaceImage(
            PolyMesh(left=InMemoryMesh(np.float32(BALL.vertices), BALL.faces)),
            {"left": np.float32(X)},
        ),
        np.float32(X),
    ),
}


@pytest.mark.parametrize(("given", "expected"), PLACED.values(), ids=PLACED)
def test_values_of_objects_are_read(given, expected):
    found = as_values(BALL, given)
    assert found.shape == np.shape(expected)
    assert_allclose(found, expected, atol=1e-6)


@pytest.mark.parametrize("kind", ["float64", "int64", "int16"])
def test_nonstandard_gifti_types_are_read(kind):
    """GIFTI types of nilearn and early nibabel, which nibabel cannot write, are read."""
    values = (1e4 * X).astype(kind)
    array = GiftiDataArray(values, datatype=f"NIFTI_TYPE_{kind.upper()}")
    assert_array_equal(as_values(BALL, GiftiImage(darrays=[array])), values)


def test_texts_and_paths_are_values(tmp_path):
    """Functions and masks may be texts and paths; a text for frames is always a path."""
    np.savetxt(tmp_path / "a, b.txt", X)
    assert_array_equal(as_values(BALL, tmp_path / "a, b.txt"), X)
    assert_array_equal(as_values(BALL, "coordinate:y"), Y)
    with raises(FunctionError, "y.npy", recorded=False):
        as_values(BALL, tmp_path / "y.npy")
    path = tmp_path / "mask.npy"
    np.save(path, 1.0 * (X > 0))
    for mask in (path, f"file:{path}"):
        made = abfm.Problem(BALL, path, tmp_path / "a, b.txt", mask=mask)
        assert_array_equal(made.mask, X > 0)
        assert_array_equal(made.target[X > 0, 0], X[X > 0])
    np.save(path, FRAMES)
    for frames in (path, str(path)):
        found = abfm.sequence(BALL, frames, parameters=abfm.sequences.defaults(sigma=0.1))
        assert_array_equal(found.frames[:, :, 0], FRAMES)


def test_index_has_vertex_numbers_of_the_file():
    of_file = np.append(0.0, X)
    series = pandas.Series(of_file[1:][ORDER], index=ORDER + 1)
    assert_array_equal(GAP.restrict(as_values(GAP, series)), X)


def test_values_between_sources_are_interpolated():
    known = np.arange(0, COUNT, 2)
    found = as_values(BALL, source_estimate(known, (), X[known][:, None]))
    assert_array_equal(found[known], X[known])
    assert np.abs(found - X).max() < 0.2


@pytest.mark.parametrize("structure", ["CortexLeft", "CortexRight"])
def test_part_of_the_mesh_hemisphere_is_used(structure):
    side = abfm.TriangleMesh(BALL.vertices, BALL.faces, structure=structure)
    parts = Object(parts={"left": X, "right": Y})
    expected = X if structure == "CortexLeft" else Y
    assert_array_equal(as_values(side, parts), expected)
    every = np.arange(COUNT)
    both = source_estimate(every, every, np.concatenate([X, Y])[:, None])
    assert_array_equal(as_values(side, both), expected)


REFUSED = {
    "repeated": (pandas.Series(X, index=[0, *range(COUNT - 1)]), (0,)),
    "beyond": (pandas.Series(X, index=np.arange(COUNT) + 1), (COUNT,)),
    "names": (pandas.Series(X, index=[f"v{i}" for i in range(COUNT)]), ("to_numpy",)),
    "halves": (pandas.Series(X, index=np.arange(COUNT) + 0.5), ("to_numpy",)),
    "short": (X[:-1], ("f", COUNT - 1, COUNT)),
    "a scalar": (1.0, (COUNT,)),
    "three axes": (np.zeros((COUNT, 1, 1)), (COUNT,)),
    "empty": ([], (COUNT,)),
    "texts": (pandas.Series(["1"] * COUNT), ()),
    "two columns of vertices": (
        pandas.DataFrame(np.c_[X, X, X], columns=["x", "node", "node"]),
        (),
    ),
    "labels": (gifti(np.arange(COUNT), labels=True), ("labels",)),
    "a surface alone": (
        GiftiImage(darrays=[GiftiDataArray(np.float32(BALL.vertices), "NIFTI_INTENT_POINTSET")]),
        (),
    ),
    "volume": (nibabel.MGHImage(np.zeros((5, 6, 7), np.float32), np.eye(4)), ("5 x 6 x 7", COUNT)),
    "both parts": (Object(parts={"left": X, "right": Y}), ("hemisphere",)),
    "both hemispheres": (source_estimate([0], [1], [[1.0], [2.0]]), ("hemisphere",)),
    "sources beyond": (source_estimate([COUNT], (), [[1.0]]), (COUNT,)),
    "no sources": (source_estimate((), (), np.zeros((0, 1))), ()),
    "volume sources": (Object(vertices=[[0]], data=[[1.0]], tmin=0, tstep=1), ()),
    "vectors": (
        Object(vertices=[[0], []], data=np.zeros((1, 3, 1)), tmin=0, tstep=1),
        ("magnitude",),
    ),
}


@pytest.mark.parametrize(("given", "named"), REFUSED.values(), ids=REFUSED)
def test_values_that_do_not_fit_are_refused(given, named):
    with raises(FunctionError, *named):
        as_values(BALL, given, "f")


@pytest.mark.filterwarnings("ignore::abfm.errors.AbfmWarning")
def test_wrong_number_of_values_is_refused_everywhere():
    f, numbers = X[:-1], (COUNT - 1, COUNT)
    still = np.zeros((len(BALL.faces), 3))
    for call in (
        lambda: abfm.match(BALL, X, f),
        lambda: abfm.Problem(BALL, f, X),
        lambda: abfm.register(BALL, BALL, f, X, initial=np.arange(COUNT)),
        lambda: abfm.sequence(BALL, [X, f]),
        lambda: abfm.sequence(BALL, np.stack([f, f])),
        lambda: abfm.advect(BALL, still, f, 1.0),
    ):
        with raises(FunctionError, *numbers):
            call()
    with raises(ParameterError, "mask", *numbers):
        abfm.Problem(BALL, X, X, mask=np.abs(f))


def test_all_functions_accept_value_objects():
    f, g = pandas.Series(X[ORDER], index=ORDER), gifti(Y[ORDER], indices=ORDER)
    mask = pandas.Series(np.where(X > 0, 2.0, 1.0)[ORDER], index=ORDER)
    made = abfm.Problem(BALL, f, g, mask=mask)
    assert_array_equal(made.source[:, 0], X)
    assert_array_equal(made.target[:, 0], np.float32(Y))
    assert_array_equal(made.mask, np.where(X > 0, 2.0, 1.0))
    quick = abfm.Parameters.of(iterations=1, refine=0)
    registered = abfm.register(BALL, BALL, f, f, mask_a=mask, mask_b=mask, parameters=quick)
    assert_allclose(registered.functions[:, 0], X)
    still = np.zeros((len(BALL.faces), 3))
    assert_array_equal(abfm.advect(BALL, still, f, 1.0), X)
    assert_allclose(registered.initial.transfer(f), X)
    with raises(ParameterError, "mask"):
        abfm.Problem(BALL, f, g, mask=pandas.Series(X, index=["a"] * COUNT))
    with pytest.warns(AbfmWarning, match="no value"):
        made = abfm.Problem(BALL, f[X[ORDER] > 0], g)
    assert_array_equal(made.mask, X > 0)


FRAMES = np.stack([np.sin(3 * (X - 0.02 * t)) for t in range(3)])


def image(kind, step=0, unit=None):
    """Return frames as columns of a nibabel image with a time step."""
    found = kind(np.float32(FRAMES.T)[:, None, None], np.eye(4))
    if step:
        found.header.set_zooms((1, 1, 1, step))
    if unit:
        found.header.set_xyzt_units(t=unit)
    return found


@pytest.mark.parametrize(
    ("given", "times"),
    [
        (FRAMES.T, [0, 1, 2]),
        (FRAMES[:, :, None].transpose(2, 0, 1)[0], [0, 1, 2]),
        (pandas.DataFrame(FRAMES), [0, 1, 2]),
        (pandas.DataFrame(FRAMES.T[ORDER], index=ORDER), [0, 1, 2]),
        (pandas.DataFrame(FRAMES[:, ORDER], columns=ORDER), [0, 1, 2]),
        ([pandas.Series(frame[ORDER], index=ORDER) for frame in FRAMES], [0, 1, 2]),
        ([gifti(frame) for frame in FRAMES], [0, 1, 2]),
        (xarray_of(pandas.DataFrame(FRAMES[:, ORDER], columns=ORDER)), [0, 1, 2]),
        (gifti(*FRAMES), [0, 1, 2]),
        (source_estimate(ORDER, (), FRAMES.T[ORDER], [0.5, 0.6, 0.7]), [0.5, 0.6, 0.7]),
        (image(nibabel.MGHImage), [0, 1, 2]),
        (image(nibabel.MGHImage, 500), [0, 0.5, 1]),
        (image(nibabel.Nifti1Image, 500, "msec"), [0, 0.5, 1]),
        (image(nibabel.Nifti1Image, 0.5, "sec"), [0, 0.5, 1]),
        (image(nibabel.Nifti1Image, 500), [0, 1, 2]),
    ],
)
def test_frames_of_objects_are_read(given, times):
    read = frames_of(given, BALL)
    found = check_frames(BALL, read.values, read.times, None, None)
    assert_allclose(found.values[:, :, 0], FRAMES, atol=1e-6)
    assert_allclose(found.times, times)


def test_time_step_replaces_times(tmp_path):
    quick = abfm.sequences.defaults(sigma=0.1)
    estimate = source_estimate(range(COUNT), (), FRAMES.T, [0.5, 0.6, 0.7])
    found = abfm.sequence(BALL, estimate, parameters=quick, dt=0.25)
    assert_array_equal(found.times, [0, 0.25, 0.5])
    assert not found.notes
    found = abfm.sequence(BALL, FRAMES.T, parameters=quick, dt=2)
    assert_array_equal(found.times, [0, 2, 4])
    [note] = found.notes
    assert str(COUNT) in note
    found.save(tmp_path / "s.npz")
    assert abfm.load(tmp_path / "s.npz").notes == (note,)


def test_masked_frames_have_missing_values():
    given = [np.ma.array(frame, mask=frame > 0.5) for frame in FRAMES]
    found = frames_of(given, BALL)
    assert_array_equal(found.values, np.where(FRAMES > 0.5, np.nan, FRAMES))


def test_square_frames_are_rows_with_a_note():
    square = np.outer(np.arange(COUNT) + 1.0, X)
    found = frames_of(square, BALL)
    assert_array_equal(found.values, square)
    assert "rows" in found.notes[0]
