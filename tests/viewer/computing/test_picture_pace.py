"""Pictures take a tenth of a run's time, whatever one takes."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from abfm_viewer.computing import picture_pace
from abfm_viewer.computing.picture_pace import PicturePace


@pytest.mark.parametrize(("picture", "pause"), [(0.01, 0.09), (0.001, 0.05), (1.0, 0.2)])
def test_none_is_made_for_nine_times_as_long_within_limits(
    picture: float, pause: float, monkeypatch
) -> None:
    now, made = [0.0], 0
    monkeypatch.setattr(picture_pace, "clock", SimpleNamespace(perf_counter=lambda: now[0]))

    class Iteration:
        @property
        def advected(self) -> None:
            nonlocal made
            made += 1
            now[0] += picture

    pace = PicturePace()
    for count in (1, 2, 3):
        assert pace.takes(Iteration())
        done = now[0]
        for moment in (done, done + 0.99 * pause):
            now[0] = moment
            assert not pace.takes(Iteration())
        assert made == count
        now[0] = done + 1.01 * pause
