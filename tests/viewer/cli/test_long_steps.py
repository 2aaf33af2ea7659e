"""What the command line says of work that takes seconds besides the iterations."""

from __future__ import annotations

import pytest

from abfm.assets import asset_path
from abfm.workers import progress
from abfm_viewer.cli import main
from tests.processes import argv


@pytest.mark.parametrize(("extra", "is_told"), [([], True), (["--quiet"], False)])
def test_what_is_expected_to_take_seconds_is_said_with_an_estimate(
    extra, is_told, tmp_path, monkeypatch, capsys
):
    monkeypatch.setattr(
        progress,
        "_rates",
        {"factoring for distances": (1.0, 0), "checking by flow lines": (1.0, 0)},
    )
    pair = argv("--source gaussian:vertex=0 --target gaussian:vertex=300 --iterations=5 --levels=1")
    main(
        ["match", str(asset_path("eight.off")), *pair, "--out", str(tmp_path / "match.npz"), *extra]
    )
    said = capsys.readouterr().err
    assert ("factoring for distances, about " in said) is is_told
    assert ("checking by flow lines, about " in said) is is_told
    assert "factoring a system" not in said  # nobody knows for how long, which is short here
