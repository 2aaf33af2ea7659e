"""Another function times a factor, plus an offset."""

from dataclasses import dataclass

from abfm.functions.family import NUMBER, Family, Spec, parameter
from abfm.mesh import TriangleMesh
from abfm.types import FloatArray


@dataclass(frozen=True, kw_only=True)
class Scaled(Family):
    """Another function times a factor, plus an offset, in the unit of the function."""

    family = "scaled"
    positional = "factor"
    factor: float = parameter(NUMBER, "what values are multiplied by")
    offset: float = parameter(NUMBER, "what is added to them after that", default=0.0)
    function: Spec  # given in parentheses after the numbers

    def __str__(self) -> str:
        return f"{super().__str__()}({self.function})"

    def evaluate(self, mesh: TriangleMesh) -> FloatArray:
        return self.factor * self.function.evaluate(mesh) + self.offset


def scaled(spec: Spec, factor: float, offset: float) -> Scaled:
    """Return a function times a factor, plus an offset; one that is scaled already once only."""
    if isinstance(spec, Scaled):
        offset += factor * spec.offset
        factor, spec = factor * spec.factor, spec.function
    return Scaled(factor=factor, offset=offset, function=spec)
