"""Comparison of messages with a snapshot, `tests/snapshots/messages.txt`.

A test asserts which error, outcome or exit status it expects, and which names and numbers a message
must contain. The wording is compared with the snapshot. ``--update-snapshots`` rewrites the
snapshot for the tests that passed. Computed numbers and temporary folders are masked.
"""

import re
import tempfile
from collections import defaultdict
from contextlib import contextmanager
from pathlib import Path
from zlib import crc32

import hypothesis
import pytest

REPOSITORY = Path(__file__).parents[1]
SNAPSHOT = Path(__file__).parent / "snapshots" / "messages.txt"
ID_LENGTH_MAX = 60  # characters of a line in the snapshot
TEXT_LENGTH_MAX = 500

_HEADER = "Messages that tests compare; see tests/messages.py. [module], then a test and its text."
_PROPERTY = "message"
# floating-point numbers, shares and sizes of files, which differ between machines
_COMPUTED = re.compile(
    r"(?<![\w.])[-+]?\d+((\.\d+)+(e[-+]?\d+)?|e[-+]?\d+|(?= ?%| bytes))(?!\w|\.\d)"
)
# addresses, and the random name of a result that could not be written to its file
_ADDRESS = re.compile(r"\b0x[0-9a-f]{6,}\b|(?<=\babfm-)[0-9a-f]{8}(?=\.npz)")
_CHOICES = re.compile(r"\(choose from .*?\)")  # Python 3.12 omits the quotes
_TEMPORARY = tempfile.gettempdir()  # replaced by tests
_current = None  # the Messages of the running test


@contextmanager
def raises(error, *named, recorded=True):
    """Act like `pytest.raises`, and check the message (if not ``recorded``, only names in it)."""
    with pytest.raises(error) as caught:
        yield caught
    check = check_message if recorded else check_names
    check(str(caught.value), *named)


def check_message(text, *named):
    """Assert that a text contains the given names and numbers, and agrees with the snapshot.

    A name must be a complete word of the text: 7 is not in "17 values". In a test by Hypothesis,
    whose texts differ from run to run, only the names are checked.
    """
    check_names(text, *named)
    if not hypothesis.currently_in_test_context():
        _current.check(text)


def check_names(text, *named):
    """Assert that a text contains the given names and numbers as complete words."""
    assert isinstance(text, str), text
    missing = [name for name in named if not _word(str(name)).search(text)]
    assert not missing, f"{missing} not in {text!r}"


def line_with(text, name):
    """Return the first line of a text that contains a name, such as "note: "."""
    return next(line for line in text.splitlines() if name in line)


def _word(name):
    before = r"(?<![\w.])" if name[:1].isdigit() else r"(?<!\w)" if name[:1].isalpha() else ""
    after = r"(?!\w|[.,]\d)" if name[-1:].isdigit() else r"(?!\w)" if name[-1:].isalpha() else ""
    return re.compile(before + re.escape(name) + after)


class Messages:
    """The messages of one test, in the order of their checks."""

    def __init__(self, item, expected):
        self._item = item
        self._expected = expected
        self._update = item.config.getoption("--update-snapshots")
        self._temporary = _temporary_folders(item.config.option.basetemp or _TEMPORARY)
        self._texts = []

    def check(self, text):
        text = self._masked(text)
        if self._texts and text == self._texts[-1]:
            return  # as in a loop whose steps have the same message
        self._texts.append(text)
        if self._update:
            self._item.user_properties.append((_PROPERTY, text))
            return
        number = len(self._texts)
        assert number <= len(self._expected), (
            f"{text!r} is not in {SNAPSHOT.name}: run this test with --update-snapshots"
        )
        expected = self._expected[number - 1]
        assert text == expected, (
            f"{text!r} is worded differently in {SNAPSHOT.name}: {expected!r}. "
            "If the new text is right: pytest --update-snapshots"
        )

    def _masked(self, text):
        text = text.replace(str(REPOSITORY), "REPOSITORY")
        for folder in self._temporary:
            text = folder.sub("TMP/", text)
        text = _ADDRESS.sub("#", text.rstrip("\n"))
        text = _CHOICES.sub(lambda found: found[0].replace("'", ""), text)
        text = _COMPUTED.sub("#", text)[:TEXT_LENGTH_MAX]
        return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text)


def _temporary_folders(base):
    """Return patterns of the folders that tests write to: of shortened and of complete paths."""
    base, end = str(base), r"[^\s'\"/]*/"
    heads = "|".join(re.escape(base[:length]) for length in range(len(base), 9, -1))
    shortened = rf"(?:{re.escape(base)}/[^\s'\"]*?{'|' + heads if heads else ''})\.\.\.(?:{end})?"
    run = r"(?:/pytest-of-[^/]+/pytest-\d+)?(?:/popen-gw\d+)?"
    return re.compile(shortened), re.compile(rf"(?:/private)?{re.escape(base)}{run}/[\w.-]+/?")


class MessageSnapshot:
    """A plugin of pytest that reads the snapshot, and rewrites it after `--update-snapshots`."""

    def __init__(self, config):
        self._config = config
        self._lines = read_snapshot()
        self._passed = {}
        self._reported = set()

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_call(self, item):
        global _current
        module, test = key(item.nodeid)
        _current = Messages(item, self._lines[module].get(test, []))
        try:
            return (yield)
        finally:
            _current = None

    def pytest_runtest_logreport(self, report):
        # pytest-xdist sends reports with their messages to the process that writes the snapshot
        self._reported.add(key(report.nodeid))
        if report.when == "call" and report.passed:
            texts = [text for name, text in report.user_properties if name == _PROPERTY]
            self._passed[key(report.nodeid)] = texts

    def pytest_sessionfinish(self, exitstatus):
        is_worker = hasattr(self._config, "workeroutput")
        if is_worker or not self._config.getoption("--update-snapshots"):
            return
        lines = read_snapshot()
        for (module, test), texts in self._passed.items():
            lines[module][test] = texts
        if exitstatus == pytest.ExitCode.OK and not self._selects_tests():
            is_complete = self._config.args_source is pytest.Config.ArgsSource.TESTPATHS
            modules = {module for module, _ in self._reported}
            for module in lines:
                if is_complete or module in modules:
                    tests = lines[module].items()
                    reported = self._reported
                    lines[module] = {
                        test: each for test, each in tests if (module, test) in reported
                    }
        write_snapshot(lines)

    def _selects_tests(self):
        option = self._config.option
        words = (option.keyword, option.markexpr, option.deselect, getattr(option, "lf", False))
        return any(words) or any("::" in word for word in self._config.args)


def key(nodeid):
    """Return the key of a test in the snapshot: module and name, without spaces and paths."""
    module, _, test = nodeid.partition("::")
    for path in (str(REPOSITORY), str(REPOSITORY).encode("unicode_escape").decode()):
        test = test.replace(path, "REPOSITORY")
    test = "_".join(test.replace("'", "").split())
    if len(test) > ID_LENGTH_MAX:
        test = f"{test[:ID_LENGTH_MAX]}...{crc32(test.encode()):08x}"
    return module.removeprefix("tests/"), test


def read_snapshot():
    lines = defaultdict(lambda: defaultdict(list))
    module = ""
    if SNAPSHOT.is_file():
        for line in SNAPSHOT.read_text(encoding="utf-8").split("\n")[1:]:
            if line.startswith("["):
                module = line[1:-1]
            elif line:
                test, _, text = line.partition(" ")
                lines[module][test].append(text)
    return lines


def write_snapshot(lines):
    parts = [_HEADER]
    for module, tests in sorted(lines.items()):
        found = [f"{test} {text}" for test, texts in sorted(tests.items()) for text in texts]
        if found:
            parts += ["", f"[{module}]", *found]
    SNAPSHOT.write_text("\n".join(parts) + "\n", encoding="utf-8")
