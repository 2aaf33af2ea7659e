from dataclasses import replace

import numpy as np
import pytest

import abfm
from abfm.pages.colormaps import NO_VALUES, colors_of
from abfm.pages.sequence_motion import fast_speed_of
from abfm_viewer.appearance.samples import WAVE
from abfm_viewer.automation import Driver
from abfm_viewer.document.frame_sequence import SequenceSettings
from abfm_viewer.document.kinds import SequenceDocument
from abfm_viewer.document.surface_points import surface_points
from abfm_viewer.panels.right_panel import TABS
from abfm_viewer.scene.opengl import ps
from abfm_viewer.scene.scene import FAINT_TEXT, NO_VALUE
from abfm_viewer.session.session_files import open_session
from abfm_viewer.shown.eye import Eye
from abfm_viewer.window import wave
from abfm_viewer.window.actions import unsaved_work
from abfm_viewer.window.wave import turning_wave
from tests.messages import check_message
from tests.viewer.end_to_end.test_export import TITLE, exported
from tests.viewer.sessions import EGG, SIZE, restart

WINDOW = (800, 560)  # high enough for the complete plot
COUNT, STEP = 5, 0.05
TIMES = STEP * np.arange(COUNT)
DIRECTIONS = EGG.vertices / np.linalg.norm(EGG.vertices, axis=1)[:, None]
FRONT = Eye(np.eye(3))
FRAMES = turning_wave(DIRECTIONS, TIMES)[0]
SETTINGS = SequenceSettings(alpha=1.0, sigma=0.1, order=1)


@pytest.fixture
def opened(gui, tmp_path):
    """Return the app with five frames of a wave on the egg."""
    np.save(tmp_path / "wave.npy", FRAMES)
    gui.window.files.open(tmp_path / "wave.npy")
    gui.wait(lambda s: isinstance(s.document, SequenceDocument))
    gui.session.editor.set_sequence_settings(alpha=1.0, order=1, sigma=0.1)
    return gui


def settled(gui):
    gui.wait(lambda s: not (s.solver.running or gui.window.shown.busy))
    gui.frames(3)


def shown(gui, slot="advected"):
    settled(gui)
    return gui.window.scene.paints[slot]


def test_tour_of_opened_frames(gui, walk):
    """Frames are opened by the menu: phases, frames with gaps, their own side, the sample."""
    walk(gui, open_by_the_menu, show_the_changing_side, compare_phases_on_a_circle)
    walk(gui, ignore_vertices_without_values, open_the_sample)


def test_tour_of_frames(opened, tmp_path, walk):
    """Frames are viewed before their match, matched, and viewed in all ways afterwards."""
    take_the_tour(opened)
    show_frames_blended(opened)
    step_between_frames(opened)
    pause_and_cancel_the_run(opened, tmp_path)
    opened.click("Match all frames")
    opened.wait(lambda s: not s.solver.running)
    interpolate_between_frames(opened)
    walk(opened, draw_tracks, follow_points_and_lines, click_on_the_plot)
    walk(opened, match_two_frames, change_parameters, write_all_files)


def take_the_tour(gui):
    """Check that the tour explains frames instead of two functions."""
    tour = gui.window.tour
    gui.menu("Help", "Tour")
    gui.click("Next", within="tour")
    gui.frames(2)
    assert tour.title == "Frames"
    assert tour.target[2] < gui.window.parts.panel[2] - 5  # not the complete panel
    gui.key("escape")
    assert tour.title == ""


def pause_and_cancel_the_run(opened, tmp_path):
    """Pause and cancel a run with so many frames that it does not end before."""
    document = opened.session.document
    np.save(tmp_path / "long.npy", turning_wave(DIRECTIONS, 0.005 * np.arange(240))[0])
    opened.window.files.open(tmp_path / "long.npy")
    opened.wait(lambda s: s.document.sequence.name == "long.npy")
    opened.click("Match all frames")
    opened.click("Pause")
    assert opened.session.solver.paused
    opened.click("Resume")
    assert not opened.session.solver.paused
    opened.click("Cancel")
    opened.wait(lambda s: not s.solver.running)
    restart(opened, document)


def open_by_the_menu(gui, tmp_path, notes):
    """Leave out a frame without values; the others keep their numbers and times."""
    np.save(tmp_path / "wave.npy", np.insert(FRAMES, 2, np.nan, axis=0))
    gui.menu("File", "Open frames...")
    gui.click("wave.npy")
    gui.click("Open")
    gui.wait(lambda s: isinstance(s.document, SequenceDocument))
    np.testing.assert_array_equal(gui.session.document.sequence.frames.values[:, :, 0], FRAMES)
    assert gui.session.document.name == "wave.npy on mesh"
    assert shown(gui, "target").title == "frame 1"
    gui.click("Functions", within="steps")
    assert ("1 frame without values left out, counted from 0: 2.", "muted") in notes()
    assert gui.session.document.sequence.times.tolist() == [0, 1, *range(3, COUNT + 1)]
    gui.type("frame step", "0.5")
    assert gui.session.document.sequence.frame_label(2) == "frame 3, 1.5 s"
    assert gui.text_of("to frame", kind="box") == "1"
    gui.type("to frame", "3")
    assert gui.session.sequence_match.pair == (0, 2)


def compare_phases_on_a_circle(gui, tmp_path):
    """Use the box that exists only for phases, like `abfm sequence --circular`."""
    angles = np.arctan2(DIRECTIONS[:, 1], DIRECTIONS[:, 0])
    phases = np.degrees(angles + TIMES[:, None] + np.pi) % 360
    phases[1, :9] = np.nan
    np.save(tmp_path / "phases.npy", phases)
    gui.window.files.open(tmp_path / "phases.npy")
    gui.wait(lambda s: isinstance(s.document, SequenceDocument))
    before = gui.session.document.sequence
    gui.click("Functions", within="steps")
    gui.click("circular")
    gui.wait(lambda s: s.document.sequence.channels == 2)
    sequence = gui.session.document.sequence
    circle = np.stack([np.cos(np.radians(phases)), np.sin(np.radians(phases))], axis=-1)
    np.testing.assert_allclose(sequence.frames.values[:, 9:], circle[:, 9:], atol=1e-12)
    np.testing.assert_array_equal(sequence.frames.mask, np.arange(len(EGG.vertices)) >= 9)
    gui.choose("channel", "1")
    np.testing.assert_allclose(shown(gui, "source").values[9:], circle[0, 9:, 1], atol=1e-6)

    gui.session.undo()
    gui.session.undo()
    assert gui.session.document.sequence is before
    gui.session.redo()
    gui.type("frame step", "0.5")
    gui.click("circular")
    gui.wait(lambda s: s.document.sequence.channels == 1)
    sequence = gui.session.document.sequence
    np.testing.assert_array_equal(sequence.frames.values, before.frames.values)
    np.testing.assert_allclose(sequence.times, 0.5 * np.arange(COUNT))
    gui.click("circular")
    gui.wait(lambda s: s.document.sequence.channels == 2)

    expected = abfm.sequence(EGG, phases, 0.5 * np.arange(COUNT), SETTINGS.parameters, circular=360)
    gui.session.editor.set_sequence_settings(alpha=1.0, order=1, sigma=0.1)
    gui.click("Match all frames")
    gui.wait(lambda s: not s.solver.running)
    np.testing.assert_allclose(gui.session.document.result.velocity, expected.velocity)

    np.save(tmp_path / "wave.npy", FRAMES)
    gui.window.files.open(tmp_path / "wave.npy")
    gui.wait(lambda s: s.document.sequence.name == "wave.npy")
    assert "circular" not in gui.labels()


def show_frames_blended(opened):
    session, document = opened.session, opened.session.document
    assert document.name == "wave.npy on mesh"
    np.testing.assert_array_equal(document.sequence.frames.values[:, :, 0], FRAMES)
    opened.click("Functions", within="steps")
    opened.type("frame step", "soon")
    assert session.document.sequence.unit == ""
    opened.type("frame step", str(STEP))
    np.testing.assert_allclose(session.document.sequence.times, TIMES)
    opened.type("frame step", str(STEP))  # now with a unit of seconds
    np.testing.assert_allclose(session.document.sequence.times, TIMES)
    opened.type("time", "0.12")
    titles = {name: shown(opened, name).title for name in ("source", "advected", "target")}
    assert (titles["source"], titles["target"]) == ("frame 2, 0.1 s", "frame 3, 0.15 s")
    assert titles["advected"] == "at 0.1200 s, linear blend"
    np.testing.assert_allclose(shown(opened).values, 0.6 * FRAMES[2] + 0.4 * FRAMES[3], atol=1e-6)
    colors = {name: shown(opened, name).colors for name in titles}
    opened.type("time", "0")
    assert {name: shown(opened, name).colors for name in titles} == colors
    opened.pick(200, "source")
    check_message(session.notices.latest.text, "frames")
    opened.wheel(1, 200, "target")
    opened.key("m")
    check_message(session.notices.latest.text)
    while session.document.sequence.unit:
        opened.key("ctrl+z")
    np.testing.assert_array_equal(session.document.sequence.times, np.arange(COUNT))


def show_the_changing_side(gui, tmp_path):
    """Turn the view to the side with the largest changes, unless the user has turned it."""
    gui.frames(3)
    session, behind = gui.session, -gui.session.surface().front.axes[2]
    paths = tmp_path / "behind.npy", tmp_path / "missing.npy"
    away = np.maximum(DIRECTIONS @ behind, 0) ** 4
    frames = 0.2 * DIRECTIONS[:, 1] + np.sin(TIMES[:, None]) * away
    np.save(paths[0], frames)
    frames[2, away > 0.1] = np.nan
    frames[:, DIRECTIONS @ behind < -0.9] += TIMES[:, None]
    np.save(paths[1], frames)
    for path, sign in zip(paths, (1, -1), strict=True):
        gui.window.files.open(path)
        gui.wait(
            lambda s, path=path: (
                isinstance(s.document, SequenceDocument) and s.document.sequence.name == path.name
            )
        )
        gui.frames(3)
        assert sign * np.dot(session.surface().front.direction, behind) > 0.5
        np.testing.assert_allclose(gui.window.scene.view.rotation, session.surface().front.axes)
    x, y = gui.window.scene.view.slots["advected"].middle
    gui.input.drag((x, y), (x + 40, y + 10))
    turned = session.view.viewpoint
    gui.window.files.open(paths[0])
    gui.wait(lambda s: s.document.sequence.name == paths[0].name)
    gui.frames(3)
    assert session.view.viewpoint == turned is not None


def step_between_frames(opened):
    session, player = opened.session, opened.session.player
    clicks = [(opened.click, label, time) for label, time in ((">", 1), (">", 2), ("<", 1))]
    keys = ("right", 2), ("end", 4), ("right", 4), ("home", 0)
    for act, what, time in (*clicks, *((opened.key, key, time) for key, time in keys)):
        act(what)
        assert session.document.time == time
    opened.drag("time", 2.5)
    assert session.document.time == pytest.approx(2.5, abs=0.05)
    assert session.time == pytest.approx(session.document.time - 2)
    opened.click("to start")
    opened.choose("repeat", "once")
    opened.drag("speed", 4.0)
    opened.click("Play")
    opened.wait(lambda s: not player.playing)
    assert session.document.time == 4
    opened.choose("repeat", "loop")
    opened.drag("speed", 0.1)
    opened.click("Play")
    opened.wait(lambda s: 0 < s.document.time < 4)
    opened.click("Pause", within="time bar")


def interpolate_between_frames(solved):
    session = solved.session
    sequence = session.document.result
    assert sequence.confirmed == len(sequence) == COUNT - 1
    assert not session.document.is_outdated
    field = session.sequence_match.field(session.document, 2)
    np.testing.assert_array_equal(field, sequence.velocity[2])
    for time in (0.0, 2.25, 3.5, 4.0):
        solved.type("time", f"{time:g}")
        np.testing.assert_allclose(shown(solved).values, sequence.at(time), atol=1e-4)
    assert solved.window.shown.flow.state.field is session.sequence_match.field(session.document, 3)
    solved.click("Look", within="steps")
    solved.check("arrows")
    # the same scale for all intervals
    quantities = solved.window.shown.quantities
    solved.wait(
        lambda _: quantities.field() and quantities.arrows(quantities.field(), 300.0, FRONT)
    )
    speeds = [np.linalg.norm(field, axis=1) for field in sequence.velocity]
    fasts = [abfm.calculus.fast_speed(sequence.mesh, speed) for speed in speeds]
    fast = np.sqrt(np.mean(np.square(fasts)))
    assert min(fasts) < fast < max(fasts)
    assert fast_speed_of(sequence) == quantities.fast(quantities.field()) == pytest.approx(fast)
    solved.check("streaks")
    solved.type("time", "1.5")
    solved.wait(lambda _: solved.window.scene.paints["advected"].kind == "texture")
    solved.choose("colour by", "speed")
    settled(solved)
    assert shown(solved).kind == "texture"
    solved.check("streaks", on=False)
    expected = np.linalg.norm(sequence.velocity[1], axis=1)
    np.testing.assert_allclose(shown(solved).values, expected)
    assert shown(solved).bar == "speed, in the mesh's unit per frame"
    solved.key("ctrl+z")
    while session.document.result is not None:
        solved.key("ctrl+z")
    assert session.editor.redo_label == "match all frames"
    solved.key("ctrl+y")


def change_parameters(solved, notes):
    session = solved.session
    solved.click("Match", within="steps")
    assert session.document.settings == SETTINGS
    solved.drag("gamma", 10)
    solved.click("auto alpha")
    assert session.document.settings.alpha is None
    solved.type("alpha", "2")
    for choice, order in (("auto", None), ("1", 1), ("2", 2)):
        solved.choose("order", choice)
        assert session.document.settings.order == order
    solved.type("alpha", "-1")
    solved.click("auto sigma")  # alpha does not become automatic
    solved.type("sigma", "0.2")
    assert session.document.settings == SequenceSettings(
        2.0, 0.2, session.document.settings.gamma, 2
    )
    assert session.document.settings.gamma == pytest.approx(10, rel=0.2)
    assert session.document.is_outdated
    assert any(text.startswith("Frames or parameters") for text, _ in notes())
    for _ in range(20):
        if session.document.is_outdated:
            solved.key("ctrl+z")
    assert session.document.settings == SETTINGS


def click_on_the_plot(solved):
    session = solved.session
    solved.click("Match", within="steps")
    solved.click("interval 2")
    assert session.document.time == 2.5
    solved.click("speed", within="Match")
    settled(solved)
    solved.click("interval 0")
    assert session.document.time == 0.5
    speeds = session.sequence_match.speeds(session.document)
    np.testing.assert_allclose(speeds, session.document.result.speed)
    solved.click("residual")
    assert not session.view.speeds


def draw_tracks(solved):
    session, tracks = solved.session, solved.window.shown.tracks
    solved.click("Look", within="steps")
    solved.check("tracks")
    settled(solved)
    expected = session.document.result.tracks()
    paths = tracks.paths()
    starts, expected_starts = ([(t.kind, t.times[0]) for t in each] for each in (paths, expected))
    assert starts == expected_starts
    assert {path.kind for path in paths} == {"spiral"}
    assert ps.has_surface_mesh("tracks of each spiral")
    [there, *_] = [track.points.positions[1] for track in expected]
    solved.type("time", "1.5")
    settled(solved)
    assert np.linalg.norm(tracks.now()["spiral"] - there, axis=1).min() < 1e-9
    solved.check("tracks", on=False)
    settled(solved)
    assert not ps.has_surface_mesh("tracks of each spiral")


def follow_points_and_lines(solved):
    """Follow points through all frames, and lines along the field of the present interval."""
    session, quantities = solved.session, solved.window.shown.quantities
    sequence, [vertex] = session.document.result, [200]
    solved.click("Look", within="steps")
    solved.click("follow a point")
    solved.pick(vertex, "advected", modifiers=())
    solved.wait(lambda _: quantities.paths())
    (path,) = quantities.paths()
    paths = sequence.paths(surface_points(EGG, session.document.points))
    for time in (1, 3, 4):
        solved.type("time", str(time))
        here = path.at(quantities.path_time)
        # exact for constant fields; the window uses a continuous field
        np.testing.assert_allclose(here, paths[time].positions[0], atol=0.02)
    assert np.linalg.norm(here - path.at(0.0)) > 0.15
    solved.click("flow line")
    solved.pick(vertex, "advected", modifiers=())
    solved.wait(lambda _: quantities.lines())
    lines = quantities.lines()
    length = sum(np.linalg.norm(np.diff(line.positions, axis=0), axis=1).sum() for line in lines)
    assert 0.3 < length / EGG.length_scale < 3
    solved.type("time", "0.5")
    solved.wait(lambda _: quantities.lines() is not lines)
    assert not np.array_equal(quantities.lines()[0].positions, lines[0].positions)


def match_two_frames(solved):
    session, sequence = solved.session, solved.session.document
    solved.click("Functions", within="steps")
    solved.type("time", "1.5")
    solved.type("to frame", "3")
    solved.click("Match these two frames")
    solved.wait(
        lambda s: not isinstance(s.document, SequenceDocument) and s.values("target") is not None
    )
    np.testing.assert_array_equal(session.values("source"), FRAMES[1])
    np.testing.assert_array_equal(session.values("target"), FRAMES[3])
    assert session.obstacle == ""
    solved.key("ctrl+z")
    assert session.document.sequence is sequence.sequence
    solved.drag("from frame", 2)
    assert solved.text_of("from frame", kind="box") == "2"


def write_all_files(solved, tmp_path):
    session, exporter = solved.session, solved.window.exporter
    found = session.document.result
    solved.type("time", "1.25")
    solved.window.files.save(tmp_path / "sequence.abfm")
    solved.wait(lambda s: not s.saves.unsaved and (tmp_path / "sequence.abfm").is_file())
    other = open_session(tmp_path / "sequence.abfm")
    document = other.document
    other.close()
    np.testing.assert_array_equal(document.result.velocity, found.velocity)
    np.testing.assert_array_equal(document.sequence.frames.values[:, :, 0], FRAMES)
    assert (document.time, document.settings) == (1.25, session.document.settings)
    assert document.result.verdicts == found.verdicts
    assert not document.is_outdated
    solved.click("Export", within="steps")
    session.editor.set_sequence_settings(gamma=2.0)
    check_message(unsaved_work(session), "wave.npy", "parameters")
    session.undo()
    assert not session.saves.unsaved
    exported(solved, "Sequence data", tmp_path / "sequence.npz")
    np.testing.assert_array_equal(abfm.load(tmp_path / "sequence.npz").velocity, found.velocity)
    exported(solved, "Table: tracks", tmp_path / "tracks.csv")
    assert (tmp_path / "tracks.csv").read_text().count("spiral") > COUNT
    exported(solved, "Table: intervals", tmp_path / "intervals.csv")
    assert len((tmp_path / "intervals.csv").read_text().splitlines()) == COUNT
    small = {"width": 320, "height": 240, "seconds": 0.2, "fps": 10}
    exporter.settings = replace(exporter.settings, **small)
    solved.click("Movie...")
    for label, time in (("from", document.start), ("to", document.end)):
        solved.type(label, f"{time:g}")
    solved.click("Close", within=TITLE)
    exported(solved, "Movie", tmp_path / "sequence.mp4")


def test_files_of_sequences_open(opened, tmp_path):
    """A sequence opens from arguments, by drops, and while another one is open."""
    path = tmp_path / "wave.npz"
    sequence = abfm.sequence(EGG, FRAMES, TIMES, abfm.sequences.defaults(sigma=0.2), 0.0)
    sequence.save(path)
    opened.session.switch_flow_after_match()
    opened.window.files.open(path)
    opened.wait(lambda s: s.document.result is not None)
    document = opened.session.document
    assert (document.sequence.unit, document.settings.gamma) == ("s", 0.0)
    assert not document.is_outdated
    assert document.view.tracks
    assert document.view.arrows
    settled(opened)
    opened.wait(lambda _: ps.has_surface_mesh("arrows"))
    opened.click("Look", within="steps")
    opened.check("arrows", on=False)
    opened.choose("colour by", "speed")
    opened.window.files.open(path)
    opened.wait(lambda s: s.document.identity is not document.identity)
    assert (opened.session.view.arrows, opened.session.view.coloring) == (True, "function")
    opened.choose("colour by", "function")
    opened.session.switch_flow_after_match()
    before = opened.session.document
    opened.window.files.open(path)
    opened.wait(lambda s: s.document.identity is not before.identity)
    assert not opened.session.view.arrows
    opened.window.files.open_dropped([tmp_path / "wave.npy"])
    opened.wait(lambda s: s.document.result is None)
    np.save(tmp_path / "short.npy", FRAMES[:, :9])
    opened.window.files.open(tmp_path / "short.npy")
    opened.wait(lambda s: s.notices.cards)
    assert "9" in opened.session.notices.cards[0].text
    opened.click("Open other frames...")
    opened.click("Cancel", "Open frames")
    opened.click("Functions", within="steps")
    opened.click("Open frames...", "Functions")
    opened.click("Cancel", "Open frames")
    mesh = tmp_path / "egg.ply"
    abfm.io.write_surface(mesh, EGG)
    np.savez(tmp_path / "two.npz", u=FRAMES, v=-FRAMES)
    with Driver((mesh, tmp_path / "two.npz"), size=SIZE) as gui:
        gui.wait(lambda _: gui.window.dialogs.is_open)
        gui.click("Open none", "Which array?")
        assert not isinstance(gui.session.document, SequenceDocument)
        for name, sign in (("u", 1), ("v", -1)):
            gui.window.files.open(tmp_path / "two.npz")
            gui.wait(lambda _: gui.window.dialogs.has_question("Which array?"))
            gui.click(name, "Which array?")
            gui.wait(lambda s: isinstance(s.document, SequenceDocument))
            gui.wait(
                lambda s, sign=sign: (
                    s.document.sequence.frames.values[0, :, 0] == sign * FRAMES[0]
                ).all()
            )
        assert gui.session.document.name == "two.npz on egg.ply"
        assert not gui.session.saves.unsaved
        np.testing.assert_array_equal(gui.session.document.sequence.columns[0][0], -FRAMES[0])


def ignore_vertices_without_values(gui, tmp_path):
    """Show and match two channels with common missing values."""
    frames = np.stack([FRAMES, FRAMES**2], axis=2)
    frames[1, :5] = np.nan
    np.save(tmp_path / "two.npy", frames)
    gui.window.files.open(tmp_path / "two.npy")
    gui.wait(lambda s: isinstance(s.document, SequenceDocument))
    gui.click("Functions", within="steps")
    gui.choose("channel", "1")
    assert gui.session.document.channel == 1
    np.testing.assert_allclose(shown(gui, "source").values[5:], FRAMES[0, 5:] ** 2)
    gui.choose("channel", "0")
    np.testing.assert_allclose(shown(gui, "source").values[5:], FRAMES[0, 5:])
    for name in ("source", "advected", "target"):
        assert np.flatnonzero(shown(gui, name).unknown).tolist() == [0, 1, 2, 3, 4]
    gui.type("time", "1.5")  # drawn with the same quantity
    now, buffer = shown(gui), ps.get_surface_mesh("advected").get_quantity_buffer
    colors = buffer(now.kind, "colors")
    expected = colors_of(now.values, now.colors, now.unknown)
    assert (expected[:5] == NO_VALUES).all()
    for vertex in (0, 4, 5, 200, 641):
        np.testing.assert_allclose(colors.get_value(vertex).as_tuple(), expected[vertex], atol=1e-6)
    assert gui.window.scene.legend() == (NO_VALUE,)
    gui.click("Functions", within="steps")
    gui.click("Match these two frames")
    gui.wait(
        lambda s: not isinstance(s.document, SequenceDocument) and s.values("target") is not None
    )
    document = gui.session.document
    names = [[document.display_names[spec] for spec in one.specs] for one in document.channels]
    assert names == [
        ["frame 1, channel 0", "frame 2, channel 0"],
        ["frame 1, channel 1", "frame 2, channel 1"],
    ]
    for name in ("source", "advected", "target"):
        gui.wait(lambda _, name=name: shown(gui, name).unknown is not None)
        assert np.flatnonzero(shown(gui, name).unknown).tolist() == [0, 1, 2, 3, 4]
    gui.key("ctrl+z")
    mask = gui.session.document.sequence.frames.mask
    assert (mask == 0).nonzero()[0].tolist() == [0, 1, 2, 3, 4]


def open_the_sample(gui, monkeypatch):
    """Open the sample sequence with and without nilearn."""
    gui.menu("Samples", WAVE)
    gui.wait(lambda s: isinstance(s.document, SequenceDocument))
    document = gui.session.document
    assert document.name == "wave on left cortex"
    assert len(document.sequence) == wave.FRAMES
    check_message(gui.session.notices.latest.text)
    assert gui.text_of(WAVE, "Samples") == "checked"
    gui.key("esc")
    monkeypatch.setattr(wave, "find_spec", lambda _: None)
    assert wave.wave_document(gui.session.view).name == "wave on eight.off"


def test_tabs_of_a_sequence_fit_one_screen(tmp_path):
    sequence = abfm.sequence(EGG, FRAMES, TIMES, abfm.sequences.defaults(sigma=0.2))
    sequence.save(tmp_path / "wave.npz")
    with Driver(tmp_path / "wave.npz", size=(1280, 800)) as gui:
        settled(gui)
        gui.wait(lambda _: gui.window.scene.legend() == ("spiral", FAINT_TEXT))
        for tab in TABS:
            gui.click(tab, within="steps")
            gui.frames(3)
            ends = [
                h for name, h in gui.window.ui.hidden_heights.items() if name.endswith(f"/{tab}")
            ]
            assert ends == [0]
        assert not gui.errors
