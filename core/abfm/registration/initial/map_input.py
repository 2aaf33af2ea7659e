"""What an initial map may be found by."""

from __future__ import annotations

from typing import NamedTuple

from abfm.mesh import TriangleMesh
from abfm.registration.correspondence import Correspondence
from abfm.registration.initial.landmark_pairs import Landmarks
from abfm.types import FloatArray


class MapInput(NamedTuple):
    """Two surfaces, functions on both, (C, V_A) and (C, V_B), and how much what of them counts."""

    a: TriangleMesh
    b: TriangleMesh
    f: FloatArray | None = None
    g: FloatArray | None = None
    mask_a: FloatArray | None = None  # (V_A,)
    mask_b: FloatArray | None = None  # (V_B,)
    weights: FloatArray | None = None  # (C,)
    landmarks: Landmarks | None = None


class Initial(NamedTuple):
    """An initial map; notes and warnings are a line each.

    Notes report how it was found. Warnings report why it may lead elsewhere: what begins with such
    a map is not registered, see `Registration.verdict`.
    """

    correspondence: Correspondence
    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
