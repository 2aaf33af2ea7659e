"""Critical points of a simulated rotating wave that persist longest, from two sides of a brain."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from scipy.interpolate import RBFInterpolator
from scipy.io import loadmat
from scipy.ndimage import uniform_filter1d

import abfm
from abfm.maps import project_onto_surface
from abfm.pages.front import Front
from abfm.pages.sequence_motion import CRITICAL_COLORS, PointPath, track_paths
from abfm.sequences import Track, defaults
from abfm_viewer.appearance.theme import linear
from abfm_viewer.pictures.canvas import Pixels, canvas, rendered
from abfm_viewer.scene import opengl, overlays
from abfm_viewer.scene.surfaces import fitted, register, set_camera, show
from abfm_viewer.shown.paint import Paint

_REGIONS = 40  # number of nearest regions that determine the value at a vertex
_WIDE_COUNT = 30  # tracks that are drawn wide, the longest ones
_THIN_COUNT = 60  # tracks that are drawn thin, the next longest ones
_SIZE = (900, 720)  # pixels
_GREY = 0.82  # of the surface, in linear light
_PALE = 0.5  # share of the surface's colour in thin tracks
_HALF_WIDTHS = {True: 0.0036, False: 0.0016}  # of wide and thin tracks, in sqrt(area)
_DOT = 0.010  # radius of the dot at the end of a wide track, in sqrt(area)
_MEANS = 5  # number of intervals in a moving average of positions
_SIDES = {"lateral": (1.0, 0.0, 0.0), "medial": (-1.0, 0.0, 0.0)}  # directions to the viewer


def rotating_wave(folder: Path) -> abfm.Sequence:
    """Read ``rotating_wave`` of neural-flows from a folder, and return its matched sequence.

    The activity of 513 regions is interpolated on the surface by thin-plate splines.
    """
    cortex = loadmat(folder / "neural_flows_cortex_mesh.mat")["cortex"][0, 0]
    faces = cortex["faces"].astype(np.int64) - 1
    mesh = abfm.load_mesh((cortex["vertices"], faces), hemisphere="R")
    wave = loadmat(folder / "rotating_wave_W_c1_d1ms_trial1.mat")
    spline = RBFInterpolator(wave["locs"], wave["data"].T, neighbors=_REGIONS)
    frames = spline(mesh.vertices).T
    parameters = defaults(order=1, alpha=1.0, sigma=0.1)
    return abfm.sequence(mesh, frames, parameters=parameters, dt=float(wave["ht"].item()) / 1000)


def draw(sequence: abfm.Sequence, path: Path) -> None:
    """Draw the longest tracks on a right hemisphere with axes right, anterior and superior.

    The longest tracks are wide lines with a dot at the end, and the next ones are thin lines.
    """
    tracks = sequence.tracks()[: _WIDE_COUNT + _THIN_COUNT]
    paths = track_paths([_smooth(track) for track in tracks])
    figure = Figure(figsize=(10, 4.75))
    for number, (name, direction) in enumerate(_SIDES.items()):
        plot = figure.add_axes((0.5 * number, 0.14, 0.5, 0.8))
        plot.imshow(_picture(sequence.mesh, paths, Front(direction, (0.0, 0.0, 1.0))))
        plot.set_title(name, fontsize=11)
        plot.set_axis_off()
    kinds = [track.kind for track in tracks]
    handles = [
        Line2D([], [], color=color[:3], linewidth=3, marker="o", label=_plural(kind, kinds))
        for kind, color in CRITICAL_COLORS.items()
        if kind in kinds
    ]
    figure.legend(handles=handles, loc="lower center", ncols=len(handles), frameon=False)
    longest, last_wide, last = (len(tracks[i]) for i in (0, _WIDE_COUNT - 1, -1))
    about = (
        f"wide lines: tracks of {last_wide} to {longest} of {len(sequence)} intervals; "
        f"thin lines: tracks of {last} to {last_wide} intervals"
    )
    figure.text(0.5, 0.105, about, ha="center", fontsize=9.5, color="#5a6270")
    figure.savefig(path, dpi=100)


def _plural(kind: str, kinds: Sequence[str]) -> str:
    count = kinds.count(kind)
    return f"{count} {kind}{'s' * (count != 1)}"


def _picture(mesh: abfm.TriangleMesh, paths: Sequence[PointPath], front: Front) -> Pixels:
    """Draw the surface with the paths of tracks, given from the longest to the shortest."""
    width, height = _SIZE
    with canvas(width, height):
        opengl.clear()
        set_camera(fitted(mesh.vertices, front, width / height), mesh)
        grey = np.full((len(mesh.vertices), 3), _GREY)
        show(register("surface", mesh), mesh, Paint("colors", grey, ""))
        for kind, color in CRITICAL_COLORS.items():
            for is_wide, shown in ((False, paths[_WIDE_COUNT:]), (True, paths[:_WIDE_COUNT])):
                places = [path.points.positions for path in shown if path.kind == kind]
                if not places:
                    continue
                pale = 0.0 if is_wide else _PALE
                rgb = tuple(((1 - pale) * np.array(linear(color)[:3]) + pale * _GREY).tolist())
                lines = [overlays.path_through(mesh, each) for each in places]
                ribbons = overlays.line_ribbons(lines, _HALF_WIDTHS[is_wide])
                overlays.draw_ribbons(f"{kind}, {is_wide}", mesh, ribbons, rgb)
                if is_wide:
                    ends = np.array([each[-1] for each in places])
                    overlays.draw_points(f"ends of each {kind}", mesh, ends, rgb, _DOT)
        return rendered(transparent=True)


def _smooth(track: Track) -> Track:
    """Return a track averaged over a few intervals, which removes its steps from face to face."""
    places = uniform_filter1d(track.points.positions, _MEANS, axis=0, mode="nearest")
    return replace(track, points=project_onto_surface(track.points.mesh, places))
