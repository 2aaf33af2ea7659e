"""The window's benchmark on a small mesh: its report is whole, and ratios are those of the times
it gives.
"""

from __future__ import annotations

import json
import statistics

import pytest

from abfm import Parameters
from laboratory import window as benchmark


@pytest.fixture(scope="module")
def report():
    return benchmark.run(
        lambda line: None,
        subdivisions=(3,),
        parameters=Parameters(iterations=10),
        long=20,
        repeats=1,
    )


def test_report_is_whole_and_survives_json(report):
    assert list(report) == ["launch", "throughput", "frames", "settings"]
    assert json.loads(json.dumps(report, allow_nan=False)) == report
    assert [each["vertices"] for each in report["throughput"]] == [642]


def test_ratios_are_of_medians(report):
    seconds = {
        name: statistics.median(times) for name, times in report["launch"]["seconds"].items()
    }
    assert report["launch"]["ratio"] == seconds["app"] / seconds["bare polyscope"] > 0
    [throughput] = report["throughput"]
    rates = {
        name: statistics.median(values)
        for name, values in throughput["iterations_per_second"].items()
    }
    assert throughput["ratio"] == rates["with window"] / rates["abfm.match"] > 0


def test_frames_were_drawn_during_a_solve(report):
    for frames in (report["frames"], report["throughput"][0]["frames"]):
        assert frames["count"] > 0
        assert 0 < frames["median"] <= frames["p95"]


def test_the_report_reads_as_lines(report):
    lines = benchmark.format_report(report).splitlines()
    assert [line.split()[0] for line in lines] == ["launch", "solver", "frames", "measured"]
    assert "642 vertices" in lines[1]


def test_the_table_has_a_row_for_each_of_them(report):
    rows = benchmark.window_table(report).splitlines()
    assert len(rows) == 2 + 3
    assert all(row.count("|") == 4 for row in rows)
