"""Eigenfunctions of the Laplace-Beltrami operator, and signatures made of them."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from abfm.calculus.eigenbasis import unit_eigenbasis
from abfm.errors import FunctionError
from abfm.functions.family import COUNT, INDEX, NUMBER, POSITIVE_REAL, Family, Slider, parameter
from abfm.mesh import TriangleMesh
from abfm.types import FloatArray


@dataclass(frozen=True, kw_only=True)
class Eigenfunction(Family):
    """Eigenfunction of the Laplace-Beltrami operator: 0 is the constant, higher ones oscillate
    faster.

    Scaled to max |f| = 1, sign as in :func:`~abfm.calculus.eigenbasis`; no unit. Which function
    comes of an eigenspace of several dimensions (on a sphere, say) is arbitrary but reproducible.
    """

    family = "eigenfunction"
    positional = "index"
    example = "eigenfunction:1"
    index: int = parameter(
        INDEX, "number of the eigenfunction; 0 is the constant", slider=Slider(0, 50)
    )

    def evaluate(self, mesh: TriangleMesh) -> FloatArray:
        if self.index == 0:
            return np.ones(len(mesh.vertices))
        f = unit_eigenbasis(mesh, self.index + 1)[1][:, self.index]
        largest: float = np.abs(f).max()
        return f / largest


def _pairs(mesh: TriangleMesh, most: int) -> tuple[FloatArray, FloatArray]:
    return unit_eigenbasis(mesh, min(most, len(mesh.vertices)))


def _eigenpairs() -> Any:
    summary = "how many terms the sum has: more are sharper and take longer"
    return parameter(COUNT, summary, default=128, slider=Slider(1, 256))


@dataclass(frozen=True, kw_only=True)
class HeatKernelSignature(Family):
    r"""Heat kernel signature: how much heat stays at a point; large on tips, small in saddles.

    .. math:: \frac{\sum_k e^{-\lambda_k t} \phi_k(x)^2}{\sum_k e^{-\lambda_k t}}

    with the eigenpairs of the surface scaled to unit area: the heat kernel divided by its trace, as
    its authors [Sun, Ovsjanikov, Guibas, SGP 2009] compare points. It has no unit and integrates to
    1 over the unit-area surface. Heat spreads over about ``sqrt(time)`` times sqrt(area). The paper
    uses 300 eigenpairs and times between ``4 ln 10 / lambda_300`` and ``4 ln 10 / lambda_2``; the
    default of 128 is accurate for times above about 0.006, and ten times faster than 300.
    """

    family = "hks"
    time: float = parameter(
        POSITIVE_REAL, "diffusion time", unit="area", default=0.01, slider=Slider(1e-4, 1, log=True)
    )
    eigenpairs: int = _eigenpairs()

    def evaluate(self, mesh: TriangleMesh) -> FloatArray:
        values, functions = _pairs(mesh, self.eigenpairs)
        weights = np.exp(-values * self.time)
        return np.asarray(functions**2 @ (weights / weights.sum()))


@dataclass(frozen=True, kw_only=True)
class WaveKernelSignature(Family):
    r"""Wave kernel signature: how often a quantum particle of a given energy is found at a point.

    .. math:: \frac{\sum_k \phi_k(x)^2 g_k}{\sum_k g_k}, \quad g_k = \exp\frac{-(e - \log
    \lambda_k)^2}{2 \sigma^2}

    [Aubry, Schlickewei, Cremers, ICCV Workshops 2011] over the positive eigenvalues of the surface
    scaled to unit area; no unit. ``energy`` is the paper's e, the logarithm of an eigenvalue: small
    energies see the whole shape, large ones details (by Weyl's law the k-th is near
    ``log(4 pi k)``). ``width`` is the paper's sigma, by default its ``7 (e_max - e_min) / 100``
    with the logarithms of the first and last eigenvalue used. The paper uses 300 eigenpairs; here
    the constant counts as the first.
    """

    family = "wks"
    energy: float = parameter(
        NUMBER, "logarithm of an eigenvalue", unit="log(1/area)", default=5.0, slider=Slider(0, 10)
    )
    width: float | None = parameter(
        POSITIVE_REAL,
        "spread of the energy",
        unit="log(1/area)",
        default=None,
        slider=Slider(0.01, 10, log=True),
    )
    eigenpairs: int = _eigenpairs()

    def check(self) -> None:
        if self.eigenpairs < 2:
            raise FunctionError(
                "wks: eigenpairs must be 2 or more: the first is the constant, which has no energy"
            )

    def evaluate(self, mesh: TriangleMesh) -> FloatArray:
        values, functions = _pairs(mesh, self.eigenpairs)
        energies = np.log(values[1:])
        # all energies may be equal
        width = self.width or max(0.07 * (energies[-1] - energies[0]), 1e-3)
        exponents = -0.5 * ((self.energy - energies) / width) ** 2
        # the largest is 1: no 0/0 at energies far from all
        weights = np.exp(exponents - exponents.max())
        return np.asarray(functions[:, 1:] ** 2 @ (weights / weights.sum()))
