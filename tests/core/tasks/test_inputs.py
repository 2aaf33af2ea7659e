"""One form of channels, masks and names of files in the inputs of all tasks."""

import pytest

from abfm.batch import Row
from abfm.errors import ParameterError
from abfm.population.task import PopulationTask
from tests.messages import raises

MATCH = {"mesh": "m.off", "source": "file:f.npy", "target": "curvature:mean"}
FRAMES = {"mesh": "m.off", "frames": "f.npy"}
POPULATION = {"table": "s.csv", "template": "t.off"}


def test_file_name_stands_for_its_values(tmp_path):
    given = {"channel": "'g, h.npy' file:h.npy 2"}
    written = {"channel": "'file:\"g, h.npy\"' file:h.npy 2"}
    bare = Row("one", MATCH | given | {"source": "f.npy"}, tmp_path)
    named = Row("one", MATCH | written, tmp_path)
    assert bare.values() == named.values()
    assert bare.key == named.key
    assert bare.written["source"] == "file:f.npy"


@pytest.mark.parametrize("text", ["gausian:vertex=1,width=0.1", "curvatur", "gaussian(1)"])
def test_wrong_spec_is_not_a_file_name(text):
    with raises(ParameterError, "source"):
        Row("one", MATCH | {"source": text})


def test_channels_of_a_population_have_targets_and_weights():
    row = Row("", [*POPULATION.items(), ("channel", "sulc s.csv 1"), ("channel", "curv auto 2")],
              "", PopulationTask)  # fmt: skip
    assert row.values()["channel"] == [("sulc", "file:s.csv", 1.0), ("curv", "", 2.0)]


@pytest.mark.parametrize(
    ("given", "channel", "named"),
    [
        (MATCH, "f.npy g.npy", ("SRC DST WEIGHT",)),
        (MATCH, "f.npy g.npy two", ("two",)),
        (MATCH, "f.npy 'g.npy 1", ("SRC DST WEIGHT",)),
        (FRAMES, "1", ("NUMBER WEIGHT",)),
        (FRAMES, "-1 2", ("-1",)),
        (FRAMES, "0 -2", ("-2", 0)),
        (POPULATION, "sulc 2", ("NAME DST WEIGHT",)),
        (POPULATION, "sulc auto x", ("x",)),
    ],
)
def test_wrong_channels_are_refused(given, channel, named):
    task = PopulationTask if given is POPULATION else None
    with raises(ParameterError, "column channel", *named):
        Row("one", given | {"channel": channel}, task=task)
