"""`abfm batch`, also with --over: tables are solved, told and gone on with."""

import csv
import json
import random
import re
import shlex
import signal
from html.parser import HTMLParser
from unittest.mock import Mock

import pytest

import abfm as library
from abfm.assets import asset_path
from abfm.batch import Ledger, read_table
from abfm.batch.cluster import CONNECTING, NO_WORKERS, LostError
from abfm.batch.kinds import KINDS
from abfm.batch.run import REPORTED_STEPS
from abfm.errors import ResultError
from abfm.outcome import Outcome
from abfm.workers.progress import step
from abfm_viewer import pictures
from abfm_viewer.cli import main
from abfm_viewer.cli.batches import batch, running
from abfm_viewer.cli.batches.rows import ROWS_SHOWN_MAX
from abfm_viewer.cli.progress import row_progress
from abfm_viewer.errors import DrawingError
from tests.messages import check_message, check_names, line_with
from tests.processes import argv, family, kill, lingering, python
from tests.viewer.cli.batches import anew, results, start, victims, write_table, written

EIGHT = asset_path("eight.off")
BRIEF = ["--refine", "0", "--set=levels=1", "--set=cooling_stages=2"]
NEAR, FAR = "gaussian:vertex=5,width=0.4", "gaussian:vertex=200,width=0.2"
TABLE = f"""\
name,mesh,source,target,iterations,refine,levels,alpha
<far>,{EIGHT},"gaussian:vertex=0,width=0.4","{FAR}",0,0,1,0.5
same,{EIGHT},"{NEAR}","{NEAR}",5,0,1,
lost,nowhere.off,"{NEAR}","{NEAR}",5,0,1,
"""


class Page(HTMLParser):
    """What stands on a page, the names of its rows, what its pictures show, and its facts."""

    def __init__(self, path):
        super().__init__()
        self.text, self.facts, self.names, self.pictures, self.links = "", "", [], [], []
        self._open = []
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag, attributes):
        given = dict(attributes)
        self.links += [given[name] for name in ("src", "href") if name in given]
        if tag == "img":
            self.pictures.append(given["alt"])
        elif tag not in ("meta", "link"):
            self._open.append((tag, given.get("class")))

    def handle_endtag(self, tag):
        while self._open and self._open.pop()[0] != tag:
            pass

    def handle_data(self, data):
        if ("script", None) in self._open:
            self.facts += data
        elif ("style", None) not in self._open:
            self.text += data
        if ("div", "name") in self._open:
            self.names.append(data)


@pytest.fixture(scope="module")
def solved(tmp_path_factory):
    """A folder with a table and its results, and the exit status."""
    folder = tmp_path_factory.mktemp("batch")
    (folder / "table.csv").write_text(TABLE)
    words = ["batch", folder / "table.csv", "--out", folder / "out", "--jobs", "1", "--quiet"]
    return folder, main([*map(str, words)])


def table_of(folder):
    with (folder / "summary.csv").open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def test_a_table_is_solved_and_failed_rows_have_their_status_and_reason(solved):
    folder, status = solved
    assert status == 4
    far, same, lost = table_of(folder / "out")
    assert (far["verdict"], same["verdict"], lost["verdict"]) == (
        "not reached",
        "matched",
        "failed",
    )
    assert far["alpha"] == "0.5"
    assert (same["source"], same["alpha"]) == (NEAR, "")
    check_message(lost["reason"], "nowhere.off")
    assert (lost["digest"], lost["residual"]) == ("", "")
    for row in (far, same):
        match = library.load(folder / "out" / f"{row['digest']}.npz")
        assert match.problem.digest == row["digest"]
        assert float(row["residual"]) == match.residual
        assert float(row["verified_residual"]) == match.verified_residual
        assert float(row["folded"]) == match.folded
        assert float(row["seconds"]) > 0


def test_the_page_has_the_worst_first_a_picture_a_row_and_nothing_outside_it(solved):
    out = solved[0] / "out"
    page = Page(out / "summary.html")
    assert page.names == ["lost", "<far>", "same"]
    assert page.pictures == [f"{name}: source, carried, target" for name in page.names[1:]]
    assert all(link.startswith("data:image/png") for link in page.links)
    assert "table.csv" in page.text
    assert "Not reached" in page.text
    assert "no picture" in page.text
    assert "At a glance" not in page.text  # of sweeps
    facts = json.loads(page.facts)
    assert [row["name"] for row in facts["rows"]] == page.names
    ranks = [Outcome(row["verdict"]).rank for row in facts["rows"]]
    assert ranks == sorted(ranks, reverse=True)
    assert len(list((out / "pictures").iterdir())) == 2


def test_how_far_it_is_is_told_of_a_table_and_of_a_folder_and_nothing_is_solved(solved, abfm):
    folder, _ = solved
    before = (folder / "out" / "summary.html").read_bytes()
    by_folder = json.loads(
        abfm("batch", "--status", folder / "out", "--json", "--quiet", status=4).out
    )
    assert by_folder["counts"] == {"matched": 1, "not reached": 1, "failed": 1}
    assert (folder / "out" / "summary.html").read_bytes() == before
    other = folder / "other.csv"
    other.write_text(TABLE.replace(",5,0,1", ",6,0,1"))
    words = ["batch", other, "--out", folder / "out", "--status", "--json", "--quiet"]
    by_table = json.loads(abfm(*words, status=4).out)
    assert by_table["counts"] == {"not reached": 1, "missing": 2}
    assert by_table["rows"][1]["digest"] is None
    assert (
        "same: matched"
        not in abfm("batch", "--status", other, "--out", folder / "out", status=4).out
    )
    abfm("batch", "--status", folder / "out", status=4)  # as it was
    told = abfm("info", folder / "out", status=2).err
    check_message(told, f"abfm batch --status {folder}/out")


def test_help_names_every_kind_of_row():
    for kind in KINDS.values():
        line = rf"^  an? \w+ where it has (a )?{kind.needs[0]}( and \w+)?: "
        assert len(re.findall(line, batch.DESCRIPTION, re.MULTILINE)) == 1


def test_run_again_it_does_what_is_missing_and_says_so(solved, abfm):
    folder, _ = solved
    before = results(folder / "out")
    told = abfm("batch", folder / "table.csv", "--out", folder / "out", "--jobs", "1", status=4)
    first, failed = told.err.splitlines()[0], line_with(told.err, "lost: ")
    check_message(first, 2, 3)
    check_message(failed, 1, "failed")
    check_message(told.out.splitlines()[0].partition(", in ")[0], 3, "1 matched", "1 failed")
    assert "lost: failed: " in told.out
    assert "\r" not in told.err + told.out
    assert results(folder / "out") == before


def test_a_sweep_is_a_table_of_all_combinations(abfm, tmp_path, monkeypatch):
    monkeypatch.chdir(EIGHT.parent)
    words = [
        "batch",
        "eight.off",
        f"--source={NEAR}",
        "--channel",
        "coordinate:x",
        "coordinate:x",
        "0.5",
        *BRIEF,
    ]
    over = ["--over=alpha=0.1,0.2", f'--over=target="{NEAR}","gaussian:vertex=6,width=0.4"']
    out = ["--over=iterations=1", f"--out={tmp_path}/out", "--jobs=1", "--no-pictures"]
    status = main(argv(*words, *over, *out))
    rows = table_of(tmp_path / "out")
    assert status == (0 if all(Outcome(row["verdict"]).is_good for row in rows) else 3)
    targets = [f"gaussian:vertex={i},width=0.4" for i in (5, 6)]
    wanted = [(alpha, target, "1") for alpha in ("0.1", "0.2") for target in targets]
    assert [(row["alpha"], row["target"], row["iterations"]) for row in rows] == wanted
    assert {row["channel"] for row in rows} == {"coordinate:x coordinate:x 0.5"}
    assert rows[1]["name"] == "alpha 0.1, target gaussian:vertex=6,width=0.4, iterations 1"
    assert len(results(tmp_path / "out")) == 4
    match = library.load(tmp_path / "out" / f"{rows[1]['digest']}.npz")
    assert match.parameters == library.Parameters.of(
        alpha=0.1, refine=0, levels=1, cooling_stages=2, iterations=1
    )
    assert match.weights.tolist() == [1, 0.5]
    assert not (tmp_path / "out" / "pictures").exists()
    text = Page(tmp_path / "out" / "summary.html").text
    assert "no picture" in text
    grid = text.partition("At a glance")[2].partition("Rows")[0]
    places = [grid.index(each) for each in (*targets, "alpha 0.1", "alpha 0.2")]
    assert places == sorted(places)
    left = max(float(rows[0][name]) for name in ("residual", "verified_residual"))
    assert f"{100 * left:.2g}%" in grid
    for row in rows:
        match = library.load(tmp_path / "out" / f"{row['digest']}.npz")
        assert float(row["log2_area"]) == match.path[match.step].log2_area
    assert "Best" not in text  # targets are no ways to solve one problem
    again = abfm(
        "batch",
        "eight.off",
        f"--source={NEAR}",
        f"--target={NEAR}",
        *BRIEF,
        "--set=iterations=1",
        "--over=alpha=0.1,0.2",
        f"--out={tmp_path}/best",
        "--jobs=1",
        "--no-pictures",
    ).out
    assert re.search(r"^closest, and areas change least: alpha 0.[12]: ", again, re.MULTILINE)
    told = json.loads(abfm("batch", "--status", tmp_path / "best", "--json", "--quiet").out)
    assert told["best"]["closest"] == told["best"]["areas_change_least"]
    assert "Best" in Page(tmp_path / "best" / "summary.html").text


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["batch"], "--out is missing"),
        (["batch", "--out", "{t}/out"], "TABLE.csv is missing"),
        (
            ["batch", "{t}/none.csv", "--out", "{t}/out"],
            "cannot read table {t}/none.csv: No such file",
        ),
        (
            ["batch", "{t}/summary.csv", "--out", "{t}"],
            "summary.csv: it is read; choose another name",
        ),
        (
            ["batch", "~no-user/t.csv", "--out", "{t}/out"],
            "cannot read table ~no-user/t.csv: No such file",
        ),
        (
            ["batch", "{t}/bad.csv", "--out", "{t}/out"],
            "bad.csv: row 1, column alpha: 'much' is not a number",
        ),
        (["batch", "{t}/good.csv", "--out", "{t}/out", "--jobs", "0"], "a number of processes"),
        (
            ["batch", "{t}/good.csv", "--out={t}/out", "--jobs=2", "--scheduler=x"],
            "give one of --jobs",
        ),
        (
            ["batch", "{t}/good.csv", "--out={t}/out", "--scheduler="],
            "'' is no address, such as tcp://",
        ),
        (["batch", "{t}/good.csv", "--out", ""], "'' names no folder"),
        (["batch", "--status"], "--status DIR is missing"),
        (
            ["batch", "{t}/good.csv", "--out={t}/out", "--scheduler-file={t}/s"],
            "no scheduler's file {t}/s",
        ),
        (["batch", "{t}/good.csv", "--out", "{t}/good.csv/out"], "choose a folder"),
        (["batch", "{t}/good.csv", "--out", "{t}/none", "--status"], "nothing was solved yet"),
        (["batch", "--status", "{t}/none"], "holds no batch"),
        (["batch", "{t}/good.csv", "--out={t}/a", "--status", "{t}/b"], "name two folders"),
        (
            [
                "batch",
                "{t}/m.off",
                "--source=curvature:mean",
                "--target=curvature:mean",
                "--out={t}",
            ],
            "--over",
        ),
        (
            ["batch", "m.off", "--source=curvature:mean", "--out=out", "--over=target=a"],
            "unknown function",
        ),
        (
            ["batch", "m.off", "--source=curvature:mean", "--out=out", "--over=alpha=1"],
            "need each other",
        ),
        (["batch", "m.off", "--out", "out", "--over", "alpa=1"], "did you mean 'alpha'"),
        (["batch", "m.off", "--out", "out", "--over", "alpha"], "is not NAME=A,B"),
        (["batch", "m.off", "--out", "out", "--over", "=1"], "is not NAME=A,B"),
        (
            ["batch", "m.off", "--source=curvature:mean", "--out=out", "--over=alpha=x"],
            "--alpha: 'x' is no",
        ),
        (["batch", "m.off", "--out", "out", "--over", "alpha=1,,2"], "expected values with commas"),
        (["batch", "m.off", "--out", "out", "--over", "alpha=1,1"], "has a value twice"),
        (["batch", "m.off", "--out=out", "--over=alpha=1", "--over=alpha=2"], "is given twice"),
        (
            ["batch", "m.off", "--out=out", "--over=alpha=1", "--alpha=2"],
            "alpha is given, and swept over",
        ),
        (["batch", "m.off", "--over", "alpha=1"], "--out is missing"),
        (
            shlex.split(
                "batch {t}/m.off --source=coordinate:x --target=coordinate:y --out={t}/out "
                "--over=alpha=1,2"
            ),
            "m.off",
        ),
    ],
)
def test_what_does_not_fit_is_refused_in_a_line_and_nothing_is_solved(words, told, tmp_path, abfm):
    for name in ("good", "summary"):
        (tmp_path / f"{name}.csv").write_text(TABLE)
    (tmp_path / "bad.csv").write_text(TABLE.replace("0.5\n", "much\n"))
    assert (
        told.format(t=tmp_path) in abfm(*(word.format(t=tmp_path) for word in words), status=2).err
    )
    assert not list(tmp_path.rglob("*.npz"))


def test_what_is_done_is_told_where_who_solves_is_lost_and_where_nothing_can_be_written(
    solved, abfm, monkeypatch
):
    folder, _ = solved
    run = Mock(side_effect=LostError("the scheduler does not answer any more"))
    monkeypatch.setattr(running, "run", run)
    told = abfm("batch", folder / "table.csv", "--out", folder / "out", "--quiet", status=4)
    check_message(told.err)
    check_names(told.out.splitlines()[0], 3, "1 matched", "1 not reached", "1 failed")
    refuse = Mock(side_effect=ResultError("cannot write summary.csv"))
    monkeypatch.setattr(running, "write_summary", refuse)
    told = abfm("batch", "--status", folder / "out", status=4)
    check_message(told.err, "summary.csv")
    check_names(told.out.splitlines()[0], 3, "1 matched", "1 not reached", "1 failed")
    run.side_effect = lambda rows, folder, *_, **__: Ledger(folder).entries(rows)
    told = abfm("batch", folder / "table.csv", "--out", folder / "out", "--quiet", status=2)
    check_message(told.err, "summary.csv")


def test_a_cluster_that_is_waited_for_is_told_of(capsys):
    with row_progress(3, False, reported=REPORTED_STEPS) as report:
        with step(CONNECTING), step("another"):
            pass
        report("one: matched")
        with step(NO_WORKERS):
            pass
    assert capsys.readouterr().err.splitlines() == [
        f"0 of 3: {CONNECTING}",
        f"0 of 3: {CONNECTING}",
        "1 of 3: one: matched",
        f"1 of 3: {NO_WORKERS}",
    ]


def test_a_machine_that_cannot_draw_says_so_and_the_rest_is_there(solved, abfm, monkeypatch):
    folder, _ = solved
    for picture in (folder / "out" / "pictures").iterdir():
        picture.unlink()
    refuse = Mock(side_effect=DrawingError("cannot draw without OpenGL"))
    with monkeypatch.context() as patched:
        patched.setattr(pictures, "row_pictures", refuse)
        told = abfm("batch", "--status", folder / "out", "--quiet", status=4)
    check_message(told.err, "OpenGL")
    page = Page(folder / "out" / "summary.html")
    assert "cannot draw without OpenGL" in page.text
    assert page.pictures == []
    abfm("batch", "--status", folder / "out", "--quiet", status=4)
    assert len(Page(folder / "out" / "summary.html").pictures) == 2


def test_a_signal_ends_a_batch_and_keeps_what_is_done(tmp_path):
    write_table(tmp_path / "table.csv", 12, iterations=60)
    process = start(tmp_path / "table.csv", tmp_path / "out", "--jobs", "1")
    while not process.stderr.readline().startswith("1 of 12: pair 0: "):
        assert process.poll() is None
    there = family(process.pid)
    process.send_signal(signal.SIGTERM)
    errors = process.communicate(timeout=60)[1]
    assert process.returncode == 143
    assert "stopping" in errors
    assert "Traceback" not in errors
    rows = table_of(tmp_path / "out")
    done = [row for row in rows if row["verdict"] != "missing"]
    assert 1 <= len(done) < 12
    assert len(results(tmp_path / "out")) == len(done)
    assert lingering(there) == []


def write_ledger(folder, rows):
    """Write a table and a ledger in which every row has failed but each tenth, which is missing."""
    lines = [f'row {i},none.off,"{NEAR}","{NEAR}",{i}' for i in range(rows)]
    head = "name,mesh,source,target,iterations"
    (folder / "table.csv").write_text("\n".join([head, *lines]) + "\n")
    ledger, found = Ledger(folder / "out"), read_table(folder / "table.csv")
    ledger.make()
    ledger.write_rows(found, "table.csv")
    for number, row in enumerate(found):
        if number % 10:
            record = json.dumps({"reason": f"there is no file number {number}"})
            (ledger.own / f"{row.key}.json").write_text(record)


def test_page_of_many_rows_is_bounded(tmp_path, abfm):
    write_ledger(tmp_path, 3000)
    printed = json.loads(
        abfm("batch", "--status", tmp_path / "out", "--json", "--quiet", status=4).out
    )
    assert printed["counts"] == {"missing": 300, "failed": 2700}
    assert [row["name"] for row in printed["rows"]] == [f"row {i}" for i in range(3000)]
    assert len(table_of(tmp_path / "out")) == 3000
    page = Page(tmp_path / "out" / "summary.html")
    assert len(page.names) == ROWS_SHOWN_MAX == 1000
    facts = json.loads(page.facts)
    assert (facts["count"], len(facts["rows"])) == (3000, ROWS_SHOWN_MAX)
    assert {row["verdict"] for row in facts["rows"]} == {"failed"}
    assert "1,000 of 3,000 rows" in page.text
    assert page.links == ["summary.csv"]
    assert (tmp_path / "out" / "summary.html").stat().st_size < 1_500_000


def test_long_texts_are_cut_on_the_page_only(tmp_path, abfm):
    functions = f'"{NEAR}","{NEAR}"'
    text = f"name,mesh,source,target\n{'n' * 20_000},none.off,{functions}\n"
    (tmp_path / "table.csv").write_text(text)
    abfm("batch", tmp_path / "table.csv", f"--out={tmp_path}/out", "--jobs=1", "--quiet", status=4)
    assert (tmp_path / "out" / "summary.html").stat().st_size < 20_000
    assert table_of(tmp_path / "out")[0]["name"] == "n" * 20_000


def test_letters_that_cannot_be_written_hide_nothing(tmp_path, abfm):
    write_ledger(tmp_path, 2)
    rows = tmp_path / "out" / "ledger" / "rows.json"
    rows.write_text(rows.read_text().replace("row 0", "\\ud800"))
    told = abfm("batch", "--status", tmp_path / "out", status=4)
    assert told.out.startswith("2 rows: 1 not done, 1 failed")
    assert [row["name"] for row in table_of(tmp_path / "out")] == ["?", "row 1"]


_SIGNALLED = """
import importlib, os, signal, sys
from abfm_viewer.cli import main
from abfm_viewer.cli.batches import running
running.ROWS_AFTER_SIGNAL_MAX = 5
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
_CLI = "abfm_viewer.cli.batches"


@pytest.mark.parametrize(
    ("place", "name", "words"),
    [
        ("abfm.batch.table", "_row", ["{t}/table.csv", "--out={t}/new", "--jobs=1"]),
        ("abfm.batch.ledger:Ledger", "_read", ["--status", "{t}/out"]),
        ("abfm.batch.ledger:Ledger", "_read", ["{t}/table.csv", "--out={t}/out", "--jobs=1"]),
        ("abfm.batch.ledger:Ledger", "forget", ["{t}/table.csv", "--out={t}/new", "--jobs=1"]),
        ("abfm.batch.ledger:Ledger", "record", ["{t}/table.csv", "--out={t}/new", "--jobs=1"]),
        (f"{_CLI}.running", "summary_row", ["--status", "{t}/out"]),
        (f"{_CLI}.rows:SummaryRow", "to_dict", ["--status", "{t}/out"]),
        ("abfm_viewer.reports.pages", "cut", ["--status", "{t}/out"]),
    ],
)
def test_signal_ends_a_large_batch_before_it_is_complete(place, name, words, tmp_path):
    write_ledger(tmp_path, 20)
    words = [word.format(t=tmp_path) for word in words]
    done = python(_SIGNALLED, place, name, "batch", *words, "--no-pictures")
    assert done.returncode == 143
    assert "Traceback" not in done.stderr
    assert not list(tmp_path.rglob("summary.html"))
    assert not list(tmp_path.rglob(".abfm-*"))


def test_a_batch_whose_processes_are_killed_goes_on_and_leaves_none_behind(tmp_path, abfm):
    write_table(tmp_path / "table.csv", 6, iterations=20)
    alone = ["batch", tmp_path / "table.csv", "--out", tmp_path / "alone", "--jobs=1"]
    abfm(*alone, "--quiet", "--no-pictures", status=3)
    out = tmp_path / "out"
    process = start(tmp_path / "table.csv", out, "--jobs", "2")
    while not process.stderr.readline().startswith("1 of 6: "):
        assert process.poll() is None
    found = victims(process.pid)
    assert [len(found[each]) for each in ("client", "worker")] == [1, 2]
    there = family(process.pid)
    kill(random.choice(found["worker"]))
    kill(process.pid)
    process.communicate()
    assert lingering(there) == []
    done = written(out)
    told = abfm(
        "batch", tmp_path / "table.csv", "--out", out, "--jobs=1", "--no-pictures", status=3
    )
    check_names(told.err.splitlines()[0], 6)
    assert len(done) >= 1
    assert anew(done, written(out)) == []
    assert anew({"gone.npz": (0, 0)}, written(out)) == ["gone.npz"]
    assert results(out) == results(tmp_path / "alone")
    # a worker that was started anew between both kills may have left a file since
    abfm("batch", "--status", out, "--no-pictures", status=3)
    assert not list(out.rglob(".abfm-*"))
