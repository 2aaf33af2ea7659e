"""What the plot of the energy marks."""

from __future__ import annotations

import numpy as np

from abfm_viewer.document.document import Run
from abfm_viewer.panels import energy


def run(
    stages: list[int], vertices: list[int], reaches: list[float], restarts: tuple[int, ...] = ()
) -> Run:
    return Run(
        np.ones((len(stages), 3)),
        np.array(stages),
        restarts,
        0.1,
        "",
        np.array(vertices, dtype=int),
        np.array(reaches),
    )


COARSE_TO_FINE = run([0, 0, 1, 2, 2, 3], [600, 600, 600, 2500, 2500, 2500], [0.5, 0.5, 0, 0, 0, 0])


def test_stages_and_finer_meshes_are_marked_apart():
    assert energy._stage_starts(COARSE_TO_FINE) == [2, 5]
    assert energy._mesh_starts(COARSE_TO_FINE) == [3]


def test_a_restart_is_no_finer_mesh():
    again = run([0, 1, 0, 1], [600, 2500, 600, 2500], [0.0] * 4, (2,))
    assert energy._mesh_starts(again) == [1, 3]
    assert energy._stage_starts(again) == []
    warm = run([0, 0], [600, 2500], [0.0] * 2, (1,))
    assert energy._mesh_starts(warm) == []


def test_what_is_under_the_mouse_is_told():
    assert energy._course(COARSE_TO_FINE, 0) == "mesh of 600 vertices, reach 0.5, stage 1"
    assert energy._course(COARSE_TO_FINE, 3) == "mesh of 2,500 vertices, stage 3"


def test_runs_of_before_have_stages_only():
    old = Run(np.ones((3, 3)), np.array([0, 0, 1]), (), 0.1, "")
    assert energy._course(old, 2) == "stage 2"
    assert energy._stage_starts(old) == [2]
    assert energy._mesh_starts(old) == []
