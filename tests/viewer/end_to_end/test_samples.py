"""The menu Samples: every bundled mesh and every figure of the paper opens ready to match."""

import pickle
import time

import numpy as np
import pytest
from PIL import Image

from abfm import Parameters, load_mesh
from abfm.assets import asset_names, asset_path
from abfm.experiments import FigureSetup, example_of, match_of_flow, script
from abfm.parameters import FIGURES
from abfm_viewer.appearance.samples import (
    CORTEX,
    MESHES,
    PAIR,
    PICTURES,
    POPULATION,
    SIDE,
    WAVE,
    vertices,
)
from abfm_viewer.automation import Driver
from abfm_viewer.scene.scene import Scene
from tests.mesh_writers import off_text
from tests.messages import check_message
from tests.shapes import icosphere

SIZE = (640, 480)  # large enough for the menu
IN_SUBPROCESS = (2, 7)
"""Figures that a subprocess sets up here, as it does all figures in the app.

One has a flow, and one has values of a file.
"""


@pytest.fixture(scope="module")
def samples():
    with Driver(icosphere(1), size=SIZE) as driver:
        yield driver


def wait(gui, condition, seconds=60):
    """Wait with few frames, which take time from the computation."""
    end = time.monotonic() + seconds
    while not condition(gui.session):
        assert time.monotonic() < end, "the condition was not met in time"
        time.sleep(0.1)
        gui.frames(1)


@pytest.mark.parametrize("figure", FIGURES)
def test_figure_is_ready_to_match(samples, figure, monkeypatch):
    example = example_of(script(figure, FigureSetup()))
    problem, flow = example.problem, example.flow
    if figure not in IN_SUBPROCESS:
        received = pickle.loads(pickle.dumps((example, match_of_flow(example))))
        monkeypatch.setattr("abfm.experiments.example_in_subprocess", lambda _: received)
    samples.menu("Samples", f"Figure {figure}")
    ready, shape = f"figure {figure} is ready", problem.mesh.vertices.shape
    # the message disappears after a while
    wait(samples, lambda session: session.notices.latest.text.startswith(ready))
    wait(samples, lambda s: s.surface().mesh.vertices.shape == shape and not s.obstacle)
    session = samples.session
    np.testing.assert_array_equal(session.surface().mesh.vertices, problem.mesh.vertices)
    assert session.parameters == problem.parameters
    functions = session.functions.of_document(session.document)
    for side in ("source", "target"):
        values = [functions.evaluate(channel.spec(side)) for channel in session.channels]
        np.testing.assert_allclose(np.stack(values, axis=1), getattr(problem, side), atol=1e-12)
    assert not session.saves.unsaved
    assert (session.result is None) == (flow is None)
    if flow is not None:
        np.testing.assert_array_equal(session.result.velocity, flow.velocity)
    assert samples.text_of(f"Figure {figure}", "Samples") == "checked"
    samples.key("esc")
    assert vertices()[f"Figure {figure}"] == len(problem.mesh.vertices)
    assert samples.errors == {}


@pytest.mark.parametrize("name", MESHES)
def test_bundled_mesh_opens_like_a_file(samples, name):
    mesh = load_mesh(asset_path(name))
    samples.menu("Samples", name)
    wait(samples, lambda session: session.document.name == name and not session.obstacle)
    np.testing.assert_array_equal(samples.session.surface().mesh.vertices, mesh.vertices)
    assert vertices()[name] == len(mesh.vertices)
    assert samples.window.files.state.recent()[0] == (asset_path(name),)
    assert [w.label for w in opened_menu(samples) if w.text == "checked"] == [name]
    samples.key("esc")


def test_mesh_after_a_figure_has_defaults(samples, tmp_path):
    samples.menu("Samples", "Figure 9")
    wait(samples, lambda session: "9" in samples.window.files.sample and not session.obstacle)
    assert samples.session.parameters != Parameters()
    path = tmp_path / "own.off"
    path.write_text(off_text(icosphere(2).vertices, icosphere(2).faces))
    samples.window.files.open(path)
    wait(samples, lambda session: session.document.name == path.name and not session.obstacle)
    assert samples.session.parameters == Parameters()
    assert samples.session.view == samples.session.view.preferences


def test_pair_of_shapes_is_ready_to_match(samples):
    samples.menu("Samples", PAIR)
    wait(samples, lambda session: session.document.name == PAIR and not session.obstacle)
    a, b = (load_mesh(asset_path(name)) for name in PAIR.split(" to "))
    for mesh, slot in ((a, "source"), (b, "target")):
        np.testing.assert_array_equal(samples.session.surface(slot).mesh.vertices, mesh.vertices)
    # the values of B are in their own unit, with the colours of A
    assert samples.session.work.flow_values("target") is samples.session.values("target")
    assert not samples.session.saves.unsaved
    assert [w.label for w in opened_menu(samples) if w.text == "checked"] == [PAIR]
    samples.key("esc")


def test_cortices_are_ready_to_match(samples, monkeypatch):
    """Both cortices open ready to match; without nilearn the message names the extra to install."""
    samples.menu("Samples", CORTEX)
    wait(samples, lambda s: s.document.name == "left cortex to right cortex" and not s.obstacle)
    session = samples.session
    left, right = session.work.flow_values("source"), session.work.flow_values("target")
    # the initial map is the best rotation of the mirror image
    assert np.corrcoef(left, right)[0, 1] > 0.85
    assert np.corrcoef(session.values("source"), right)[0, 1] < 0.5
    fronts = [surface.front.direction for surface in session.document.surfaces]
    assert fronts == [(-1, 0, 0), (1, 0, 0)]  # both lateral, although the spheres are equal
    paints = samples.window.scene.paints  # all surfaces have the same unit and colours
    assert len({(paint.bar, paint.colors) for paint in paints.values()}) == 1
    on_a = paints["source"].values
    assert np.corrcoef(session.values("source"), on_a)[0, 1] == pytest.approx(1)
    assert abs(on_a.std() - right.std()) < 0.2
    assert not session.saves.unsaved
    monkeypatch.setattr("abfm_viewer.window.wave.find_spec", lambda name: None)
    samples.menu("Samples", PAIR)
    wait(samples, lambda s: s.document.name == PAIR and not s.obstacle)
    samples.menu("Samples", CORTEX)
    wait(samples, lambda s: s.notices.latest.is_error)
    check_message(session.notices.latest.text, "abfm[brain]")


def opened_menu(gui):
    """Open Samples, and return its entries."""
    gui.click("Samples")
    gui.frames(2)
    return [w for w in gui.window.ui.widgets if w.section == "Samples"]


def test_every_sample_has_a_thumbnail(samples):
    assert sorted(MESHES) == sorted(name for name in asset_names() if name.endswith(".off"))
    names = [*MESHES, *(f"Figure {figure}" for figure in FIGURES), CORTEX, WAVE]
    assert list(vertices()) == names
    image = np.asarray(Image.open(PICTURES).convert("RGBA"))
    rows, columns = image.shape[0] // SIDE, image.shape[1] // SIDE
    tiles = [tile for row in np.split(image, rows) for tile in np.split(row, columns, axis=1)]
    for tile in tiles[: len(names)]:
        assert 0.02 < (tile[..., 3] > 128).mean() < 0.95  # a surface on an empty background
        assert tile[tile[..., 3] > 128, :3].std() > 5
    assert PICTURES.stat().st_size < 100_000
    figures = names[len(MESHES) : -2]
    listed = [*MESHES, PAIR, CORTEX, WAVE, POPULATION, *figures]
    assert [w.label for w in opened_menu(samples)] == listed
    samples.key("esc")


@pytest.mark.parametrize("scale", [1.0, 2.0])
def test_samples_fit_into_the_window(samples, scale):
    samples.session.editor.set_view("scale", ui_scale=scale)
    assert all(
        0 <= w.rect[0] < w.rect[2] <= SIZE[0] and 0 < w.rect[1] < w.rect[3] <= SIZE[1]
        for w in opened_menu(samples)
    )
    samples.key("esc")
    samples.session.editor.set_view("scale", ui_scale=1.0)


def test_thumbnails_are_loaded_again_after_removal(samples):
    for _ in range(2):
        assert opened_menu(samples)
        samples.frames(3)
        samples.key("esc")
        samples.window.scene = Scene(samples.window.shown)  # this call removes all structures
        samples.frames(2)
    assert samples.errors == {}
