import threading
from dataclasses import asdict, replace

import pytest

import abfm
from abfm.numerics.factoring_in_subprocess import is_factored_in_subprocess
from abfm.workers.control import checkpoint
from abfm.workers.progress import step
from abfm_viewer.document.document import SIDES, Channel, Surface
from abfm_viewer.document.kinds import MatchDocument
from abfm_viewer.files import outputs
from abfm_viewer.files.preferences import with_stored
from abfm_viewer.session.saving.export_settings import ExportSettings
from abfm_viewer.session.saving.exporter import Exporter
from tests.messages import check_message
from tests.shapes import icosphere
from tests.viewer.sessions import until

CHANNEL = Channel("gaussian:x=1,y=0,z=0,width=0.2", "gaussian:x=0,y=1,z=0,width=0.2")


@pytest.fixture(scope="module")
def document():
    """Return a document with a short match on a sphere."""
    mesh = icosphere(2)
    f, g = (abfm.function(mesh, CHANNEL.spec(side)) for side in SIDES)
    match = abfm.match(mesh, f, g, abfm.Parameters.of(iterations=3, refine=0))
    known = {"parameters": match.parameters, "result": match}
    return MatchDocument((Surface(mesh, "sphere"),), (CHANNEL,), **known)


@pytest.fixture
def exporter(tmp_path, monkeypatch):
    """Return an exporter with small settings; `reports` are its messages."""
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(temporary))
    reports = []
    exporter = Exporter(lambda *words: reports.append(words))
    exporter.reports = reports
    exporter.settings = ExportSettings(320, 240, seconds=0.5, fps=10)
    yield exporter
    exporter.close()
    assert list(temporary.iterdir()) == []


@pytest.fixture
def out(tmp_path):
    folder = tmp_path / "out"
    folder.mkdir()
    return folder


def test_cancelled_movie_reports_progress_and_leaves_older_file(exporter, document, out):
    path = out / "a.gif"
    path.write_text("older")
    exporter.settings = replace(exporter.settings, seconds=600)
    exporter.save_movie(path, document, dict)
    assert exporter.step.task == "writing a.gif"
    assert exporter.step.seconds_remaining() is None
    until(lambda: exporter.progress > 0)
    assert exporter.step.seconds_remaining() > 0
    exporter.cancel()
    exporter.wait()
    assert (exporter.message, exporter.failed) == ("export cancelled", False)
    assert path.read_text() == "older"
    assert list(out.iterdir()) == [path]


def test_errors_of_exports_are_reported(exporter, document, out, monkeypatch):
    unknown = replace(document, channels=(Channel("gaussian:vertex=99999", CHANNEL.target),))
    exporter.save_picture(out / "a.png", unknown, dict)
    exporter.wait()
    assert exporter.failed
    assert exporter.message.startswith("gaussian:vertex=99999: ")
    assert "\n" not in exporter.message
    assert list(out.iterdir()) == []
    monkeypatch.setattr("subprocess.Popen", None)
    for save, name, named in (
        (exporter.save_picture, "none/a.png", ("folder",)),
        (exporter.save_movie, "a.avi", (".mp4", ".gif")),
    ):
        save(out / name, document, dict)
        exporter.wait()
        assert exporter.failed
        check_message(exporter.message, *named)
    exporter.settings = replace(exporter.settings, fps=60)
    exporter.save_movie(out / "a.gif", document, dict)
    exporter.wait()
    text, failed = exporter.reports[-1]
    assert failed
    check_message(text, "fps", 60, ".gif", 50)
    assert list(out.iterdir()) == []


def test_exports_factor_large_systems_in_a_subprocess(exporter, document, out, monkeypatch):
    is_in_subprocess = []
    monkeypatch.setattr(
        outputs, "write", lambda *_: is_in_subprocess.append(is_factored_in_subprocess(10**9))
    )
    exporter.save_result(out / "a.npz", document.result, lambda: None)
    exporter.wait()
    assert is_in_subprocess == [True]


def test_exports_report_steps_and_are_queued(exporter, document, out, monkeypatch):
    may_write, written = threading.Event(), []

    def write(path, found):
        with step("path lines") as tell:
            tell(0.25)
            assert may_write.wait(60)
            checkpoint()
        written.append(path.name)

    monkeypatch.setattr(outputs, "write", write)

    def save(*names):
        for name in names:
            exporter.save_result(out / name, document.result, lambda: None)

    exporter.subject = "first"
    save("a.html", "b.ply", "c.npz")
    exporter.subject = "second"
    until(lambda: exporter.step.done == 0.25)
    assert exporter.step.task == "writing a.html, 2 more after it: path lines"
    may_write.set()
    exporter.wait()
    assert written == ["a.html", "b.ply", "c.npz"]
    assert exporter.message_subject == "first"
    assert [text for text, _ in exporter.reports] == [f"saved {out / name}" for name in written]
    assert not exporter.running
    may_write.clear()
    save("d.html", "e.npz")
    exporter.cancel()
    may_write.set()
    exporter.wait()
    assert exporter.reports[3:] == [("export cancelled", False)]
    assert len(written) == 3


def test_stored_settings_are_checked():
    """Invalid, unknown and missing settings have their defaults."""
    settings = ExportSettings(640, 480, 150, "white", "left", turns=-0.5, movie_suffix=".gif")
    assert with_stored(ExportSettings(), asdict(settings)) == settings
    wrong = {"width": 1, "dpi": "many", "background": "red", "view": "inside", "other": 1}
    assert with_stored(ExportSettings(), wrong | {"seconds": 2.5}) == ExportSettings(seconds=2.5)


def test_settings_become_options_of_render(document):
    """Times of a movie are in units of tau, turns in turns, and movies are not transparent."""
    document = replace(document, parameters=abfm.Parameters(tau=3))
    settings = ExportSettings(background="transparent", view="best", start=0.5, end=1.5, turns=0.25)
    assert "--background=transparent" in settings.picture_options()
    options = settings.movie_options(document)
    expected = {"--from=1.5", "--to=4.5", "--turntable=90.0", "--view=best", "--background=theme"}
    assert expected <= set(options)
