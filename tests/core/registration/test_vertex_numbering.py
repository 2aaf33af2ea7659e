"""Warnings about landmarks with the wrong first vertex number."""

import warnings

import numpy as np
import pytest
from scipy.spatial import cKDTree

from abfm.assets import asset_path
from abfm.errors import AbfmWarning
from abfm.mesh import load_mesh
from abfm.registration.initial import read_landmarks
from tests.messages import check_message

A, B = (load_mesh(asset_path(f"human_{name}.off")) for name in ("A", "fine_A"))
TRUE = cKDTree(B.vertices).query(A.vertices)[1]
OTHER_POSE = load_mesh(asset_path("human_B.off"))


def read(path, pairs, b=B, **options):
    np.savetxt(path, pairs, fmt="%d", delimiter=",")
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        found = read_landmarks(A, b, str(path), **options)
    return found, [str(each.message) for each in caught if each.category is AbfmWarning]


@pytest.mark.parametrize("count", [5, 8, 20])
@pytest.mark.parametrize("seed", range(4))
def test_only_shifted_landmarks_give_a_warning(tmp_path, seed, count):
    of_a = np.random.default_rng(seed).choice(np.arange(1, 1200), count, replace=False)
    pairs = np.stack([of_a, TRUE[of_a]], axis=1)
    assert read(tmp_path / "p.csv", pairs)[1] == []
    found, texts = read(tmp_path / "p.csv", pairs + 1, one_based=True)
    assert texts == []
    np.testing.assert_allclose(found.a.positions, A.vertices[of_a], atol=1e-12)
    same = np.stack([of_a, of_a], axis=1)
    assert read(tmp_path / "p.csv", same + 1, OTHER_POSE)[1] == []


def test_shifted_landmarks_are_reported(tmp_path):
    of_a = np.random.default_rng(1).choice(np.arange(1, 1200), 12, replace=False)
    pairs = np.stack([of_a, TRUE[of_a]], axis=1)
    [text] = read(tmp_path / "p.csv", pairs + 1)[1]
    check_message(text, "from 1 instead of 0", "--one-based")
    [text] = read(tmp_path / "p.csv", pairs, one_based=True)[1]
    check_message(text, "from 0 instead of 1", "Remove --one-based")
