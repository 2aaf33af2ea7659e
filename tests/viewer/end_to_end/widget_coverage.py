"""A plugin of pytest that fails the run if a widget was shown but never used.

The plugin acts only if all tests of this folder ran, in any order and number of processes.
"""

from contextlib import contextmanager
from pathlib import Path

import pytest

FOLDER = Path(__file__).parent
# sections whose labels are names of files
_OPENING = (
    *("Open a mesh", "Open a second surface", "Open a project or a result", "Open values"),
    *("Open a vertex map", "Open the sphere of", "Open a map from", "Open landmarks"),
    *("Open labels", "Open frames", "Open a batch or population"),
)
DYNAMIC = ("File/Recent", "Recover unsaved work?/copy", *_OPENING)
_SAVING = ("Save a ", "Save the ", "Save landmarks", "Save transferred", "Export the ")
_OUTPUT = "widgets"


class WidgetCoverage:
    """Names of enabled widgets that were shown, and of those that were used."""

    def __init__(self, config):
        self._config = config
        self.seen, self.used, self._files = set(), set(), set()

    @contextmanager
    def recording(self):
        """Record the shown widgets, and the widgets that tests use."""
        # not in processes that only distribute tests
        from abfm_viewer.automation.widget_search import WidgetSearch
        from abfm_viewer.widgets.widget_record import WidgetRecord

        find, end_frame = WidgetSearch.find, WidgetRecord.end_frame

        def recorded_find(search, *args, **options):
            widget = find(search, *args, **options)
            self.used.add(_name(widget))
            return widget

        def recorded_end_frame(record):
            end_frame(record)
            # Plots and pictures do not count.
            self.seen |= {_name(w) for w in record.latest if w.enabled and w.kind != "plot"}

        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(WidgetSearch, "find", recorded_find)
            patch.setattr(WidgetRecord, "end_frame", recorded_end_frame)
            yield

    def unused(self):
        """Return the names of unused widgets, without names of files."""
        return sorted(name for name in self.seen - self.used if not name[0].startswith(DYNAMIC))

    # Hooks of pytest

    def pytest_runtest_logreport(self, report):
        self._files.add(Path(report.nodeid.partition("::")[0]).name)

    @pytest.hookimpl(optionalhook=True)
    def pytest_testnodedown(self, node):
        seen, used = getattr(node, "workeroutput", {}).get(_OUTPUT, ((), ()))
        self.seen |= set(seen)
        self.used |= set(used)

    def pytest_sessionfinish(self, session):
        if hasattr(self._config, "workeroutput"):  # a worker of pytest-xdist
            self._config.workeroutput[_OUTPUT] = (sorted(self.seen), sorted(self.used))
        elif self._all_ran() and not session.testsfailed and (self.unused() or not self.used):
            session.exitstatus = pytest.ExitCode.TESTS_FAILED

    def pytest_terminal_summary(self, terminalreporter, exitstatus):
        if self._all_ran():
            terminalreporter.write_sep("=", f"{len(self.used)} widgets used")
            for section, label in self.unused():
                terminalreporter.write_line(
                    f"no end-to-end test uses {label!r} in {section!r}", red=True
                )

    def _all_ran(self):
        option = self._config.option
        selected = (
            option.keyword or option.markexpr or option.deselect or getattr(option, "lf", False)
        )
        chosen = selected or any("::" in word for word in self._config.args)
        return not chosen and self._files >= {path.name for path in FOLDER.glob("test_*.py")}


def _name(widget):
    """Return the section and the name of a widget.

    Similar widgets share one name: those of all channels, of source and target, of all steps of a
    path, and of all dialogs that save. All buttons "?" share one name as well.
    """
    section = "message" if widget.section.startswith("message ") else widget.section
    section = section.replace("Functions/target", "Functions/source")
    section = "Save" if widget.section.startswith(_SAVING) else section
    label = "channel" if section == "Functions" and widget.kind == "choice" else widget.label
    label = "step" if widget.kind == "marker" or section == "Match/step" else label
    section = "" if label == "?" else section
    label = "action" if (section, widget.kind) == ("Search actions", "choice") else label
    # the button and the menu have the same label, which depends on the result
    label = "match" if section == "Edit" and label.startswith(("Match", "Continue")) else label
    label = "row" if (section, widget.kind) == ("table/rows", "choice") else label
    if section == "Save" and widget.kind == "choice":
        label = "file"
    return section, label
