import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


def last_text(node):
    """Return the last literal part of a text or of a formatted text; "" if there is none."""
    if isinstance(node, ast.JoinedStr):
        return last_text(node.values[-1])
    return node.value if isinstance(node, ast.Constant) and isinstance(node.value, str) else ""


@pytest.mark.parametrize("folder", ["core/abfm", "abfm_viewer", "benchmarks"])
def test_errors_have_no_final_full_stop(folder):
    found = []
    for path in sorted((ROOT / folder).rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if not (isinstance(node, ast.Raise) and isinstance(node.exc, ast.Call)):
                continue
            ends = [last_text(argument).strip() for argument in node.exc.args]
            if any(end.endswith(".") and not end.endswith((" .", "...")) for end in ends):
                found.append(f"{path.relative_to(ROOT)}:{node.lineno}")
    assert found == []
