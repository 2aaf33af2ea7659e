"""Components of a surface, and choosing one of them."""

import numpy as np

from abfm.errors import MeshError
from abfm.mesh.draft import Draft
from abfm.mesh.face_sizes import twice_areas
from abfm.mesh.topology import connected
from abfm.reading import HEMISPHERES
from abfm.types import BoolArray, FloatArray, IntArray

_AREA_RATIO_MIN = 0.85  # the smaller over the larger area of two hemispheres
_AREA_SHARE_MIN = 0.9  # of the area of all components
_DISTANCE_MIN = 0.5  # of the middles along x, over the mean width


def components(draft: Draft) -> IntArray:
    """Return the component of each face, (F,): faces that share a vertex belong together."""
    faces = draft.faces
    sides = np.concatenate([faces[:, :2], faces[:, 1:]])
    return connected(len(draft.vertices), sides)[faces[:, 0]]


def keep_largest_component(draft: Draft) -> None:
    component = components(draft)
    count = component.max() + 1
    if count > 1:
        largest = component == np.argmax(np.bincount(component, _areas(draft)))
        _keep(draft, largest, f"the largest of {count} components")


def keep_hemisphere(draft: Draft, side: str) -> None:
    """Keep the components of one side: L is that of the smaller x. A surface in one piece stays."""
    name = HEMISPHERES[side]
    component = components(draft)
    if component.max() == 0:
        draft.messages.append(f"the surface has one component, which is taken as the {name} one")
        return
    found = hemispheres(draft)
    if found is None:
        raise MeshError(
            f"the {name} hemisphere is requested, but the surface does not have two large "
            "components of similar size next to each other along x: leave the option out, or give "
            "a file of one hemisphere"
        )
    _keep(draft, found if side == "L" else ~found, f"the {name} hemisphere")


def hemispheres(draft: Draft) -> BoolArray | None:
    """Return the faces of the left hemisphere, (F,), where the surface has two; others belong to
    that whose middle is nearer.
    """
    component, areas = components(draft), _areas(draft)
    sizes = np.bincount(component, areas)
    if len(sizes) < 2:
        return None
    two = np.argsort(-sizes, kind="stable")[:2]
    x = draft.vertices[draft.faces, 0]
    middles = np.bincount(component, areas * x.mean(axis=1)) / np.maximum(
        sizes, np.finfo(float).tiny
    )
    widths = [np.ptp(x[component == each]) for each in two]
    apart = np.abs(middles[two[0]] - middles[two[1]])
    alike = (
        sizes[two[1]] >= _AREA_RATIO_MIN * sizes[two[0]]
        and sizes[two].sum() >= _AREA_SHARE_MIN * sizes.sum()
    )
    if not alike or apart < _DISTANCE_MIN * np.mean(widths):
        return None
    is_left: BoolArray = middles < middles[two].mean()
    return is_left[component]


def _areas(draft: Draft) -> FloatArray:
    return twice_areas(draft.vertices, draft.faces)


def _keep(draft: Draft, kept: BoolArray, what: str) -> None:
    vertices, faces = len(draft.vertices), len(draft.faces)
    draft.keep(kept)
    draft.messages.append(
        f"kept {what}: {len(draft.vertices)} of {vertices} vertices, {len(draft.faces)} of {faces} "
        "faces"
    )
