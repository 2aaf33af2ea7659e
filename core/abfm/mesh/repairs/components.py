"""Components of a surface, and the choice of one component or hemisphere."""

import numpy as np

from abfm.errors import MeshError
from abfm.mesh.draft import Draft
from abfm.mesh.face_sizes import twice_areas
from abfm.mesh.topology import connected
from abfm.reading import HEMISPHERES
from abfm.types import BoolArray, FloatArray, IntArray

_AREA_RATIO_MIN = 0.85  # least ratio of the smaller to the larger area of two hemispheres
_AREA_SHARE_MIN = 0.9  # least share of both hemispheres in the area of all components
_DISTANCE_MIN = 0.5  # least distance of their middles along an axis, over the mean width
_PLACES = {"L": "first", "R": "second"}
_CONVENTION = " (the order of Connectome Workbench and nilearn)"


def components(draft: Draft) -> IntArray:
    """Return the component of each face, (F,); faces that share a vertex are connected."""
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
    """Keep the components of one hemisphere ("L" or "R"), see `hemispheres`.

    A surface of one component is not changed. Return a text if the order in the file distinguishes
    the hemispheres, such as ", the first in the file"; otherwise an empty one.
    """
    name = HEMISPHERES[side]
    if components(draft).max() == 0:
        draft.messages.append(
            f"the surface has one component, which was used as the {name} hemisphere"
        )
        return ""
    found = hemispheres(draft)
    if found is None:
        raise MeshError(
            f"the surface has no separate {name} hemisphere; expected two large components of "
            "similar size, separate in x or in the order of the file. Omit --hemisphere, or use "
            "a file of one hemisphere"
        )
    is_left, is_by_file_order = found
    place = f", the {_PLACES[side]} in the file" if is_by_file_order else ""
    convention = _CONVENTION if is_by_file_order else ""
    is_kept = is_left if side == "L" else ~is_left
    _keep(draft, is_kept, f"the {name} hemisphere{place}{convention}")
    return place


def hemispheres(draft: Draft) -> tuple[BoolArray, bool] | None:
    """Return whether each face (F,) is of the left hemisphere; None if there are no hemispheres.

    The hemispheres are two large components of similar area. The left one has the smaller x; every
    other component belongs to the hemisphere with the closer middle. Hemispheres at the same place,
    such as spheres, are ordered as in the file; only then the second result is True.
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
    is_separate = gaps > _DISTANCE_MIN * np.mean(widths, axis=0)
    are_similar = (
        sizes[two[1]] >= _AREA_RATIO_MIN * sizes[two[0]]
        and sizes[two].sum() >= _AREA_SHARE_MIN * sizes.sum()
    )
    if not are_similar:
        return None
    if is_separate[0]:
        is_left = middles[:, 0] < middles[two, 0].mean()
        return is_left[component], False
    vertices = (draft.faces[component == each] for each in two)
    (_, end), (start, _) = sorted((each.min(), each.max()) for each in vertices)
    if is_separate.any() or end > start:
        return None
    first = np.full(len(sizes), start)
    np.minimum.at(first, component, draft.faces.min(axis=1))
    return first[component] < start, True


def _areas(draft: Draft) -> FloatArray:
    return twice_areas(draft.vertices, draft.faces)


def _keep(draft: Draft, is_kept: BoolArray, what: str) -> None:
    vertices, faces = len(draft.vertices), len(draft.faces)
    draft.keep_faces(is_kept)
    draft.messages.append(
        f"kept {what}: {len(draft.vertices)} of {vertices} vertices, {len(draft.faces)} of {faces} "
        "faces"
    )
