"""The parser of command lines, and options that several commands share."""

import argparse
import math
import re
import shlex
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NoReturn

import abfm
from abfm.batch.cluster import Cluster
from abfm.display import BEST_VIEW, UP_AXES, VIEWS, ViewSpec
from abfm.errors import ParameterError, brief, did_you_mean, one_line
from abfm.mesh.options import MERGE, MeshOptions
from abfm.parameters import FIELDS, MAIN_FIELDS, option
from abfm.tasks.inputs import MESH_INPUTS, Input, by_name
from abfm.tasks.inputs import mesh_options as options_in
from abfm_viewer.cli.exit_status import UsageError, print_note

OUTPUT = "output"  # heading of the options of output files
_DISTANCE = re.compile(r"auto|[-+.\d][-+.\de]*", re.IGNORECASE)


class Parser(argparse.ArgumentParser):
    """Parser whose errors are one line, and whose ``--help`` shows the most used options."""

    def __init__(
        self,
        prog: str,
        description: str,
        details: str = "",
        main: Iterable[str] = (),
        **settings: Any,
    ) -> None:
        form = argparse.RawDescriptionHelpFormatter
        settings |= {"formatter_class": form, "allow_abbrev": False, "add_help": False}
        super().__init__(prog, description=description, **settings)
        self.details = details  # long explanations, which only --help-all prints
        self.main_options = {option(name) for name in main}  # in --help; empty: all options
        self.settings: list[argparse.Action] = []
        """Actions that describe the values of ``--set``; they are not parsed."""
        self._positionals.title = "arguments"
        add = self.add_argument
        add("-h", "--help", action="help", help="show this help and exit")
        about = "show all options and explanations" if details or main else argparse.SUPPRESS
        add("--help-all", action=_HelpAll, nargs=0, help=about)

    def require(self, name: str) -> None:
        """Make an option required that another function declared as optional."""
        self._option_string_actions[f"--{name}"].required = True

    def is_main(self, action: argparse.Action) -> bool:
        names = {name.lstrip("-") for name in action.option_strings}
        if not names or not self.main_options or action.required:
            return True
        return bool(names & {"help", "help-all", *self.main_options})

    def format_help(self) -> str:
        """Return the text of ``--help``: the main options, and how to see the others."""
        return self._help(list(filter(self.is_main, self._actions)), is_complete=False)

    def format_help_all(self) -> str:
        return self._help(self._actions, is_complete=True)

    @property
    def usage_line(self) -> str:
        words = [self.prog]
        for action in self._actions:
            if isinstance(action, argparse._SubParsersAction):
                words.append(str(action.metavar))
            elif not action.option_strings:
                words.append(f"[{action.metavar}]" if action.nargs == "?" else str(action.metavar))
            elif action.required:
                words.append(f"{action.option_strings[0]} {action.metavar}")
        return " ".join([*words, "[options]"])

    def _help(self, actions: Sequence[argparse.Action], is_complete: bool) -> str:
        formatter = self._get_formatter()
        formatter.add_usage(self.usage_line.replace("%", "%%"), [], [])
        formatter.add_text(self.description)
        for group in self._action_groups:
            formatter.start_section(group.title)
            formatter.add_arguments([each for each in group._group_actions if each in actions])
            formatter.end_section()
        if is_complete:
            formatter.start_section("parameters for --set NAME=VALUE")
            formatter.add_arguments(self.settings)
            formatter.end_section()
            formatter.add_text(self.details)
        elif len(actions) < len(self._actions):
            count = sum(bool(each.option_strings) for each in self._actions)
            more = " and explains them" if self.details else ""
            formatter.add_text(f"{self.prog} --help-all shows all {count} options{more}.")
        elif self.details:
            formatter.add_text(f"{self.prog} --help-all explains more.")
        return formatter.format_help()

    def error(self, message: str) -> NoReturn:
        raise UsageError(f"{message}; see {self.prog} --help")

    def parse_all(self, words: list[str]) -> argparse.Namespace:
        """Parse arguments and refuse unknown ones; the result has the `parser` of its command."""
        arguments, unknown = self.parse_known_args(_with_merge_distance(words))
        if unknown:
            command: Parser = arguments.parser
            name = unknown[0].partition("=")[0]
            hint = did_you_mean(name, command._option_string_actions)
            setting = name.removeprefix("--").replace("-", "_")
            if setting in FIELDS and "--set" in command._option_string_actions:
                hint = f"; write --set {setting}=VALUE"
            command.error(f"{unknown[0]!r} is not an option{hint}")
        return arguments


class _HelpAll(argparse.Action):
    def __call__(self, parser: argparse.ArgumentParser, *_: Any, **__: Any) -> NoReturn:
        assert isinstance(parser, Parser)
        print(parser.format_help_all(), end="")
        parser.exit()


def _with_merge_distance(words: list[str]) -> list[str]:
    """Return the command line with ``--merge=auto`` in place of a ``--merge`` without distance."""
    found = []
    for word, following in zip(words, [*words[1:], ""], strict=False):
        is_alone = word == f"--{MERGE}" and not _DISTANCE.fullmatch(following)
        found.append(f"{word}=auto" if is_alone else word)
    return found


def adder(to: argparse._ActionsContainer) -> Callable[..., None]:
    """Return a short form of `add_argument`; an option without ``metavar`` is a flag."""

    def add(name: str, help: str, metavar: object = None, **settings: Any) -> None:
        value = {"metavar": metavar} if metavar or settings else {"action": "store_true"}
        to.add_argument(name, help=help, **(value | settings))

    return add


def add_view(add: Callable[..., None]) -> None:
    about = "side from which surfaces are shown in pictures and pages (default: best)"
    add("--view", about, choices=VIEWS)
    about = "axis that points upwards (default: auto, by the convention of the file or the shape)"
    add("--up", about, choices=UP_AXES)


def view_of(arguments: argparse.Namespace) -> ViewSpec:
    return ViewSpec(arguments.view or BEST_VIEW.name, arguments.up or BEST_VIEW.up)


def add_folder(parser: argparse.ArgumentParser, is_required: bool = False) -> None:
    add = adder(parser.add_argument_group(OUTPUT))
    about = "folder for the results, created if missing"
    add("--out", about, "DIR", type=folder, required=is_required)
    add_view(add)
    add("--no-pictures", "write the page without pictures")
    add_report(add)


def add_report(add: Callable[..., None]) -> None:
    add("--json", "print the result as one JSON object")
    add("--quiet", "do not show progress")


def add_workers(parser: argparse.ArgumentParser) -> None:
    add = adder(parser.add_argument_group("parallel processing"))
    what = "number of processes on this machine (default: one per core)"
    add("--jobs", what, "N", type=processes)
    what = (
        "use the cluster of the Dask scheduler at this address, such as tcp://10.0.0.1:8786. Use "
        "only a trusted one: it can run programs on this machine and on its workers"
    )
    add("--scheduler", what, "ADDRESS", type=address)
    add("--scheduler-file", "file with the address of the Dask scheduler", "FILE", type=Path)


def cluster_of(arguments: argparse.Namespace) -> Cluster:
    given = arguments.jobs, arguments.scheduler, arguments.scheduler_file
    if sum(each is not None for each in given) > 1:
        raise UsageError("--jobs, --scheduler and --scheduler-file exclude each other; give one")
    return Cluster(*given)


def add_inputs(parser: Parser, inputs: Sequence[Input], without: Iterable[str] = ()) -> None:
    """Declare a command-line option or argument for each input of a task, except ``without``."""
    groups: dict[str, argparse._ActionsContainer] = {"": parser}
    rare = [each for each in inputs if each.is_rare]
    for each in inputs:
        if each.name in without or each.is_rare:
            continue
        if each.group not in groups:
            groups[each.group] = parser.add_argument_group(each.group)
        help = f"{each.help} (default: {each.default})" if each.default else each.help
        help += "; repeatable" if each.repeats else ""
        words = each.metavar.split()
        settings: dict[str, Any] = {"help": help.replace("%", "%%")}
        if not words:
            settings |= {"action": "store_const", "const": "yes"}
        elif len(words) > 1:
            settings |= {"metavar": tuple(words), "nargs": len(words)}
        else:
            settings |= {"metavar": each.metavar}
        if each.without_value:
            settings |= {"nargs": "?", "const": each.without_value}
        if each.repeats:
            settings |= {"action": "append", "default": []}
        name = each.name if each.is_argument else f"--{each.name}"
        groups[each.group].add_argument(name, **settings)
    if rare:
        add = adder(groups[rare[0].group])
        text = f"set an advanced parameter, such as {rare[0].name}=1; repeatable"
        add("--set", text, "NAME=VALUE", action="append", default=[])
        for each in rare:
            name = f"{each.name.replace('-', '_')}={each.metavar}"
            help = f"{each.help} (default: {each.default})".replace("%", "%%")
            parser.settings.append(argparse.Action([], each.name, metavar=name, help=help))


def given_texts(
    arguments: argparse.Namespace, inputs: Sequence[Input]
) -> Iterator[tuple[str, str]]:
    rare, settings = by_name(each for each in inputs if each.is_rare), dict[str, str]()
    own = [option(name) for name in MAIN_FIELDS]
    for word in arguments.set if rare else ():
        name, sign, text = word.partition("=")
        name = option(name.strip())
        if name in own:
            raise UsageError(f"--set {brief(word)}: {name} has its own option, --{name}")
        if name not in rare:
            nearest = did_you_mean(name, [*own, *rare]) or f"; expected one of {', '.join(rare)}"
            raise UsageError(f"--set: {brief(name)} is not a parameter{nearest}")
        if not sign:
            raise UsageError(f"--set {brief(word)} is not NAME=VALUE")
        settings[name] = text.strip()  # the last one is used, as for options
    yield from settings.items()
    for each in inputs:
        if each.is_rare:
            continue
        given = getattr(arguments, each.name.replace("-", "_"), None)
        several = given or [] if each.repeats else [] if given is None else [given]
        for value in several:
            text = shlex.join(value) if isinstance(value, list) else value
            if not text.strip():
                raise UsageError(f"{shown_name(each)} is empty; give a value, or omit the option")
            yield each.name, text


def shown_name(each: Input) -> str:
    return each.metavar if each.is_argument else f"--{each.name}"


def add_mesh_options(parser: Parser) -> None:
    add_inputs(parser, MESH_INPUTS)


def mesh_options(arguments: argparse.Namespace) -> MeshOptions:
    inputs, values = by_name(MESH_INPUTS), dict[str, Any]()
    for name, text in given_texts(arguments, MESH_INPUTS):
        try:
            values[name] = inputs[name].read(text)
        except ParameterError as error:
            raise UsageError(f"--{name}: {error}") from None
    return options_in(values)


def load_result(path: str, *expected: type) -> Any:
    """Read a result of an expected type, and warn if its values had to be recomputed."""
    result = abfm.load(path, *expected)
    warn_if_recomputed(path, result)
    return result


def warn_if_recomputed(path: str, result: object) -> None:
    """Warn if values in the file of a result contradict its field and were recomputed."""
    match = getattr(result, "match", result)
    if load_warning := getattr(match, "load_warning", ""):
        text = f"values stored in {path} do not match its field and were recomputed: {load_warning}"
        print_note(text, "warning")


def size(text: str) -> tuple[int, int]:
    """Return the width and height of a picture for a text such as ``1600x900``."""
    width, cross, height = text.partition("x")
    if not cross or not (width.isdecimal() and height.isdecimal()):
        raise argparse.ArgumentTypeError(f"{text!r} is not a size such as 1600x900")
    if not (320 <= int(width) <= 16384 and 240 <= int(height) <= 16384):
        raise argparse.ArgumentTypeError(
            f"{text!r} is out of range; expected 320x240 to 16384x16384"
        )
    return int(width), int(height)


def _within(
    kind: type[int] | type[float], least: float, most: float, expected: str, text: str
) -> float:
    try:
        value = kind(text)
    except ValueError:
        value = math.nan
    if not least <= value <= most:
        raise argparse.ArgumentTypeError(f"{one_line(text, 40) or repr(text)} is not {expected}")
    return value


positive = partial(_within, float, math.ulp(0), 86400, "a number above 0 and at most 86400")
angle = partial(_within, float, -360_000, 360_000, "an angle from -360000 to 360000 degrees")
seed = partial(_within, int, 0, 1e39, "an integer of at least 0")
count = partial(_within, int, 1, 1_000_000, "an integer from 1 to 1000000")
processes = partial(_within, int, 1, 4096, "a number of processes, 1 to 4096")
width = partial(_within, int, 32, 2000, "an integer from 32 to 2000")
texels = partial(_within, int, 4, 16384, "an integer from 4 to 16384")


def folder(text: str) -> Path:
    """Return the path of a folder; refuse an empty text, such as that of an unset variable."""
    if not text.strip():
        raise argparse.ArgumentTypeError(f"{text!r} is not a folder; the current one is .")
    return Path(text)


def address(text: str) -> str:
    if not text.strip():
        raise argparse.ArgumentTypeError(
            f"{text!r} is not an address; expected one such as tcp://10.0.0.1:8786"
        )
    return text
