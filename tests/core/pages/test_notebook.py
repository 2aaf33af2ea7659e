"""Meshes and results in a notebook and in a browser."""

import re
import webbrowser
from functools import cache
from html import escape, unescape
from pathlib import Path

import nbclient
import nbformat
import numpy as np
import pytest

import abfm
from abfm import AbfmError, ParameterError
from abfm.pages import notebook
from abfm.population import Channel
from tests.core.pages.test_page import EVIL
from tests.messages import check_message, raises
from tests.shapes import icosphere, square

EXAMPLES = Path(__file__).parents[3] / "docs" / "examples"
EXAMPLE = EXAMPLES / "one_surface" / "plot_trimesh_notebook.py"
BALL = icosphere(2)
X = BALL.vertices[:, 0]
QUICK = abfm.Parameters.of(iterations=2, refine=0)


def small_population():
    """Return five subjects with two channels; the last is excluded, and vertex 0 is unknown."""
    noise = np.random.default_rng(0).normal(size=(5, len(X), 2))
    values = X[:, None] + 0.1 * noise
    values[:, 0] = np.nan
    ones, faces = np.ones((5, len(X))), len(BALL.faces)
    return abfm.Population(
        BALL,
        (Channel("sulc"), Channel("<b>thickness", is_held_out=True)),
        names=tuple("abcde"),
        weights=np.ones(5),
        channel_weights=np.array([1.0, 0.0]),
        fits=np.arange(5) < 4,
        reasons=("", "", "", "", "its map folds 20% of the faces"),
        verdicts=("registered",) * 5,
        digests=("0" * 64,) * 5,
        before=values + 0.5 * noise,
        values=values,
        masks_before=ones,
        masks=ones,
        template_mask=ones[0],
        numbers=np.zeros((5, 7)),
        phases=np.zeros((2, 4)),
        log2_area_mean=np.zeros(faces),
        log2_area_deviation=np.zeros(faces),
        drift=np.zeros((faces, 3)),
        changes=np.array([0.5, 0.012]),
    )


@cache
def found():
    """Return shown objects with the text that their view contains, by kind."""
    match = abfm.match(BALL, X, X + 0.1 * BALL.vertices[:, 1], QUICK)
    frames = [np.sin(3 * (X - 0.02 * t)) for t in range(3)]
    sequence = abfm.sequence(BALL, frames, parameters=abfm.sequences.defaults(sigma=0.1))
    other = abfm.TriangleMesh(BALL.vertices * (1.0, 1.1, 0.9), BALL.faces)
    registration = abfm.register(other, BALL, X, X, initial="connectivity", parameters=QUICK)
    return {
        "mesh": (BALL, "162 vertices, 320 faces, closed"),
        "match": (match, match.facts.headline),
        "registration": (registration, registration.facts.headline),
        "sequence": (sequence, sequence.facts.headline),
        "correspondence": (registration.initial, "surface B, 162 vertices and 320 faces"),
        "population": (small_population(), "4 of 5 subjects included"),
    }


def frame_of(view):
    [page] = re.findall(r'srcdoc="([^"]*)"', view)
    return unescape(page)


@pytest.mark.parametrize(
    "kind", ["mesh", "match", "registration", "sequence", "correspondence", "population"]
)
def test_views_have_verdict_and_page(kind):
    shown, headline = found()[kind]
    view = shown._repr_html_()
    about, _ = view.split("<iframe", 1)
    assert headline in unescape(about)
    assert kind.capitalize() in about
    assert 'sandbox="allow-scripts"' in view
    page = frame_of(view)
    assert page.startswith("<!doctype html>")
    assert '<body class="embedded">' in page
    assert len(view) < 400_000


def test_page_of_a_population_has_means_and_deviation():
    population, _ = found()["population"]
    page = notebook.page_of(population)
    assert page.tone == "warning"
    check_message(page.headline, "4 of 5", "0.012")
    check_message(page.notes[1], "e", "folds 20%")
    for c in range(2):
        before, after, deviation = (panel.layers[c] for panel in page.panels)
        np.testing.assert_array_equal(before.values, population.plain_mean(c))
        np.testing.assert_array_equal(after.values, population.mean(c))
        np.testing.assert_array_equal(deviation.values, population.deviation(c))
        assert np.isnan(after.values).tolist() == [True] + 161 * [False]
        assert before.colors == after.colors
        assert deviation.colors.low == 0


def test_page_of_a_map_shows_coordinates_of_a():
    ball = icosphere(2)
    turned = abfm.TriangleMesh(ball.vertices[:, [1, 2, 0]], ball.faces)
    same = abfm.Correspondence.through_sphere(turned, ball, ball.vertices, ball.vertices)
    page = notebook.page_of(same)
    assert page.title == "correspondence"
    assert page.facts["folded faces"] == "0 of 320"
    on_a, on_b = page.panels
    for c in range(3):
        np.testing.assert_allclose(on_b.layers[c].values, on_a.layers[c].values, atol=1e-12)
        assert on_b.layers[c].colors == on_a.layers[c].colors


def test_hostile_names_are_escaped(tmp_path):
    path = tmp_path / f"{EVIL.replace('/', '')} 'x'.npy"
    np.save(path, X)
    spec = f"file:{abfm.functions.quoted(str(path))}"
    view = abfm.match(BALL, spec, spec, QUICK)._repr_html_()
    assert "<script>document" not in view
    assert "<img" not in view
    page = frame_of(view)
    assert page.count("<script") == 3  # scripts: data, arrays and the program
    assert "<img" not in page
    assert view.count("<iframe") == 1


def test_view_reports_the_error_of_a_page(monkeypatch):
    def refuse(*given, **named):
        raise AbfmError(EVIL)

    monkeypatch.setattr(notebook, "page_of", refuse)
    view = BALL._repr_html_()
    assert escape(EVIL[:30]) in view
    assert "<script" not in view


def test_fine_surfaces_are_coarsened(monkeypatch):
    monkeypatch.setattr(notebook, "VERTICES_MAX", 60)
    match, _ = found()["match"]
    view = match._repr_html_()
    check_message(re.search("Shown on[^<]*", view)[0], 60, 162)
    page = notebook.coarser(notebook.page_of(match), 60)
    for panel in page.panels:
        assert 20 < len(panel.mesh.vertices) <= 75
        [layer] = panel.layers
        assert layer.values.shape[-1] == len(panel.mesh.vertices)
    # the source is x, also on the coarser sphere, whose vertices are inside the fine one
    coarse = page.panels[0]
    assert np.abs(coarse.layers[0].values - coarse.mesh.vertices[:, 0]).max() < 0.1
    open_square = square(12)
    coarse = notebook.coarser(notebook.mesh_page(open_square, ""), 60).panels[0]
    assert len(coarse.mesh.vertices) < len(open_square.vertices)
    assert np.isnan(coarse.layers[0].values).all()


@pytest.mark.parametrize("bound", ["RESULT_VERTICES_MAX", "BYTES_MAX"])
@pytest.mark.parametrize("kind", ["match", "correspondence", "population"])
def test_large_results_are_not_drawn(monkeypatch, bound, kind):
    monkeypatch.setattr(notebook, bound, 100)
    shown, headline = found()[kind]
    view = shown._repr_html_()
    assert "<iframe" not in view
    assert headline in unescape(view)
    check_message(re.search("Not drawn[^<]*", view)[0], "show")


def test_show_opens_a_page(monkeypatch, tmp_path, capsys):
    opened = []
    monkeypatch.setattr(webbrowser, "open", lambda address: opened.append(address) or True)
    path = BALL.show(tmp_path / "a ball.html")
    assert path.read_text("utf-8").count("a ball") == 2  # title and heading
    assert BALL.show().suffix == ".html"
    assert opened[0] == path.as_uri()
    assert len(opened) == 2
    assert not capsys.readouterr().out
    with raises(ParameterError, "up", "w"):
        BALL.show(up="w")


def test_show_without_a_browser_prints_the_path(monkeypatch, capsys):
    monkeypatch.setattr(webbrowser, "open", lambda address: False)
    path = BALL.show()
    assert str(path) in capsys.readouterr().out
    assert path.exists()


def notebook_of_example():
    """Return the gallery example as a notebook, with a cell for each part between ``# %%``."""
    parts = EXAMPLE.read_text("utf-8").split("# %%\n")
    return nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(part) for part in parts])


def test_gallery_example_runs_in_a_notebook():
    executed = notebook_of_example()
    nbclient.NotebookClient(executed, timeout=300).execute()
    outputs = [out for cell in executed.cells for out in cell.get("outputs", [])]
    shown = [out["data"] for out in outputs if "data" in out]
    views = [data["text/html"] for data in shown if "text/html" in data]
    assert sum("image/png" in data for data in shown) == 1
    assert len(views) == 3
    for view, words in zip(views, ("315 vertices", "Match: matched", "Registration"), strict=True):
        assert words in view
        assert '<body class="embedded">' in frame_of(view)
