"""Where the vertices of the surfaces are in the window, and looking from where one of them can be clicked on."""

from collections.abc import Callable, Sequence

import numpy as np

from abfm import TriangleMesh
from abfm.types import FloatArray
from abfm_viewer.automation.input_events import InputEvents, Place
from abfm_viewer.document.document import Camera, triple
from abfm_viewer.errors import DriverError
from abfm_viewer.scene.scene import Hit
from abfm_viewer.window.window import Window

_DISTANCES = (2.5, 0.8)  # from which to look, in sqrt(area)
_REACH = 12.0  # pixels from a vertex within which `nearest_vertex` finds it


def act_on(
    window: Window,
    input: InputEvents,
    vertices: Sequence[int],
    surface: str,
    modifiers: Sequence[str],
    act: Callable[[list[Place]], None],
) -> None:
    """Do something with the places of vertices while keys are held, the first one turned to the front if need be.

    Raises DriverError if there is no such surface, or the first vertex is hidden from every side.
    """
    window.tick()
    camera = _turn_to(window, vertices[0], surface)
    try:
        places = [place(window, vertex, surface) for vertex in vertices]
        for modifier in modifiers:
            input.hold(modifier, True)
        act(places)
        for modifier in modifiers:
            input.hold(modifier, False)
    finally:
        if camera is not None:
            window.scene.frame(window.parts.scene, camera)
    window.tick()


def place(window: Window, vertex: int, surface: str) -> Place:
    """Where a vertex, numbered as in the mesh file, is in the window."""
    x, y, _ = window.scene.viewport.projected(_position(window, vertex, surface))[0]
    return float(x), float(y)


def _turn_to(window: Window, vertex: int, surface: str) -> Camera | None:
    """Turn the camera so that a vertex can be clicked on; the camera before, or None if it could stay."""
    if _sees(window, vertex, surface):
        return None
    scene, rect = window.scene, window.parts.scene
    before, mesh = scene.camera(), window.session.mesh
    target = _position(window, vertex, surface)
    for direction in _directions(mesh, mesh.local_vertex(vertex)):
        axis = np.eye(3)[1] if abs(direction[1]) < 0.9 else np.eye(3)[2]
        up = axis - (axis @ direction) * direction
        up /= np.linalg.norm(up)
        for distance in _DISTANCES:
            position = target + distance * mesh.length_scale * direction
            scene.frame(rect, Camera(triple(position), triple(target), triple(up), before.angle))
            window.tick()
            if _sees(window, vertex, surface):
                return before
    scene.frame(rect, before)
    raise DriverError(f"vertex {vertex} of the {surface} cannot be seen from any side: pick another")


def nearest_vertex(window: Window, position: Place) -> Hit | None:
    """The vertex drawn nearest to a place of the window, hidden or not: for backends that draw nothing to pick."""
    scene, mesh = window.scene, window.session.mesh
    hits = []
    for surface in scene.names:
        x, y, depth = scene.viewport.projected(mesh.vertices + scene.offsets[surface]).T
        distances = np.hypot(x - position[0], y - position[1])
        near = np.flatnonzero((distances <= max(distances.min(), 1)) & (depth > 0) & (distances < _REACH))
        if len(near):
            vertex = near[np.argmin(depth[near])]
            hits.append((distances[vertex], scene.nearest(surface, mesh.vertices[vertex])))
    return min(hits, key=lambda hit: hit[0])[1] if hits else None


def _position(window: Window, vertex: int, surface: str) -> FloatArray:
    scene, mesh = window.scene, window.session.mesh
    if surface not in scene.offsets:
        raise DriverError(f"there is no surface {surface!r}; surfaces are {', '.join(scene.names)}")
    position: FloatArray = mesh.vertices[mesh.local_vertex(vertex)] + scene.offsets[surface]
    return position


def _sees(window: Window, vertex: int, surface: str) -> bool:
    left, top, right, bottom = window.parts.scene
    x, y = place(window, vertex, surface)
    if not (left < x < right and top < y < bottom):
        return False
    hit = window.scene.pick((x, y))
    return hit is not None and hit.surface == surface and hit.vertex == window.session.mesh.local_vertex(vertex)


def _directions(mesh: TriangleMesh, vertex: int) -> FloatArray:
    """Unit vectors to look from at a vertex: its normal first, and others around it."""
    corners = mesh.vertices[mesh.faces[(mesh.faces == vertex).any(axis=1)]]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]).sum(axis=0)
    normal /= max(float(np.linalg.norm(normal)), 1e-300)
    around = np.random.default_rng(0).normal(size=(24, 3))
    tilted = normal + 0.8 * around / np.linalg.norm(around, axis=1)[:, None]
    directions = np.concatenate([normal[None], tilted])
    facing: FloatArray = directions / np.linalg.norm(directions, axis=1)[:, None]
    return facing
