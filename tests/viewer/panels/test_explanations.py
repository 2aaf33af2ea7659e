"""Buttons "?" of the panels: each of their topics has a section."""

import ast
from pathlib import Path

from abfm import explanations
from abfm.outcome import Outcome
from abfm_viewer import panels

FUNCTIONS = ("draw_help", "note_with_help")


def topics_in(path):
    """Return the topics, as text, of the buttons that a module draws."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    strings = (ast.Tuple, ast.List)
    for node in ast.walk(tree):
        is_call = isinstance(node, ast.Call) and getattr(node.func, "id", "") in FUNCTIONS
        given = node.args[1:] if is_call else []
        if isinstance(node, ast.Assign) and getattr(node.targets[0], "id", "") == "topics":
            given = node.value.elts if isinstance(node.value, strings) else []
        yield from (each.value for each in given if isinstance(each, ast.Constant))


def test_topics_of_all_buttons_have_a_section():
    folder = Path(panels.__file__).parent
    found = {topic for path in folder.rglob("*.py") for topic in topics_in(path)}
    assert {"residual", "trade-off", "initial-map cost", "uncertainty", "colour range"} <= found
    assert found - {*explanations.names()} == {"muted", "warning"} - {*Outcome}
