"""Known waves: solved by a batch, they have the errors of the fields that are found here."""

import numpy as np
import pytest

from abfm import sequence
from abfm.batch import Cluster
from abfm.io import write_surface
from laboratory import waves
from tests.shapes import icosphere


@pytest.fixture
def few(monkeypatch):
    monkeypatch.setattr(waves, "KINDS", ("travelling",))
    monkeypatch.setattr(waves, "DISPLACEMENTS", (1.0,))
    monkeypatch.setattr(waves, "NOISES", (0.1,))
    monkeypatch.setattr(waves, "FRAMES", 3)


def test_waves_are_measured_by_rows_of_a_batch_that_are_kept(few, tmp_path):
    surface, mesh, one = tmp_path / "ball.ply", icosphere(2), Cluster(jobs=1)
    write_surface(surface, mesh)
    [result] = waves.measured(surface, tmp_path, one)
    [each] = waves.noisy(waves.load_mesh(surface))
    for gamma, errors in zip((0.0, 1.0), result.errors[1:], strict=True):
        found = sequence(each.wave.mesh, each.frames, gamma=gamma)
        own = [each.wave.errors(i, field) for i, field in enumerate(found.velocity)]
        np.testing.assert_array_equal(np.mean(own, axis=0), errors)
    kept = {path: path.stat().st_mtime_ns for path in tmp_path.glob("*.npz")}
    assert len(kept) == 2
    [again] = waves.measured(surface, tmp_path, one)
    np.testing.assert_array_equal(again.errors, result.errors)
    assert kept == {path: path.stat().st_mtime_ns for path in tmp_path.glob("*.npz")}
