import csv
import json
import random
import re
import signal
import sys
from unittest.mock import Mock

import pytest

import abfm as library
from abfm.assets import asset_path
from abfm.batch import Ledger, read_table
from abfm.batch.cluster import CONNECTING, NO_WORKERS, ConnectionLostError
from abfm.batch.kinds import KINDS
from abfm.batch.run import REPORTED_STEPS
from abfm.errors import ResultError
from abfm.outcome import Outcome
from abfm.wording import share
from abfm.workers.progress import step
from abfm_viewer import pictures
from abfm_viewer.cli import batch, main
from abfm_viewer.cli.progress import row_progress
from abfm_viewer.errors import DrawingError
from abfm_viewer.reports.batches import ROWS_SHOWN_MAX
from tests.messages import check_message, check_names, line_with
from tests.processes import family, kill, lingering, python, words_of
from tests.viewer.cli.batches import changed_results, results, start, victims, write_table, written
from tests.viewer.cli.page import page_at

EIGHT = asset_path("eight.off")
FEW_STEPS = "--refine 0 --set=levels=1 --set=cooling_stages=2"
CLOSE_SPEC, DISTANT_SPEC = "gaussian:vertex=5,width=0.4", "gaussian:vertex=200,width=0.2"
TABLE = f"""\
name,mesh,source,target,iterations,refine,levels,alpha
<far>,{EIGHT},"gaussian:vertex=0,width=0.4","{DISTANT_SPEC}",0,0,1,0.5
same,{EIGHT},"{CLOSE_SPEC}","{CLOSE_SPEC}",5,0,1,
lost,nowhere.off,"{CLOSE_SPEC}","{CLOSE_SPEC}",5,0,1,
"""
COUNTS = (3, "1 matched", "1 not reached", "1 failed")


@pytest.fixture(scope="module")
def solved(tmp_path_factory):
    """Return a folder with a table and its results; one row failed."""
    folder = tmp_path_factory.mktemp("batch")
    (folder / "table.csv").write_text(TABLE)
    line = "batch {f}/table.csv --out {f}/out --jobs 1 --quiet"
    assert main(words_of(line, f=folder)) == 4
    return folder


def table_of(folder):
    with (folder / "summary.csv").open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def test_summary_has_results_and_reasons(solved):
    far, same, lost = rows = table_of(solved / "out")
    assert [row["verdict"] for row in rows] == ["not reached", "matched", "failed"]
    assert far["alpha"] == "0.5"
    assert (same["source"], same["alpha"]) == (CLOSE_SPEC, "")
    check_message(lost["reason"], "nowhere.off")
    assert (lost["digest"], lost["residual"]) == ("", "")
    for row in (far, same):
        match = library.load(solved / "out" / f"{row['digest']}.npz")
        assert match.problem.digest == row["digest"]
        for name in ("residual", "verified_residual", "folded"):
            assert float(row[name]) == getattr(match, name)
        assert float(row["seconds"]) > 0


def test_page_has_the_worst_first_and_pictures(solved):
    page = page_at(solved / "out" / "summary.html")
    assert page.names == ["lost", "<far>", "same"]
    assert [*page.pictures] == [f"{name}: source, advected, target" for name in page.names[1:]]
    assert all(link.startswith("data:image/png") for link in page.links)
    for text in ("table.csv", "Not reached", "no picture"):
        assert text in page.text
    assert "Overview" not in page.text  # only combinations of options have this section
    rows = json.loads(page.facts)["rows"]
    assert [row["name"] for row in rows] == page.names
    ranks = [Outcome(row["verdict"]).rank for row in rows]
    assert ranks == sorted(ranks, reverse=True)
    assert len(list((solved / "out" / "pictures").iterdir())) == 2


def test_status_counts_rows_of_a_table_or_folder(solved, abfm):
    page = (solved / "out" / "summary.html").read_bytes()
    status = "batch --status {f}/out"
    by_folder = json.loads(abfm(f"{status} --json --quiet", f=solved, status=4).out)
    assert by_folder["counts"] == {"matched": 1, "not reached": 1, "failed": 1}
    assert (solved / "out" / "summary.html").read_bytes() == page
    (solved / "other.csv").write_text(TABLE.replace(",5,0,1", ",6,0,1"))
    line = "batch {f}/other.csv --out {f}/out --status --json --quiet"
    by_table = json.loads(abfm(line, f=solved, status=4).out)
    assert by_table["counts"] == {"not reached": 1, "missing": 2}
    assert by_table["rows"][1]["digest"] is None
    line = "batch --status {f}/other.csv --out {f}/out"
    of_table = abfm(line, f=solved, status=4).out.splitlines()
    assert not any("same: matched" in each for each in of_table)
    assert {"  not reached: <far>", "  not finished: same; lost"} <= set(of_table)
    abfm(status, f=solved, status=4)  # the exit status of the run itself
    output = abfm("info {f}/out", f=solved, status=2).err
    check_message(output, f"abfm batch --status {solved}/out")


def test_help_names_every_kind_of_row():
    first_columns = re.findall(r"^    an? \w+ +(\w+)", batch.DETAILS, re.MULTILINE)
    assert set(first_columns) == {kind.needs[0] for kind in KINDS.values()}


def test_only_missing_rows_are_solved_again(solved, abfm):
    before = results(solved / "out")
    output = abfm("batch {f}/table.csv --out {f}/out --jobs 1", f=solved, status=4)
    check_message(output.err.splitlines()[0], 2, 3)
    check_message(line_with(output.err, "lost: "), 1, "failed")
    check_message(output.out.splitlines()[0].partition(", in ")[0], 3, "1 matched", "1 failed")
    assert "lost: failed: " in output.out
    assert "\r" not in output.err + output.out
    assert results(solved / "out") == before


def test_all_combinations_of_options_are_solved(abfm, tmp_path, monkeypatch):
    monkeypatch.chdir(EIGHT.parent)
    pair = ["--channel", "coordinate:x", "coordinate:x", "0.5"]
    over = f'--over=alpha=0.1,0.2 --over=target="{CLOSE_SPEC}","gaussian:vertex=6,width=0.4"'
    out = "--over=iterations=1 --out={t}/out --jobs=1 --no-pictures"
    line = f"batch eight.off --source={CLOSE_SPEC} {FEW_STEPS} {over} {out}"
    status = main([*words_of(line, t=tmp_path), *pair])
    rows = table_of(tmp_path / "out")
    assert status == (0 if all(Outcome(row["verdict"]).is_good for row in rows) else 3)
    targets = [CLOSE_SPEC, CLOSE_SPEC.replace("5", "6")]
    wanted = [(alpha, target, "1") for alpha in ("0.1", "0.2") for target in targets]
    assert [(row["alpha"], row["target"], row["iterations"]) for row in rows] == wanted
    assert {row["channel"] for row in rows} == {"coordinate:x coordinate:x 0.5"}
    assert rows[1]["name"] == "alpha 0.1, target gaussian:vertex=6,width=0.4, iterations 1"
    match = library.load(tmp_path / "out" / f"{rows[1]['digest']}.npz")
    settings = {"alpha": 0.1, "refine": 0, "levels": 1, "cooling_stages": 2, "iterations": 1}
    assert match.parameters == library.Parameters.of(**settings)
    assert match.weights.tolist() == [1, 0.5]
    assert float(rows[1]["log2_area"]) == match.path[match.step].log2_area
    text = page_at(tmp_path / "out" / "summary.html").text
    grid = text.partition("Overview")[2].partition("Rows")[0]
    places = [grid.index(each) for each in (*targets, "alpha 0.1", "alpha 0.2")]
    assert places == sorted(places)
    residual = max(float(rows[0][name]) for name in ("residual", "verified_residual"))
    assert share(residual) in grid
    assert "Best" not in text
    specs = f"--source={CLOSE_SPEC} --target={CLOSE_SPEC}"
    line = f"batch eight.off {specs} {FEW_STEPS} --set=iterations=1"
    output = abfm(f"{line} --over=alpha=0.1,0.2 --out={{t}}/best --jobs=1 --no-pictures").out
    assert "\nclosest match and least change of areas: alpha 0." in output
    best = json.loads(abfm("batch --status {t}/best --json --quiet").out)["best"]
    assert best["closest"] == best["areas_change_least"]


CURVES = "--source=curvature:mean --target=curvature:mean"


@pytest.mark.parametrize(
    ("line", "named"),
    [
        ("", ["--out"]),
        ("--out {t}/out", ["TABLE.csv"]),
        ("{t}/none.csv --out {t}/out", ["none.csv"]),
        ("{t}/summary.csv --out {t}", ["summary.csv"]),
        ("{t}/bad.csv --out {t}/out", ["bad.csv", 1, "alpha", "much"]),
        ("{t}/good.csv --out {t}/out --jobs 0", [1, 4096]),
        ("{t}/good.csv --out={t}/out --jobs=2 --scheduler=x", ["--jobs"]),
        ("{t}/good.csv --out={t}/out --scheduler=", ["tcp://"]),
        ("{t}/good.csv --out=", ["folder"]),
        ("--status", ["--status"]),
        ("{t}/good.csv --out={t}/out --scheduler-file={t}/s", ["/s"]),
        ("{t}/good.csv --out {t}/none --status", ["none"]),
        ("--status {t}/none", ["none"]),
        ("{t}/good.csv --out={t}/a --status {t}/b", ["--status", "--out"]),
        (f"{{t}}/m.off {CURVES} --out={{t}}", ["--over"]),
        ("m.off --source=curvature:mean --out=out --over=alpha=1", ["source", "target"]),
        ("m.off --out out --over alpa=1", ["alpha"]),
        ("m.off --out out --over alpha", ["NAME=A,B"]),
        (f"m.off {CURVES} --out=out --over=alpha=x", ["--alpha", "x"]),
        ("m.off --out out --over alpha=1,,2", ["alpha=1,,2"]),
        ("m.off --out out --over alpha=1,1", ["alpha=1,1"]),
        ("m.off --out=out --over=alpha=1 --over=alpha=2", ["alpha"]),
        ("m.off --out=out --over=alpha=1 --alpha=2", ["alpha"]),
        (f"{{t}}/m.off {CURVES} --out={{t}}/out --over=alpha=1,2", ["m.off"]),
    ],
)
def test_bad_input_is_refused(line, named, tmp_path, abfm):
    for name in ("good", "summary"):
        (tmp_path / f"{name}.csv").write_text(TABLE)
    (tmp_path / "bad.csv").write_text(TABLE.replace("0.5\n", "much\n"))
    check_message(abfm(f"batch {line}", status=2).err, *named)
    assert not list(tmp_path.rglob("*.npz"))


def test_finished_rows_are_reported_after_failures(solved, abfm, monkeypatch):
    run = Mock(side_effect=ConnectionLostError("the scheduler does not answer any more"))
    monkeypatch.setattr(batch, "run_rows", run)
    line = "batch {f}/table.csv --out {f}/out --quiet"
    output = abfm(line, f=solved, status=4)
    check_message(output.err)
    check_names(output.out.splitlines()[0], *COUNTS)
    refuse = Mock(side_effect=ResultError("cannot write summary.csv"))
    monkeypatch.setattr(batch, "write_summary", refuse)
    output = abfm("batch --status {f}/out", f=solved, status=4)
    check_message(output.err, "summary.csv")
    check_names(output.out.splitlines()[0], *COUNTS)
    run.side_effect = lambda rows, folder, *_, **__: Ledger(folder).entries(rows)
    check_message(abfm(line, f=solved, status=2).err, "summary.csv")


def test_long_lines_do_not_hide_the_bar(capsys, monkeypatch):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.setenv("FORCE_COLOR", "1")
    with row_progress(2, False) as report:
        report(f"one: impossible: {'a reason ' * 20}")
    lines = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", capsys.readouterr().err).split("\r")
    assert any(re.search("━+ 1/2 one: impossible: .*… 0:00:00", line) for line in lines)
    assert max(len(line.rstrip("\n")) for line in lines) <= 80


def test_waiting_for_a_cluster_is_reported(capsys):
    with row_progress(3, False, reported=REPORTED_STEPS) as report:
        with step(CONNECTING), step("another"):
            pass
        report("one: matched")
        with step(NO_WORKERS):
            pass
    expected = [CONNECTING, CONNECTING, "1 of 3: one: matched", NO_WORKERS]
    assert capsys.readouterr().err.splitlines() == expected


def test_pictures_are_added_when_the_machine_can_draw(solved, abfm, monkeypatch):
    for picture in (solved / "out" / "pictures").iterdir():
        picture.unlink()
    with monkeypatch.context() as patched:
        refuse = Mock(side_effect=DrawingError("cannot draw without OpenGL"))
        patched.setattr(pictures, "row_pictures", refuse)
        output = abfm("batch --status {f}/out --quiet", f=solved, status=4)
    check_message(output.err, "OpenGL")
    page = page_at(solved / "out" / "summary.html")
    assert "cannot draw without OpenGL" in page.text
    assert page.pictures == {}
    abfm("batch --status {f}/out --quiet", f=solved, status=4)
    assert len(page_at(solved / "out" / "summary.html").pictures) == 2


def test_signal_keeps_finished_rows(tmp_path):
    write_table(tmp_path / "table.csv", 12, iterations=60)
    process = start(tmp_path / "table.csv", tmp_path / "out", "--jobs", "1")
    while not process.stderr.readline().startswith("1 of 12: pair 0: "):
        assert process.poll() is None
    processes = family(process.pid)
    process.send_signal(signal.SIGTERM)
    errors = process.communicate(timeout=60)[1]
    assert process.returncode == 143
    assert "stopping" in errors
    assert "Traceback" not in errors
    done = [row for row in table_of(tmp_path / "out") if row["verdict"] != "missing"]
    assert 1 <= len(done) < 12
    assert len(results(tmp_path / "out")) == len(done)
    assert lingering(processes) == []


def write_ledger(folder, rows):
    """Write a table and a ledger in which all rows failed, except every tenth, which is missing."""
    lines = [f'row {i},none.off,"{CLOSE_SPEC}","{CLOSE_SPEC}",{i}' for i in range(rows)]
    head = "name,mesh,source,target,iterations"
    (folder / "table.csv").write_text("\n".join([head, *lines]) + "\n")
    ledger, found = Ledger(folder / "out"), read_table(folder / "table.csv")
    ledger.make()
    ledger.write_rows(found, "table.csv")
    for number, row in enumerate(found):
        if number % 10:
            record = json.dumps({"reason": f"there is no file number {number}"})
            (ledger.records_folder / f"{row.key}.json").write_text(record)


def test_page_of_many_rows_is_bounded(tmp_path, abfm):
    write_ledger(tmp_path, 1200)
    printed = json.loads(abfm("batch --status {t}/out --json --quiet", status=4).out)
    assert printed["counts"] == {"missing": 120, "failed": 1080}
    assert [row["name"] for row in printed["rows"]] == [f"row {i}" for i in range(1200)]
    assert len(table_of(tmp_path / "out")) == 1200
    page = page_at(tmp_path / "out" / "summary.html")
    assert len(page.names) == ROWS_SHOWN_MAX == 1000
    facts = json.loads(page.facts)
    assert (facts["count"], len(facts["rows"])) == (1200, ROWS_SHOWN_MAX)
    assert {row["verdict"] for row in facts["rows"]} == {"failed"}
    assert "1,000 of 1,200 rows" in page.text
    assert page.links == ["summary.csv"]
    assert (tmp_path / "out" / "summary.html").stat().st_size < 1_500_000


def test_strange_names_are_cut_or_replaced(tmp_path, abfm):
    write_ledger(tmp_path, 2)
    rows = tmp_path / "out" / "ledger" / "rows.json"
    text = rows.read_text()
    rows.write_text(text.replace("row 0", "n" * 20_000))
    abfm("batch --status {t}/out", status=4)
    assert (tmp_path / "out" / "summary.html").stat().st_size < 20_000
    assert table_of(tmp_path / "out")[0]["name"] == "n" * 20_000
    rows.write_text(text.replace("row 0", "\\ud800"))
    output = abfm("batch --status {t}/out", status=4)
    assert output.out.startswith("2 rows: 1 not finished, 1 failed")
    assert [row["name"] for row in table_of(tmp_path / "out")] == ["?", "row 1"]


_SCRIPT_WITH_SIGNAL = """
import importlib, os, signal, sys
from abfm_viewer.cli import batch, main
batch.ROWS_AFTER_SIGNAL_MAX = 5
place, name, *words = sys.argv[1:]
module, _, owner = place.partition(":")
module = importlib.import_module(module)
owner = getattr(module, owner) if owner else module
function, calls = getattr(owner, name), 0
def signalled(*given, **named):
    global calls
    calls += 1
    if calls == 10:
        os.kill(os.getpid(), signal.SIGTERM)
    return function(*given, **named)
setattr(owner, name, signalled)
sys.argv[1:] = words
sys.exit(main())
"""


@pytest.mark.parametrize(
    ("place", "name", "line"),
    [
        ("abfm.batch.table", "_row", "{t}/table.csv --out={t}/new --jobs=1"),
        ("abfm.batch.ledger:Ledger", "record", "{t}/table.csv --out={t}/new --jobs=1"),
        ("abfm_viewer.reports.pages", "abbreviated", "--status {t}/out"),
    ],
)
def test_signal_in_a_large_batch_writes_no_summary(place, name, line, tmp_path):
    write_ledger(tmp_path, 20)
    words = words_of(f"batch {line} --no-pictures", t=tmp_path)
    done = python(_SCRIPT_WITH_SIGNAL, place, name, *words)
    assert done.returncode == 143
    assert "Traceback" not in done.stderr
    assert not list(tmp_path.rglob("summary.html"))
    assert not list(tmp_path.rglob(".abfm-*"))


def test_killed_batch_resumes_and_leaves_no_process(tmp_path, abfm):
    write_table(tmp_path / "table.csv", 6, iterations=20)
    out, line = tmp_path / "out", "batch {t}/table.csv --jobs=1 --no-pictures --out"
    abfm(f"{line} {{t}}/alone --quiet", status=3)
    process = start(tmp_path / "table.csv", out, "--jobs", "2")
    while not process.stderr.readline().startswith("1 of 6: "):
        assert process.poll() is None
    found = victims(process.pid)
    assert [len(found[each]) for each in ("client", "worker")] == [1, 2]
    processes = family(process.pid)
    kill(random.choice(found["worker"]))
    kill(process.pid)
    process.communicate()
    assert lingering(processes) == []
    done = written(out)
    check_names(abfm(f"{line} {{t}}/out", status=3).err.splitlines()[0], 6)
    assert len(done) >= 1
    assert changed_results(done, written(out)) == []
    assert changed_results({"gone.npz": (0, 0)}, written(out)) == ["gone.npz"]
    assert results(out) == results(tmp_path / "alone")
    # a worker that started between the two kills may have left a file
    abfm("batch --status {t}/out --no-pictures", status=3)
    assert not list(out.rglob(".abfm-*"))
