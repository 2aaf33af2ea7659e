"""Input and result of the methods for initial maps."""

from __future__ import annotations

from typing import NamedTuple

from abfm.mesh import TriangleMesh
from abfm.registration.correspondence import Correspondence
from abfm.registration.initial.landmark_pairs import Landmarks
from abfm.types import FloatArray


class MapInput(NamedTuple):
    """Input of a method for initial maps: two surfaces and the data on them."""

    a: TriangleMesh
    b: TriangleMesh
    f: FloatArray | None = None  # (C, V_A), functions of A
    g: FloatArray | None = None  # (C, V_B), functions of B
    mask_a: FloatArray | None = None  # (V_A,)
    mask_b: FloatArray | None = None  # (V_B,)
    weights: FloatArray | None = None  # (C,), weights of the channels
    landmarks: Landmarks | None = None


class Initial(NamedTuple):
    """An initial map with one-line notes and warnings.

    Notes report how the map was found. Warnings report why it may be wrong; the verdict of a
    registration with a warning is "not reached" (`Registration.verdict`).
    """

    correspondence: Correspondence
    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
