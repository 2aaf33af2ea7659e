"""The surfaces in the window: source, advected and target side by side, on one colour range and one camera."""

from __future__ import annotations

import numpy as np

from abfm import TriangleMesh
from abfm.mesh import FloatArray
from abfm_viewer import camera, material
from abfm_viewer.colormaps import color_range
from abfm_viewer.opengl import ps

NAMES = ("source", "advected", "target")
_SPACING = 1.15


class Scene:
    """Three copies of a mesh, moved apart sideways in the vertices themselves (picks are wrong on moved structures)."""

    def __init__(self, mesh: TriangleMesh, source: FloatArray, target: FloatArray) -> None:
        view = camera.best_view(mesh, source, target)
        sideways = np.cross(view.up, view.direction)
        along = mesh.vertices @ sideways
        step = _SPACING * (along.max() - along.min()) * sideways
        self._range = color_range(source, target)
        self._heads: dict[str, FloatArray] = {}
        ps.remove_all_structures()
        ps.set_ground_plane_mode("none")
        copies = [mesh.vertices + number * step for number in range(len(NAMES))]
        for name, vertices, values in zip(NAMES, copies, (source, source, target), strict=True):
            ps.register_surface_mesh(name, vertices, mesh.faces, smooth_shade=True, material=material.NAME)
            middle = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
            top = (vertices @ view.up).max()
            self._heads[name] = middle + (top - middle @ view.up) * view.up
            self._show(name, values)
        self._camera = camera.fitted(np.concatenate(copies), view, ps.get_aspect_ratio_width_over_height(), 0.1)
        self.reset_camera()

    def reset_camera(self) -> None:
        """Look at all three from the front."""
        self._camera.place()

    def show_advected(self, values: FloatArray) -> None:
        """Draw the middle surface with other values (V,)."""
        self._show("advected", values)

    def labels(self) -> dict[str, tuple[float, float]]:
        """Where to write each surface's name, in window coordinates: above its top, wherever the camera is now."""
        width, height = ps.get_window_size()
        view = ps.get_camera_view_matrix()
        half = np.tan(np.radians(ps.get_vertical_fov_degrees() / 2))
        places = {}
        for name, head in self._heads.items():
            x, y, z, _ = view @ [*head, 1]
            if z < 0:
                scale = height / 2 / half / -z
                places[name] = (width / 2 + scale * x, height / 2 - scale * y)
        return places

    def _show(self, name: str, values: FloatArray) -> None:
        limits = (self._range.low, self._range.high)
        surface = ps.get_surface_mesh(name)
        surface.add_scalar_quantity("function", values, enabled=True, cmap=self._range.colormap, vminmax=limits)
