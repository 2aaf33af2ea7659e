from types import SimpleNamespace

import pytest

from tests import messages
from tests.messages import Messages, MessageSnapshot, check_names, key, read_snapshot


@pytest.fixture
def snapshot(tmp_path, monkeypatch):
    path = tmp_path / "messages.txt"
    monkeypatch.setattr(messages, "SNAPSHOT", path)
    return path


def config(update, arguments=(), basetemp=None):
    """Return the configuration of a run of all tests, or of the given files and tests."""
    source = pytest.Config.ArgsSource
    return SimpleNamespace(
        getoption=lambda _: update,
        option=SimpleNamespace(keyword="", markexpr="", deselect=None, basetemp=basetemp),
        args=arguments or ["tests"],
        args_source=source.ARGS if arguments else source.TESTPATHS,
    )


def checked(texts, expected=(), update=False, basetemp=None):
    """Check texts in a test; return the texts that it reports for the snapshot."""
    item = SimpleNamespace(config=config(update, basetemp=basetemp), user_properties=[])
    record = Messages(item, list(expected))
    for text in texts:
        record.check(text)
    return [text for _, text in item.user_properties]


def run(recorded, update=True, arguments=(), failed=()):
    plugin = MessageSnapshot(config(update, arguments))
    for nodeid, texts in recorded.items():
        properties = [(messages._PROPERTY, text) for text in texts]
        report = SimpleNamespace(
            nodeid=nodeid, when="call", passed=nodeid not in failed, user_properties=properties
        )
        plugin.pytest_runtest_logreport(report)
    plugin.pytest_sessionfinish(pytest.ExitCode.TESTS_FAILED if failed else pytest.ExitCode.OK)
    return {
        f"{module}::{test}": texts
        for module, tests in read_snapshot().items()
        for test, texts in tests.items()
    }


def test_names_are_complete_words():
    check_names("alpha is -1.5; expected 0 to 17, as in m.npz", "alpha", "-1.5", 0, 17, "m.npz")
    for name in (7, 1, "alph", "np", 1.5, "beta"):
        with pytest.raises(AssertionError):
            check_names("alpha is -1.75; expected 0 to 17, as in m.npz", name)


def test_machine_dependent_parts_are_masked():
    texts = ["/b c/popen-gw1/test_x0/a.npy: 12.5% of 7 faces, 1e-05", "'/b c/te...t_x0/a b.npy'"]
    found = checked(texts, update=True, basetemp="/b c")
    assert found == ["TMP/a.npy: #% of 7 faces, #", "'TMP/a b.npy'"]


def test_messages_are_compared_in_order():
    checked(["a is 1", "a is 1", "b"], ["a is 1", "b"])
    for texts in (["a is 2"], ["b"], ["a is 1", "b", "c"]):
        with pytest.raises(AssertionError, match="--update-snapshots"):
            checked(texts, ["a is 1", "b"])


def test_update_keeps_lines_of_other_tests(snapshot):
    first = {"tests/a.py::x": ["one", "two"], "tests/a.py::y": ["three\\n"], "tests/b.py::z": ["4"]}
    assert run(first) == {"a.py::x": ["one", "two"], "a.py::y": ["three\\n"], "b.py::z": ["4"]}
    text = snapshot.read_text()
    assert run({"tests/b.py::z": ["no"]}, update=False) == run({}, arguments=["tests/b.py::z"])
    assert run({"tests/b.py::z": ["no"]}, failed=["tests/b.py::z"])["b.py::z"] == ["4"]
    assert snapshot.read_text() == text
    assert run({"tests/a.py::x": ["1"]}, arguments=["tests/a.py::x"])["a.py::y"] == ["three\\n"]


def test_update_drops_lines_of_removed_tests(snapshot):
    run({"tests/a.py::x": ["one"], "tests/a.py::y": ["two"], "tests/b.py::z": ["three"]})
    found = run({"tests/a.py::y": ["2"]}, arguments=["tests/a.py"])
    assert found == {"a.py::y": ["2"], "b.py::z": ["three"]}
    assert run({"tests/a.py::y": ["2"]}) == {"a.py::y": ["2"]}


def test_keys_are_short_and_have_no_spaces():
    assert key("tests/core/test_a.py::test_b[a b\nc]") == ("core/test_a.py", "test_b[a_b_c]")
    long = [key(f"tests/test_a.py::test_b[{'x' * 500}{end}]")[1] for end in "ab"]
    assert len(set(long)) == 2
    assert max(map(len, long)) < 80


def test_keys_do_not_depend_on_the_folder(monkeypatch):
    found = set()
    for folder in ("/a", "/b c", "/é"):
        monkeypatch.setattr(messages, "REPOSITORY", folder)
        arguments = f"info '{folder}/x'" if " " in folder else f"info {folder}/x"
        identifier = arguments.encode("unicode_escape").decode()
        found.add(key(f"tests/test_a.py::test_b[{identifier}]"))
    assert found == {("test_a.py", "test_b[info_REPOSITORY/x]")}
