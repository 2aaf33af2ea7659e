"""Eigenfunctions of the Laplace-Beltrami operator, and the heat and wave kernel signatures."""

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
    """Eigenfunction of the Laplace-Beltrami operator.

    Eigenfunction 0 is constant, and higher ones oscillate faster. They are scaled to max |f| = 1,
    have no unit, and have the sign of :func:`~abfm.calculus.eigenbasis`. In an eigenspace of
    several dimensions, for example on a sphere, the choice is arbitrary but reproducible.
    """

    family = "eigenfunction"
    positional = "index"
    example = "eigenfunction:1"
    index: int = parameter(
        INDEX, "number of the eigenfunction; 0 is constant", slider=Slider(0, 50)
    )

    def evaluate(self, mesh: TriangleMesh) -> FloatArray:
        if self.index == 0:
            return np.ones(len(mesh.vertices))
        f = unit_eigenbasis(mesh, self.index + 1)[1][:, self.index]
        largest: float = np.abs(f).max()
        return f / largest


def _pairs(mesh: TriangleMesh, count: int) -> tuple[FloatArray, FloatArray]:
    return unit_eigenbasis(mesh, min(count, len(mesh.vertices)))


def _eigenpairs() -> Any:
    summary = "number of terms of the sum; more terms resolve finer details and take longer"
    return parameter(COUNT, summary, default=128, slider=Slider(1, 256))


@dataclass(frozen=True, kw_only=True)
class HeatKernelSignature(Family):
    r"""Heat kernel signature: the heat that remains at a point; large on tips, small in saddles.

    .. math:: \frac{\sum_k e^{-\lambda_k t} \phi_k(x)^2}{\sum_k e^{-\lambda_k t}}

    The eigenpairs are those of the surface scaled to unit area. The signature is the heat kernel
    divided by its trace, as in the comparison of points in [Sun, Ovsjanikov, Guibas, SGP 2009]. It
    has no unit, and integrates to 1 over the unit-area surface. Heat spreads over about
    ``sqrt(time)`` times sqrt(area). The paper uses 300 eigenpairs and times between
    ``4 ln 10 / lambda_300`` and ``4 ln 10 / lambda_2``. The default of 128 eigenpairs is accurate
    for times above about 0.006, and ten times faster than 300.
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
    r"""Wave kernel signature: the probability of a quantum particle of some energy at a point.

    .. math:: \frac{\sum_k \phi_k(x)^2 g_k}{\sum_k g_k}, \quad g_k = \exp\frac{-(e - \log
    \lambda_k)^2}{2 \sigma^2}

    The sum [Aubry, Schlickewei, Cremers, ICCV Workshops 2011] is over the positive eigenvalues of
    the surface scaled to unit area; it has no unit. ``energy`` is e in the paper, the logarithm of
    an eigenvalue. Small energies describe the overall shape, large ones details (by Weyl's law the
    k-th is close to ``log(4 pi k)``). ``width`` is sigma in the paper. Its default is that of the
    paper, ``7 (e_max - e_min) / 100`` with the logarithms of the first and last eigenvalue of the
    sum. The paper uses 300 eigenpairs; here the constant is counted as the first.
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
                "wks: eigenpairs is too small; expected 2 or more, as the first eigenfunction is "
                "constant and has no energy"
            )

    def evaluate(self, mesh: TriangleMesh) -> FloatArray:
        values, functions = _pairs(mesh, self.eigenpairs)
        energies = np.log(values[1:])
        # the width is positive even if all energies are equal
        width = self.width or max(0.07 * (energies[-1] - energies[0]), 1e-3)
        exponents = -0.5 * ((self.energy - energies) / width) ** 2
        # scaled so that the largest weight is 1; energies far from all eigenvalues would give 0/0
        weights = np.exp(exponents - exponents.max())
        return np.asarray(functions[:, 1:] ** 2 @ (weights / weights.sum()))
