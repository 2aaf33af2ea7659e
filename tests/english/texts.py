"""Prose of a file: docstrings, comments, messages, and paragraphs of Markdown."""

import ast
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

_LIST_ITEM = re.compile(r"\s*([-*•]|\d+\.)\s+")
_CODE_SPAN = re.compile(r"``[^`]*``|`[^`]*`")
_LINK = re.compile(r"\[([^\]]*)\]\([^)]*\)")
_CODE_STARTS = (">>>", "... ", "abfm ", "--", "$ ", "import ", "sum_")
_OPTION = re.compile(r"(?<!\w)--[\w-]+")
_COLUMNS = re.compile(r"\S {2,}\S")
_TEMPLATE_CODE = re.compile(
    r"\{%.*?%\}|\{\{.*?\}\}|\{#.*?#\}|<style.*?</style>|<script.*?</script>", re.S
)
_TAG = re.compile(r"<[^>]+>")


@dataclass(frozen=True)
class Text:
    """A paragraph of prose with its place in a file."""

    path: Path
    line: int
    kind: str  # "docstring", "comment", "message" or "paragraph"
    words: str


@dataclass(frozen=True)
class Source:
    """Prose of a file; of Python code also some statements, and names with their docstrings."""

    texts: list[Text]
    definitions: list[tuple[str, str]]
    assignments: list[ast.stmt]  # of the module
    raised: list[ast.Raise]


def read(path: Path) -> Source:
    """Read the prose of a file; code, tables and spans of code are left out."""
    content, definitions, assignments, raised = path.read_text(encoding="utf-8"), [], [], []
    if path.suffix in {".py", ".pyi"}:
        tree = ast.parse(content)
        nodes = list(ast.walk(tree))
        documented = [
            (node, ast.get_docstring(node) or "")
            for node in nodes
            if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef)
        ]
        assignments = [each for each in tree.body if isinstance(each, ast.Assign | ast.AnnAssign)]
        raised = [node for node in nodes if isinstance(node, ast.Raise)]
        definitions = [(getattr(node, "name", ""), doc) for node, doc in documented]
        found = [*_docstrings(documented), *_comments(content, nodes), *_messages(nodes, path)]
    elif path.suffix == ".md":
        found = [(line, "paragraph", words) for line, words in _markdown(content)]
    elif path.suffix == ".html":
        plain = _TAG.sub(
            "\n", _TEMPLATE_CODE.sub(lambda code: re.sub(r"[^\n]", "", code[0]) or " x ", content)
        )
        found = [(line, "paragraph", words) for line, words in _paragraphs(plain)]
    else:
        found = [(line, "comment", words) for line, words in _script_comments(content)]
    return Source([Text(path, *text) for text in found], definitions, assignments, raised)


def _docstrings(documented: list[tuple[ast.AST, str]]) -> Iterator[tuple[int, str, str]]:
    for node, doc in documented:
        for line, words in _paragraphs(doc) if doc else ():
            yield node.body[0].lineno + line - 1, "docstring", words


def _comments(content: str, nodes: list[ast.AST]) -> Iterator[tuple[int, str, str]]:
    """Yield comments; consecutive lines that hold only a comment are one text."""
    block: list[str] = []
    begin = last = 0
    for number, comment, alone in _comment_lines(content, nodes):
        if comment.startswith(("#!", "# type:", "# noqa")):
            continue
        if not (block and alone and number == last + 1):
            if block:
                yield begin, "comment", " ".join(block)
            block, begin = [], number
        block.append(_without_code(comment.lstrip("# ")))
        last = number if alone else -1
    if block:
        yield begin, "comment", " ".join(block)


def _comment_lines(content: str, nodes: list[ast.AST]) -> Iterator[tuple[int, str, bool]]:
    """Yield the line of each comment, its text, and whether the line holds nothing else.

    A comment begins with the first # outside of strings. This is faster than `tokenize`.
    """
    lines = {k: line.encode() for k, line in enumerate(content.split("\n"), 1) if "#" in line}
    strings: dict[int, list[tuple[int, int]]] = {}
    for node in nodes:
        is_string = isinstance(node, ast.Constant) and isinstance(node.value, str | bytes)
        if is_string or isinstance(node, ast.JoinedStr):
            for k in lines.keys() & range(node.lineno, node.end_lineno + 1):
                start = node.col_offset if k == node.lineno else 0
                end = node.end_col_offset if k == node.end_lineno else len(lines[k])
                strings.setdefault(k, []).append((start, end))
    for k, line in lines.items():
        for mark in re.finditer(b"#", line):
            if not any(start <= mark.start() < end for start, end in strings.get(k, ())):
                yield k, line[mark.start() :].decode(), not line[: mark.start()].strip()
                break


def _messages(nodes: list[ast.AST], path: Path) -> Iterator[tuple[int, str, str]]:
    """Yield strings that hold a sentence; of tests only docstrings and comments are read."""
    if "tests" in path.parts:
        return
    skipped = set()
    for node in nodes:
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            skipped.add(id(node.value))
        if isinstance(node, ast.JoinedStr):
            skipped.update(id(part) for part in node.values)
            words = "".join(
                str(part.value) if isinstance(part, ast.Constant) else "X" for part in node.values
            )
            yield from _strings(node.lineno, words)
    for node in nodes:
        if (
            isinstance(node, ast.Constant)
            and isinstance(node.value, str)
            and id(node) not in skipped
        ):
            yield from _strings(node.lineno, node.value)


def _strings(line: int, words: str) -> Iterator[tuple[int, str, str]]:
    is_script = re.search(r"^import ", words, re.M)
    if not is_script and re.search(r"[a-z]{2,} [a-z]", words):
        yield from ((line, "message", part) for _, part in _paragraphs(words))


def _script_comments(content: str) -> Iterator[tuple[int, str]]:
    for number, line in enumerate(content.splitlines(), 1):
        comment = re.search(r"(?:^|\s)(?://|/?\*+)\s(.+)", line)
        if comment:
            yield number, _without_code(comment[1])


def _markdown(content: str) -> Iterator[tuple[int, str]]:
    lines = content.splitlines()
    fenced = False
    for number, line in enumerate(lines):
        is_fence = line.lstrip().startswith(("```", "~~~"))
        fenced ^= is_fence
        if fenced or is_fence or line.startswith(("    ", "![", "|", "#", ":::")):
            lines[number] = ""
    yield from _paragraphs("\n".join(lines))


def _without_code(words: str) -> str:
    plain = _OPTION.sub("X", _CODE_SPAN.sub("X", words))
    return _LINK.sub(r"\1", plain).replace("**", "")


def _paragraphs(text: str) -> Iterator[tuple[int, str]]:
    """Yield paragraphs with their first line; an item of a list or a new indent begins one."""
    block: list[str] = []
    begin, indent = 1, 0
    for number, line in enumerate([*text.splitlines(), ""], 1):
        depth = len(line) - len(line.lstrip())
        starts = bool(_LIST_ITEM.match(line)) or depth != indent or not line.strip()
        hanging = block and _LIST_ITEM.match(block[0]) and depth > indent and line.strip()
        if starts and block and not hanging:
            yield begin, _without_code(" ".join(part.strip() for part in block))
            block = []
        stripped = line.strip()
        is_prose = not (set(stripped) <= set("-=~") or _COLUMNS.search(stripped))
        if is_prose and not stripped.startswith(_CODE_STARTS):
            if not block:
                begin, indent = number, depth
            block.append(line)
