"""An expanding ring and a rotating wedge on the visual areas V1 to V3, with the matched fields."""

from pathlib import Path

import nibabel as nib
import numpy as np
from PIL.Image import Image

import abfm
from abfm.calculus import face_areas, gradient
from abfm.calculus.operators import edge_lengths
from abfm.display import ViewSpec
from abfm.io.sheets import Panel, Sheet, Values
from abfm.types import BoolArray, FloatArray
from abfm_viewer.pictures import figure_picture
from abfm_viewer.window.wave import fsaverage5

WIDTHS = {"ring": 0.6, "wedge": 30.0}
"""Standard deviations of the stimuli: of the log of eccentricity, and of the angle in degrees."""
_CENTRES = {"ring": (np.log(0.8) + np.log(30)) / 2, "wedge": 90.0}  # at half of the time
_DISPLACEMENT = 0.7  # between frames, in mean edge lengths; median over the faces
_FRAMES = 6
_NOISE = 0.05  # standard deviation, relative to that of the frames
_SLOPE_MIN = 0.5  # smallest slope of a frame with an arrow, relative to the root mean square
_ECCENTRICITY_MIN = 1e-3  # degrees


def picture(folder: Path) -> Image:
    """Return the picture of both stimuli at two times, from the maps of neuropythy in a folder."""
    surfaces = fsaverage5()
    mesh, inflated = (
        abfm.load_mesh(surfaces / f"{name}_left.gii.gz") for name in ("white", "infl")
    )
    eccentricity, angle, area = (
        np.ravel(nib.load(folder / f"lh.benson14_{name}.v4_0.mgz").dataobj)[: len(mesh.vertices)]
        for name in ("eccen", "angle", "varea")
    )
    seen = np.isin(area, (1, 2, 3)) & (eccentricity > 0)
    phases = {"ring": np.log(np.maximum(eccentricity, _ECCENTRICITY_MIN)), "wedge": angle}
    # the polar angle reverses at the border between two areas
    in_one_area = (np.ptp(area[mesh.faces], axis=1) == 0) & seen[mesh.faces].all(axis=1)
    patch = _Patch(inflated, mesh, seen)
    rows = []
    for kind, phase in phases.items():
        centres = _centres(mesh, kind, phase, in_one_area)
        activity = _activity(kind, phase - centres[:, None])
        noise = np.random.default_rng(0).standard_normal(activity.shape)
        measured = activity + _NOISE * activity[:, seen].std() * noise
        found = abfm.sequence(mesh, np.where(seen, measured, np.nan))
        row = []
        for interval in (0, len(found) - 1):
            centre = centres[interval]
            label = f"wedge at a polar angle of {centre:.0f}°"
            if kind == "ring":
                label = f"ring at an eccentricity of {np.exp(centre):.1f}°"
            sloped = in_one_area & _is_sloped(mesh, activity[interval], in_one_area)
            field = np.where(sloped[:, None], found.velocity[interval], 0)
            row.append(patch.panel(found.frames[interval, :, 0], field, label))
        rows.append(tuple(row))
    return figure_picture(Sheet(tuple(rows), view=ViewSpec(up="z")))


def _activity(kind: str, offsets: FloatArray) -> FloatArray:
    """Return the activity, a Gaussian, at offsets from the centre of a stimulus."""
    if kind == "wedge":
        offsets = (offsets + 180) % 360 - 180
    return np.exp(-0.5 * (offsets / WIDTHS[kind]) ** 2)


def _centres(
    mesh: abfm.TriangleMesh, kind: str, phase: FloatArray, inside: BoolArray
) -> FloatArray:
    """Return the centre of a stimulus in each frame, so that it moves by the given displacement."""
    slopes = np.linalg.norm((gradient(mesh) @ phase).reshape(-1, 2)[inside], axis=1)
    step = _DISPLACEMENT * edge_lengths(mesh).mean() * np.median(slopes)
    return _CENTRES[kind] + step * (np.arange(_FRAMES) - (_FRAMES - 1) / 2)


def _is_sloped(mesh: abfm.TriangleMesh, values: FloatArray, inside: BoolArray) -> BoolArray:
    """Return whether the values of a frame vary enough on each face for an arrow, (F,)."""
    slopes = np.linalg.norm((gradient(mesh) @ values).reshape(-1, 2), axis=1)
    weights = np.where(inside, face_areas(mesh), 0)
    return slopes > _SLOPE_MIN * np.sqrt(np.average(slopes**2, weights=weights))


class _Patch:
    """The part of ``surface`` with the vertices ``seen`` (V,); ``mesh`` has the same faces."""

    def __init__(
        self, surface: abfm.TriangleMesh, mesh: abfm.TriangleMesh, seen: BoolArray
    ) -> None:
        self._faces = seen[surface.faces].all(axis=1)
        self._vertices, faces = np.unique(surface.faces[self._faces], return_inverse=True)
        self.mesh = abfm.TriangleMesh(surface.vertices[self._vertices], faces.reshape(-1, 3))
        before, after = (
            np.stack(
                [m.vertices[m.faces[:, k]] - m.vertices[m.faces[:, 0]] for k in (1, 2)], axis=2
            )
            for m in (mesh, surface)
        )
        self._maps = (after @ np.linalg.pinv(before))[self._faces]  # of tangent vectors

    def panel(self, values: FloatArray, field: FloatArray, label: str) -> Panel:
        """Return a panel of this part with values (V,) and a field (F, 3) of ``mesh``."""
        pushed = np.einsum("fxy,fy->fx", self._maps, field[self._faces])
        shown = Values(np.maximum(values[self._vertices], 0), "activity")  # without negative noise
        return Panel(self.mesh, shown, label, arrows=pushed)
