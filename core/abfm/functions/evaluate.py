"""From a text to values."""

import numpy as np

from abfm.errors import FunctionError
from abfm.functions.family import Spec, shown
from abfm.functions.spec import parse
from abfm.mesh import TriangleMesh
from abfm.types import FloatArray


def function(mesh: TriangleMesh, spec: str | Spec) -> FloatArray:
    """Values of a function at the vertices, (V,), finite, a new array every time.

    Raises a FunctionError if the text is no spec, names a vertex or file that does not fit the mesh, or gives values
    that are not finite.

    Parameters
    ----------
    spec : str or Spec
        Text such as ``"gaussian:vertex=12,width=0.1 + gaussian:vertex=3"``, or what :func:`parse` makes of it. The
        module :mod:`abfm.functions.spec` has the grammar; :func:`families` lists the families with their parameters.
    """
    tree = parse(spec) if isinstance(spec, str) else spec
    if not isinstance(tree, Spec):
        raise FunctionError(f"function is {spec!r}; expected a text such as 'gaussian:vertex=12', or what parse gives")
    with np.errstate(over="ignore", invalid="ignore"):
        values = np.array(tree.evaluate(mesh), dtype=np.float64, order="C")
    bad = np.flatnonzero(~np.isfinite(values))
    if len(bad):
        raise FunctionError(
            f"function {shown(str(tree))} is not finite at {len(bad)} of {len(values)} vertices, "
            f"for example {values[bad[0]]} at vertex {mesh.vertex_ids[bad[0]]}; every vertex needs a finite value"
        )
    return values
