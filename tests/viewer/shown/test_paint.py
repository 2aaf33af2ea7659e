from dataclasses import replace
from typing import get_args

import numpy as np
import pytest

from abfm import TriangleMesh, baselines
from abfm.baselines import linear_blend, optimal_transport
from abfm.mesh.subdivision import subdivided
from abfm.reading.labels import Labels
from abfm_viewer.document.document import Coloring
from abfm_viewer.document.label_map import LabelMap
from abfm_viewer.session.session import Session
from abfm_viewer.shown.paint import Painter
from abfm_viewer.shown.quantities import Field
from abfm_viewer.shown.shown import Shown
from tests.core.fields import wavy_field
from tests.messages import check_message
from tests.viewer.sessions import PAIR, SPHERE, ready, until


@pytest.fixture
def painter(shown):
    return Painter(shown)


def show(session, **values):
    session.editor.amend(view=replace(session.view, **values))


def set_source(session, spec):
    session.editor.set_spec("source", spec)
    ready(session)


@pytest.mark.parametrize(
    ("view", "names"),
    [
        ({}, ("source", "advected", "target")),
        ({"blend": True, "error": True}, ("source", "advected", "linear blend", "error", "target")),
        (
            {"blend": True, "transport": True, "error": True},
            ("source", "advected", "linear blend", "optimal transport", "error", "target"),
        ),
        ({"layout": "advected only"}, ("advected",)),
        ({"layout": "advected only", "error": True}, ("advected", "error")),
        ({"hidden": ("source", "error")}, ("advected", "target")),
        ({"hidden": ("source", "advected", "target")}, ("advected",)),
    ],
)
def test_surfaces_have_the_order_of_the_flow(session, view, names):
    show(session, **view)
    assert session.view.shown_surfaces == names


def test_finer_mesh_is_shown_on_request(session, painter):
    fine = subdivided(SPHERE)
    problem = session.result.problem.with_specs([PAIR.source], [PAIR.target])
    field = 0.3 * wavy_field(fine, 0)[None]
    found = replace(session.result, problem=problem, fine_velocity=field)
    advected = found.fine.advected[: len(SPHERE.vertices)]
    session.editor.amend(result=replace(found, advected=advected))
    names = session.view.shown_surfaces
    assert all(painter.paint(name).mesh is None for name in names)
    show(session, finer=True)
    for time in (session.parameters.tau, 0.4):
        session.set_time(time)
        until(lambda: all(painter.paint(name).mesh for name in names), session)
        until(lambda: painter._shown.flow.settled and not painter._shown.flow.busy, session)
        for name in names:
            paint = painter.paint(name)
            assert len(paint.values) == len(paint.mesh.vertices) == len(fine.vertices)
            assert painter.paint(name) is paint
        values = painter.paint("advected").values[: len(SPHERE.vertices)]
        np.testing.assert_allclose(values, found.advect(time)[:, 0], atol=1e-6)
    show(session, coloring="speed")
    assert painter.paint("advected").mesh is None
    show(session, coloring="function", finer=False)
    assert all(painter.paint(name).mesh is None for name in names)


def test_functions_share_one_color_range(session, painter):
    """Zero is in the middle of the range of functions of both signs."""
    show(session, blend=True, transport=True)
    until(lambda: painter.paint("optimal transport"))
    paints = [painter.paint(name) for name in session.view.shown_surfaces]
    assert {paint.bar for paint in paints} == {"function"}
    low = min(session.values(side).min() for side in ("source", "target"))
    high = max(session.values(side).max() for side in ("source", "target"))
    assert 0 < low < 1e-6  # non-negative functions have a range from 0
    assert {(paint.colors.low, paint.colors.high) for paint in paints} == {(0.0, high)}
    set_source(session, "eigenfunction:2")
    colors = painter.paint("source").colors
    assert colors.low == -colors.high < 0


def test_paint_is_the_same_object_until_it_changes(session, painter):
    before = painter.paint("target")
    assert painter.paint("target") is before
    show(session, colormap="viridis")
    assert painter.paint("target").colors.colormap == "viridis"


@pytest.mark.parametrize("coloring", get_args(Coloring))
@pytest.mark.parametrize("share", [0.4, 1.0])
def test_unchanged_surfaces_are_not_redrawn(session, coloring, share, shown, painter):
    show(session, coloring=coloring, blend=True, transport=True, error=True)
    mesh = session.surface().mesh
    labels = LabelMap.of("halves", mesh, Labels((mesh.vertices[:, 0] > 0).astype(int)))
    session.editor.amend(labels=labels)
    session.set_time(share * session.parameters.tau)

    def paints():
        return [painter.paint(name) for name in session.view.shown_surfaces]

    def settled():
        paints()
        busy = shown.busy or shown.quantities.busy or shown.mass_transport.busy
        return shown.flow.settled and not busy

    until(settled)
    assert paints()[1].title != "advected" or coloring == "function"
    assert all(now is before for now, before in zip(paints(), paints(), strict=True))


def settled_transport(shown, painter):
    """Return the paint of optimal transport, when all computations are done."""
    until(lambda: (painter.paint("optimal transport"), shown.mass_transport.busy)[1] is False)
    return painter.paint("optimal transport")


def test_blend_and_transport_end_at_tau(session, shown, painter):
    show(session, blend=True, transport=True)
    tau, (source, target) = session.parameters.tau, map(session.values, ("source", "target"))
    for time, share in ((0.0, 0.0), (0.25 * tau, 0.25), (tau, 1.0), (1.5 * tau, 1.0)):
        session.editor.amend(time=time)
        expected = linear_blend(source, target, share, 1.0)
        np.testing.assert_allclose(Painter(shown).paint("linear blend").values, expected)
        expected = optimal_transport(session.surface().mesh, source, target, share, sharpen=True)
        np.testing.assert_array_equal(settled_transport(shown, painter).values, expected)


def test_earlier_transport_is_shown_during_a_computation(session, held, shown, painter):
    show(session, transport=True)
    session.editor.amend(time=0.0)
    before = settled_transport(shown, painter)
    _, may_end = held(baselines, "optimal_transport")
    session.editor.amend(time=0.5 * session.parameters.tau)
    meanwhile = painter.paint("optimal transport")
    assert meanwhile.values is before.values
    assert meanwhile.title == "optimal transport: computing"
    assert shown.mass_transport.busy
    may_end.set()
    assert abs(settled_transport(shown, painter).values - before.values).max() > 0.1


def test_transport_of_negative_functions_has_a_note(session, shown, painter):
    show(session, transport=True)
    set_source(session, "eigenfunction:2")
    paint = settled_transport(shown, painter)
    assert paint.title == "optimal transport: no values"
    assert np.ptp(paint.values) == 0
    check_message(shown.mass_transport.error, "f")
    assert painter.paint("linear blend") is not None
    session.undo()
    ready(session)
    assert settled_transport(shown, painter).title == "optimal transport"
    assert (shown.mass_transport.error, shown.mass_transport.note) == ("", "")
    gaussians = "gaussian:x=1,y=0,z=0,width=0.15 + gaussian:x=-1,y=0,z=0,width=0.15,height=-0.005"
    set_source(session, gaussians)
    assert settled_transport(shown, painter).values.min() >= 0
    note = "optimal transport replaces negative values (down to -0.005) by 0"
    assert shown.mass_transport.note == note


def test_error_is_that_of_the_shown_time(session, shown):
    session.editor.amend(time=session.parameters.tau)
    paint = Painter(shown).paint("error")
    expected = abs(session.values("target") - session.result.advected[:, 0])
    np.testing.assert_array_equal(paint.values, expected)
    assert (paint.colors.low, paint.colors.high) == (0, expected.max())
    assert f"{expected.max():.3g}" in paint.bar


def test_coordinates_are_shown_as_colors(session, shown):
    show(session, coloring="coordinates")
    colors = Painter(shown).paint("source").values
    assert colors.shape == SPHERE.vertices.shape
    np.testing.assert_array_equal(colors.argmax(axis=0), SPHERE.vertices.argmax(axis=0))
    assert (colors.min(), colors.max()) == (0, 1)


def test_side_without_values_is_grey(session, painter):
    target = painter.paint("target").values
    session.editor.set_spec("source", "eigenfunction:100000")
    until(lambda: session.work.error("source"), session)
    paint = painter.paint("source")
    assert paint.title == "source: no values"
    assert paint.colors is None
    assert np.ptp(paint.values) == 0
    assert painter.paint("target") is None  # unchanged, because no range is known
    session.undo()
    ready(session)
    assert painter.paint("source").title == "source"
    np.testing.assert_array_equal(painter.paint("target").values, target)


def test_speed_has_a_unit_of_the_mesh(session, painter):
    """Speeds are in sqrt(area), so that single precision fits meshes in any unit."""
    show(session, coloring="speed")
    until(lambda: painter.paint("advected").kind == "face values", session)
    found, speed = painter.paint("advected"), np.linalg.norm(session.result.velocity[0], axis=1)
    np.testing.assert_allclose(found.values, speed / SPHERE.length_scale)
    assert found.colors.high == found.values.max()


@pytest.mark.parametrize("scale", [1e40, 1e-30])
def test_speed_colors_do_not_depend_on_mesh_size(scale):
    mesh = TriangleMesh(scale * SPHERE.vertices, SPHERE.faces)
    velocity = np.cross([0, 0, 1.0], mesh.vertices[mesh.faces].mean(axis=1))
    field = Field(mesh, velocity, np.linalg.norm(velocity, axis=1), {})
    session = Session(mesh, "sphere")
    try:
        paint = Painter(Shown(session))._speed(field, "speed")
    finally:
        session.close()
    assert 0.1 < paint.values.max() < 1
    assert paint.colors.high == paint.values.max()
    assert paint.bar == "speed, in sqrt(area) per time"
    assert np.isfinite(np.asarray(paint.values, dtype=np.float32)).all()


def test_titles_note_extrapolation_and_exceeded_range(session, shown, monkeypatch):
    tau, source = session.parameters.tau, session.values("source")
    show(session, error=True)
    high = max(session.values(side).max() for side in ("source", "target"))
    for share, factor, expected in (
        (1.0, 1.0, "advected"),
        (1.0, 3.0, f"advected: 0 to {3 * high:.2g}"),
        (1.5, 1.0, "advected, extrapolated"),
        (1.5, -1.0, f"advected, extrapolated: {-high:.2g} to 0"),
    ):
        session.editor.amend(time=share * tau)
        values = factor * high * (source - source.min()) / np.ptp(source)
        monkeypatch.setattr(shown.flow, "advected", lambda values=values: values)
        painter = Painter(shown)
        assert painter.paint("advected").title == expected
        assert painter.paint("error").title == ("error, extrapolated" if share > 1 else "error")
        assert painter.paint("advected") is painter.paint("advected")
    show(session, coloring="checker")
    until(lambda: Painter(shown).paint("advected").title == "advected checker, extrapolated")
