"""A source and a target for any mesh, so that there is something to match at once."""

import numpy as np

import abfm
from abfm import TriangleMesh

WIDTH = 0.1


def default_functions(mesh: TriangleMesh) -> tuple[str, str]:
    """Specs of two Gaussians a quarter of the body apart, centred on the same side of it.

    The source sits in the middle of the body, halfway between the ends of (nearly) the longest geodesic, and rather on
    the side that looks along z, which most meshes have in front.
    """
    one_end = int(np.argmax(abfm.calculus.geodesic_distance(mesh, [0])))
    from_one_end = abfm.calculus.geodesic_distance(mesh, [one_end])
    other_end = int(np.argmax(from_one_end))
    from_other_end = abfm.calculus.geodesic_distance(mesh, [other_end])
    length, normals = from_one_end[other_end], abfm.functions.vertex_normals(mesh)
    source = int(np.argmin(np.maximum(from_one_end, from_other_end) / length - 0.1 * normals[:, 2]))
    off = np.abs(abfm.calculus.geodesic_distance(mesh, [source]) / length - 0.25)
    target = int(np.argmin(off - 0.1 * normals @ normals[source]))
    one, other = (f"gaussian:vertex={mesh.vertex_ids[vertex]},width={WIDTH}" for vertex in (source, target))
    return one, other
