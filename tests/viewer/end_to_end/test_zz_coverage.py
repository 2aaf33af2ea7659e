"""Last: every widget that the window showed to the other tests of this folder was used by one of them."""

from __future__ import annotations

from pathlib import Path

import pytest

FILES = {path.name for path in Path(__file__).parent.glob("test_*.py")}
DYNAMIC = ("File/Recent", "Open a mesh", "Open a project or a result", "Open values", "Open a vertex map")
"""Places whose labels are the names of files."""


def test_every_widget_was_used(coverage, request):
    chosen = {item.path.name for item in request.session.items if item.path.parent == Path(__file__).parent}
    options = request.config.option
    if chosen != FILES or options.keyword or any("::" in word for word in request.config.args):
        pytest.skip("only when all tests of this folder ran")
    assert len(coverage.used) > 150
    unused = sorted(coverage.unused(DYNAMIC))
    assert unused == [], "\n".join(map(str, unused))
