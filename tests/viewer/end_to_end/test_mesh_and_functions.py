"""Tours of Functions: channels, families, Gaussians by widget, and vertex maps.

Both sides are drawn by the same code, so the widgets are tried on one of them.
"""

import numpy as np
import pytest
from nibabel.freesurfer import write_annot

from abfm.functions import families, function, parse
from abfm_viewer.document.gaussians import gaussians
from tests.viewer.sessions import EGG, QUICK, match, take_back


def settled(gui):
    gui.wait(lambda s: not s.obstacle)


def test_tour_of_channels_and_families(gui, walk):
    """All widgets of channels, Gaussians and families are used."""
    walk(gui, edit_channels_and_gaussians, scale_and_smooth_by_hints, use_each_family)
    walk(gui, keep_the_place_of_the_target)
    walk(gui, match_two_channels, scale_a_function)


def test_tour_of_functions_from_files(gui, walk):
    walk(gui, make_phases_circular, open_values_and_vertex_maps)


def match_two_channels(gui):
    gui.click("Add channel")
    for side in ("source", "target"):
        gui.choose("family", "eigenfunction", within=side)
    settled(gui)
    gui.session.editor.amend(parameters=QUICK)
    match(gui)
    assert gui.session.result.source.shape[1] == 2


def make_phases_circular(gui, tmp_path):
    """Use the box for values that jump by a period; it makes two channels, and one again."""
    assert "circular" not in gui.labels()
    x, y, _ = gui.session.surface().mesh.vertices.T
    np.save(tmp_path / "a.npy", np.degrees(np.arctan2(y, x)))
    spec = f"file:{tmp_path}/a.npy"
    for side in ("source", "target"):
        gui.session.editor.set_spec(side, spec)
    settled(gui)
    first = gui.session.channels
    gui.click("circular")
    settled(gui)
    parts = [f"circular:period=360.0,part={part}({spec})" for part in ("cosine", "sine")]
    assert [channel.specs for channel in gui.session.channels] == [(part, part) for part in parts]
    gui.session.undo()
    settled(gui)
    assert gui.session.channels == first
    gui.click("circular")
    settled(gui)
    gui.type("period", "180", within="source")
    assert gui.session.active.source == parts[0].replace("360", "180")
    gui.choose("part", "sine", within="source")
    assert gui.session.active.source == parts[1].replace("360", "180")
    gui.choose("part", "cosine", within="source")
    assert gui.session.active.source == parts[0].replace("360", "180")
    gui.choose("part", "both", within="source")
    for _ in range(4):
        gui.session.undo()
    gui.click("circular")
    assert gui.session.channels == first


def edit_channels_and_gaussians(gui):
    session = gui.session
    first = session.channels[0]
    gui.click("Add channel", within="Functions")
    assert len(session.channels) == 2
    gui.drag("weight", 3)
    assert session.active.weight == pytest.approx(3, abs=0.2)
    gui.type("weight", "0.5")
    gui.click("Duplicate")
    assert [c.weight for c in session.channels] == [1, 0.5, 0.5]
    gui.click(gui.labels()[gui.labels().index("Add channel") - 3])
    assert session.active == first
    gui.click("Swap")
    assert session.active.source == first.target
    gui.click("Remove")
    gui.click("Remove")
    assert len(session.channels) == 1
    assert not gui.is_enabled("Remove")
    take_back(gui)
    assert session.channels == (first,)
    side = "source"

    def bumps():
        return gaussians(gui.session.active.spec(side))

    gui.click("Open mesh...", within="Functions")
    gui.key("escape")
    gui.type("vertex", "12", within=side)
    gui.drag("width", 0.2, within=side)
    gui.type("width", "0.15", within=side)
    gui.click("Add Gaussian", within=side)
    assert [bump.width for bump in bumps()] == [0.15, 0.15]
    for metric in ("euclidean", "geodesic"):
        gui.choose("metric", metric, within=side)
    gui.type("height", "0.5", within=side)
    gui.drag("height", -1, within=side)
    gui.click("bump 1", within=side)
    assert bumps()[0].vertex == (12,)
    gui.click("bump 2", within=side)
    gui.click("Remove Gaussian", within=side)
    assert len(bumps()) == 1
    settled(gui)


def scale_and_smooth_by_hints(gui, notes):
    session = gui.session

    def set_specs(source, target):
        gui.type("spec", source, within="source")
        gui.type("spec", target, within="target")
        settled(gui)
        gui.wait(lambda s: s.work.expected_facts)
        gui.frames(2)

    assert "Scale source" not in gui.labels()
    for side in ("source", "target"):
        set_specs("coordinate:x", "expression:4*x+1")
        gui.click(f"Scale {side}")
        settled(gui)
        gui.wait(lambda s: s.work.expected_facts is None)
        source, target = (session.values(side) for side in ("source", "target"))
        np.testing.assert_allclose(source, target, atol=1e-4)
        assert "Scale source" not in gui.labels()
        assert session.active.spec(side).startswith("scaled")
        gui.key("ctrl+z")
        gui.wait(lambda s: s.work.expected_facts)
    two = "gaussian:vertex=12,width=0.25 + gaussian:vertex=44,width=0.05,height=0.5"
    set_specs(two, "gaussian:vertex=12,width=0.25")
    [hint] = [text for text, tone in notes() if tone == session.work.expected_facts.tone][-1:]
    assert "2 peaks" in hint
    gui.wait(lambda s: s.work.sufficient_smoothing)
    gui.click("Match")
    gui.frames(2)
    assert session.solver.running
    assert hint in [text for text, _ in notes()]
    gui.click("Cancel")
    gui.wait(lambda s: s.solver.finished)
    _, length = session.work.sufficient_smoothing
    gui.click("Smooth")
    settled(gui)
    smooth = f"smoothed:{length:g}({two})"
    assert (session.active.source, session.active.target[:9]) == (smooth, "smoothed:")
    gui.type("length", "0.15", within="source")
    gui.type("width", "0.2", within="target")
    assert session.active.source == f"smoothed:0.15({two})"
    assert session.active.target == f"smoothed:{length:g}(gaussian:vertex=12,width=0.2)"
    for _ in range(3):
        gui.key("ctrl+z")
    assert session.active.source == two
    settled(gui)


def keep_the_place_of_the_target(gui):
    """Draw the target at the same place below every family of the source."""
    places = set()
    for family in ("gaussian", "eigenfunction", "wks", "shape-diameter", "indicator"):
        gui.choose("family", family, within="source")
        gui.frames(2)
        [place] = {
            w.rect[1]
            for w in gui.window.ui.widgets
            if w.section.endswith("target") and w.label == "family"
        }
        places.add(place)
    gui.choose("shape", "half-space", within="source")
    gui.frames(2)
    [place] = {
        w.rect[1]
        for w in gui.window.ui.widgets
        if w.section.endswith("target") and w.label == "family"
    }
    assert places == {place}


def use_each_family(gui):
    """Choose and evaluate every family, and use all its controls."""
    side, drag, write, choose = "target", gui.drag, gui.type, gui.choose

    def spec():
        return gui.session.active.spec(side)

    def choose_each(label, within):
        gui.click(label, within)
        section = f"Functions/{within}/{label}"
        words = [w.label for w in gui.window.ui.widgets if w.section == section]
        gui.key("esc")
        for word in words:
            gui.choose(label, word, within)
            assert word in spec()

    controls = {
        "eigenfunction": [(drag, "index", 7), (write, "index", "4")],
        "hks": [(write, "time", "0.05"), (drag, "eigenpairs", 30)],
        "wks": [(write, "energy", "2"), (write, "width", "0.5")],
        "curvature": [(choose_each, "kind")],
        "coordinate": [(choose_each, "axis")],
        "geodesic": [(write, "vertex", "5")],
        "indicator": [
            *((drag, "radius", 0.3), (choose, "shape", "disc"), (choose, "shape", "half-space")),
            *((choose, "axis", "x"), (drag, "above", -0.5), (write, "below", "0.5")),
        ],
        "expression": [(write, "formula", "x*y")],
    }
    expected = {"eigenfunction": ":4", "geodesic": ":vertex=5", "expression": ":x*y"}
    for family in sorted(
        {cls.family for cls in families()}
        - {"gaussian", "file", "permuted", "scaled", "smoothed", "circular"}
    ):
        choose("family", family, within=side)
        assert spec().startswith(family)
        settled(gui)
        values = gui.session.values(side)
        assert np.isfinite(values).all()
        assert np.ptp(values) > 0
        for use, *words in controls.get(family, ()):
            use(*words, within=side)
        assert spec().startswith(f"{family}{expected.get(family, '')}")
        settled(gui)
    for text in ("coordinate:z", "coordinate:w"):  # the last of the texts is refused
        write("spec", text, within=side)
        assert spec() == "coordinate:z"
    choose("family", "gaussian", within=side)
    write("spec", "gaussian:x=1,y=0,z=0,width=0.2", within=side)
    for name, number in (("x", "0.5"), ("y", "0.25"), ("z", "-0.125")):
        write(name, number, within=side)
    settled(gui)
    assert spec() == "gaussian:x=0.5,y=0.25,z=-0.125,width=0.2"


def open_values_and_vertex_maps(gui, tmp_path):
    """Open values and vertex maps from files, and use the symmetry of the mesh."""
    side = "target"
    rng = np.random.default_rng(0)
    values, order = rng.normal(size=len(EGG.vertices)), rng.permutation(len(EGG.vertices))
    np.save(tmp_path / "values.npy", values)
    np.savetxt(tmp_path / "order.txt", order, fmt="%d")
    gui.choose("family", "file", within=side)
    gui.double_click("values.npy")
    settled(gui)
    np.testing.assert_array_equal(gui.session.values(side), values)
    for hemisphere in "LR":
        gui.choose("hemisphere", hemisphere, within=side)
        assert gui.session.active.spec(side).endswith(f"hemisphere={hemisphere}")
        gui.wait(lambda s, given=f"hemisphere={hemisphere}": given in s.obstacle)
    gui.choose("hemisphere", "auto", within=side)
    settled(gui)
    gui.click("Browse...", within=side)
    gui.key("escape")
    gui.type("path", str(tmp_path / "values.npy"), within=side)
    gui.choose("vertex map", "file...", within=side)
    gui.click("order.txt")
    gui.click("Open")
    settled(gui)
    np.testing.assert_array_equal(gui.session.values(side), values[order])
    gui.choose("vertex map", "order.txt", within=side)  # the map stays
    np.testing.assert_array_equal(gui.session.values(side), values[order])
    gui.choose("vertex map", "none", within=side)
    settled(gui)
    np.testing.assert_array_equal(gui.session.values(side), values)
    table = "\n".join(["a,b", *(f"{value!r},{2 * value!r}" for value in values.tolist())])
    (tmp_path / "table.csv").write_text(table)
    gui.type("path", str(tmp_path / "table.csv"), within=side)
    # the name of the file is in the message only once
    gui.wait(
        lambda s: "2 columns" in s.obstacle and s.obstacle.count("table.csv") == 1
    )  # an added line moves the widgets below it
    gui.type("column", "b", within=side)
    settled(gui)
    np.testing.assert_allclose(gui.session.values(side), 2 * values)
    keys = np.arange(len(values)) % 3
    colors = np.array([[10, 20, 30, 0], [20, 30, 40, 0], [30, 40, 50, 0]])
    write_annot(tmp_path / "lh.parts.annot", keys, colors, [b"top", b"middle", b"bottom"])
    gui.type("column", "0", within=side)
    settled(gui)
    gui.type("path", str(tmp_path / "lh.parts.annot"), within=side)
    gui.wait(lambda s: "label=" in s.obstacle)
    gui.type("label", "middle", within=side)
    settled(gui)
    np.testing.assert_array_equal(gui.session.values(side), keys == 1)
    # by its symmetry, the egg's function is unchanged
    side = "source"
    for word in ("mirror", "rotation"):
        gui.choose("vertex map", word, within=side)
        settled(gui)
        spec = gui.session.active.spec(side)
        assert spec.startswith(f"permuted:{word}(")
        np.testing.assert_array_equal(
            gui.session.values(side), function(gui.session.surface().mesh, spec)
        )
    gui.choose("vertex map", "none", within=side)
    assert "permuted" not in gui.session.active.spec(side)


def scale_a_function(gui):
    gui.type("spec", "scaled:2(coordinate:x)", "source")
    gui.type("factor", "3", "source")
    gui.type("offset", "1", "source")
    spec = parse(gui.session.channels[0].source)
    assert (spec.factor, spec.offset) == (3, 1)
    assert str(spec.function) == "coordinate:x"
