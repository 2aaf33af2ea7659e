"""Finds vertices of the surfaces in the window, and turns them to where they can be clicked on."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace

import numpy as np

from abfm import TriangleMesh
from abfm.types import FloatArray
from abfm_viewer.automation.input_events import Place
from abfm_viewer.document.document import Front, Look, triple
from abfm_viewer.errors import DriverError
from abfm_viewer.scene.scene import Hit
from abfm_viewer.window.window import Window

_ZOOMS = (1.0, 4.0)  # at which to look
_REACH = 12.0  # pixels from a vertex within which `nearest_vertex` finds it


@contextmanager
def aimed(window: Window, vertices: Sequence[int], surface: str) -> Iterator[list[Place]]:
    """Give the places of vertices, the first one turned to the front for the block if need be.

    Raises DriverError if there is no such surface, or the first vertex is hidden from every side.
    """
    window.tick()
    session, before = window.session, window.session.view.look
    turned = _turn_to(window, vertices[0], surface)
    try:
        yield [place(window, vertex, surface) for vertex in vertices]
    finally:
        if turned:
            session.editor.amend(view=replace(session.view, look=before))
    window.tick()


def place(window: Window, vertex: int, surface: str) -> Place:
    """Return where a vertex, numbered as in the mesh file, is in the window."""
    x, y, _ = window.scene.projected(surface, _position(window, vertex, surface))[0]
    return float(x), float(y)


def _turn_to(window: Window, vertex: int, surface: str) -> bool:
    """Turn the surfaces so that a vertex can be clicked on; whether that was needed."""
    if _sees(window, vertex, surface):
        return False
    session, mesh = window.session, window.session.surface(surface).mesh
    before, target = session.view.look, triple(_position(window, vertex, surface))
    for direction in _directions(mesh, mesh.local_vertex(vertex)):
        axis = np.eye(3)[1] if abs(direction[1]) < 0.9 else np.eye(3)[2]
        up = axis - (axis @ direction) * direction
        up /= np.linalg.norm(up)
        for zoom in _ZOOMS:
            look = Look(Front(triple(direction), triple(up)), zoom, target)
            session.editor.amend(view=replace(session.view, look=look))
            window.tick()
            if _sees(window, vertex, surface):
                return True
    session.editor.amend(view=replace(session.view, look=before))
    raise DriverError(f"vertex {vertex} of the {surface} is hidden from all sides: pick another")


def nearest_vertex(window: Window, position: Place) -> Hit | None:
    """Return the vertex drawn nearest to a place: for backends that draw nothing to pick."""
    scene, hits = window.scene, []
    for surface in scene.shown:
        mesh = window.session.surface(surface).mesh
        x, y, depth = scene.projected(surface, mesh.vertices).T
        distances = np.hypot(x - position[0], y - position[1])
        near = np.flatnonzero((distances <= max(distances.min(), 1)) & (distances < _REACH))
        if len(near):
            vertex = near[np.argmin(depth[near])]
            hits.append((distances[vertex], scene.nearest(surface, mesh.vertices[vertex])))
    return min(hits, key=lambda hit: hit[0])[1] if hits else None


def _position(window: Window, vertex: int, surface: str) -> FloatArray:
    scene, mesh = window.scene, window.session.surface(surface).mesh
    if surface not in scene.shown:
        raise DriverError(f"there is no surface {surface!r}; surfaces are {', '.join(scene.shown)}")
    position: FloatArray = mesh.vertices[mesh.local_vertex(vertex)]
    return position


def _sees(window: Window, vertex: int, surface: str) -> bool:
    x, y = place(window, vertex, surface)
    left, top, right, bottom = window.scene.view.slots[surface].rect
    if not (left < x < right and top < y < bottom):
        return False
    hit = window.scene.pick((x, y))
    local = window.session.surface(surface).mesh.local_vertex(vertex)
    return hit is not None and (hit.surface, hit.vertex) == (surface, local)


def _directions(mesh: TriangleMesh, vertex: int) -> FloatArray:
    """Return unit vectors to look from at a vertex: its normal first, and others around it."""
    corners = mesh.vertices[mesh.faces[(mesh.faces == vertex).any(axis=1)]]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]).sum(axis=0)
    normal /= max(float(np.linalg.norm(normal)), 1e-300)
    around = np.random.default_rng(0).normal(size=(24, 3))
    tilted = normal + 0.8 * around / np.linalg.norm(around, axis=1)[:, None]
    directions = np.concatenate([normal[None], tilted])
    facing: FloatArray = directions / np.linalg.norm(directions, axis=1)[:, None]
    return facing
