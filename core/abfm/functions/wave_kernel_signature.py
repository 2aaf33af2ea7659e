"""Wave kernel signature."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from abfm.calculus.eigenbasis import eigenbasis
from abfm.errors import FunctionError
from abfm.functions.family import COUNT, NUMBER, POSITIVE, Family, Slider, parameter
from abfm.mesh import TriangleMesh
from abfm.types import FloatArray


@dataclass(frozen=True, kw_only=True)
class WaveKernelSignature(Family):
    r"""Wave kernel signature: how often a quantum particle of a given energy is found at a point.

    .. math:: \frac{\sum_k \phi_k(x)^2 g_k}{\sum_k g_k}, \quad g_k = \exp\frac{-(e - \log
    \lambda_k)^2}{2 \sigma^2}

    over the positive eigenvalues of the surface scaled to unit area. ``energy`` is the paper's e,
    the logarithm of an eigenvalue: small energies see the whole shape, large ones details (by
    Weyl's law the k-th is near ``log(4 pi k)``). ``width`` is the paper's sigma, by default its
    ``7 (e_max - e_min) / 100`` with the logarithms of the first and last eigenvalue used. No unit;
    does not change when the mesh is scaled or bent without stretching. The paper uses 300
    eigenpairs; here the constant counts as the first. At most the number of vertices is used.

    References
    ----------
    Aubry, Schlickewei, Cremers: The Wave Kernel Signature: A Quantum Mechanical Approach to Shape
    Analysis, ICCV Workshops 2011.
    """

    family: ClassVar[str] = "wks"
    energy: float = parameter(
        NUMBER, "logarithm of an eigenvalue", unit="log(1/area)", default=5.0, slider=Slider(0, 10)
    )
    width: float | None = parameter(
        POSITIVE,
        "spread of the energy",
        unit="log(1/area)",
        default=None,
        slider=Slider(0.01, 10, log=True),
    )
    eigenpairs: int = parameter(
        COUNT,
        "how many terms the sum has: more are sharper and take longer",
        default=128,
        slider=Slider(1, 256),
    )

    def check(self) -> None:
        if self.eigenpairs < 2:
            raise FunctionError(
                "wks: eigenpairs must be 2 or more: the first is the constant, which has no energy"
            )

    def evaluate(self, mesh: TriangleMesh) -> FloatArray:
        values, functions = eigenbasis(mesh.normalized(), min(self.eigenpairs, len(mesh.vertices)))
        energies = np.log(values[1:])
        # all energies may be equal
        width = self.width or max(0.07 * (energies[-1] - energies[0]), 1e-3)
        exponents = -0.5 * ((self.energy - energies) / width) ** 2
        # the largest is 1: no 0/0 at energies far from all
        weights = np.exp(exponents - exponents.max())
        return np.asarray(functions[:, 1:] ** 2 @ (weights / weights.sum()))
