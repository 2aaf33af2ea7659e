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
_DISTANCE_MIN = 0.5  # of the middles along an axis, over the mean width
_PLACES = {"L": "first", "R": "second"}
_CONVENTION = ", as Connectome Workbench and nilearn order them"


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


def keep_hemisphere(draft: Draft, side: str) -> str:
    """Keep the components of one side, and return how it was chosen if not by x, see
    `hemispheres`. A surface in one piece stays.
    """
    name = HEMISPHERES[side]
    component = components(draft)
    if component.max() == 0:
        draft.messages.append(f"the surface has one component, which is taken as the {name} one")
        return ""
    found = hemispheres(draft)
    if found is None:
        raise MeshError(
            f"the {name} hemisphere is requested, but the surface does not have two large "
            "components of similar size, next to each other along x or one after the other in the "
            "file: leave the option out, or give a file of one hemisphere"
        )
    is_left, is_by_order = found
    place = f", the {_PLACES[side]} in the file" if is_by_order else ""
    convention = _CONVENTION if is_by_order else ""
    kept = is_left if side == "L" else ~is_left
    _keep(draft, kept, f"the {name} hemisphere{place}{convention}")
    return place


def hemispheres(draft: Draft) -> tuple[BoolArray, bool] | None:
    """Return the faces of the left hemisphere, (F,), where the surface has two, and whether it is
    the left one by its place in the file.

    That of the smaller x is the left one; other components belong to that whose middle is nearer.
    Of two at one place, such as spheres, it is the first in the file, up to where the other begins.
    """
    component, areas = components(draft), _areas(draft)
    sizes = np.bincount(component, areas)
    if len(sizes) < 2:
        return None
    two = np.argsort(-sizes, kind="stable")[:2]
    corners = draft.vertices[draft.faces]
    sums = [np.bincount(component, areas * x) for x in corners.mean(axis=1).T]
    middles = np.stack(sums, axis=1) / np.maximum(sizes, np.finfo(float).tiny)[:, None]
    widths = [np.ptp(corners[component == each], axis=(0, 1)) for each in two]
    gaps = np.abs(middles[two[0]] - middles[two[1]])
    is_apart = gaps > _DISTANCE_MIN * np.mean(widths, axis=0)
    alike = (
        sizes[two[1]] >= _AREA_RATIO_MIN * sizes[two[0]]
        and sizes[two].sum() >= _AREA_SHARE_MIN * sizes.sum()
    )
    if not alike:
        return None
    if is_apart[0]:
        is_left = middles[:, 0] < middles[two, 0].mean()
        return is_left[component], False
    vertices = (draft.faces[component == each] for each in two)
    (_, end), (start, _) = sorted((each.min(), each.max()) for each in vertices)
    if is_apart.any() or end > start:
        return None
    first = np.full(len(sizes), start)
    np.minimum.at(first, component, draft.faces.min(axis=1))
    return first[component] < start, True


def _areas(draft: Draft) -> FloatArray:
    return twice_areas(draft.vertices, draft.faces)


def _keep(draft: Draft, kept: BoolArray, what: str) -> None:
    vertices, faces = len(draft.vertices), len(draft.faces)
    draft.keep(kept)
    draft.messages.append(
        f"kept {what}: {len(draft.vertices)} of {vertices} vertices, {len(draft.faces)} of {faces} "
        "faces"
    )
