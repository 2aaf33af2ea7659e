"""A picture of the critical points that stay longest in a film, from two sides of its surface."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from PIL import Image
from scipy.ndimage import uniform_filter1d

from abfm import Sequence, TriangleMesh
from abfm.maps import project_onto_surface
from abfm.pages.film_motion import CRITICAL, Way, ways_of
from abfm.pages.front import Front, triple
from abfm.sequences import Track
from abfm_viewer.appearance.theme import linear
from abfm_viewer.pictures.canvas import canvas, drawn
from abfm_viewer.scene import opengl, overlays
from abfm_viewer.scene.surfaces import fitted, look, register, show, viewport
from abfm_viewer.shown.paint import Paint
from abfm_viewer.shown.tracks import KINDS

_LONGEST, _NEXT = 30, 60  # tracks that are drawn, and that are drawn thin
_SIZE, _ANGLE, _MARGIN = (900, 720), 18.0, 0.03  # pixels, degrees, share of the surface
_GROUND = 0.82  # of the surface, in linear light
_PALE = 0.55  # of the surface's colour, in tracks that are thin
_WIDE, _THIN, _END = 0.0038, 0.0016, 0.0085  # radii, of sqrt(area)
_MEANS = 5  # intervals
_SIDES = {"lateral": (1.0, 0.0, 0.0), "medial": (-1.0, 0.0, 0.0)}  # of a right hemisphere


def draw_tracks(film: Sequence, path: Path) -> None:
    """Draw a film's longest tracks on a right hemisphere whose axes are right, anterior, superior:
    wide where a critical point is one of the longest, with a dot where it was last.
    """
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

    found = film.tracks()[: _LONGEST + _NEXT]
    ways = ways_of([_smooth(track) for track in found])
    figure = Figure(figsize=(10, 4.75))
    for number, (name, direction) in enumerate(_SIDES.items()):
        plot = figure.add_axes((0.5 * number, 0.14, 0.5, 0.8))
        plot.imshow(_seen(film.mesh, ways, Front(direction, (0.0, 0.0, 1.0))))
        plot.set_title(name, fontsize=11)
        plot.set_axis_off()
    least, most = len(found[min(_LONGEST, len(found)) - 1]), len(found[0])
    handles = [
        Line2D([], [], color=CRITICAL[kind][:3], linewidth=3, marker="o", label=_told(found, kind))
        for kind in KINDS
        if _told(found, kind)
    ]
    figure.legend(handles=handles, loc="lower center", ncols=len(handles), frameon=False)
    thin = len(found[-1])
    words = f"wide: seen in {least} to {most} of {len(film)} intervals; thin: in {thin} or more"
    figure.text(0.5, 0.105, words, ha="center", fontsize=9.5, color="#5a6270")
    figure.savefig(path, dpi=115)


def _told(tracks: list[Track], kind: str) -> str:
    count = sum(track.kind == kind for track in tracks)
    return f"{count} {kind}{'s' * (count != 1)}" if count else ""


def _seen(mesh: TriangleMesh, ways: list[Way], front: Front) -> Image.Image:
    """Draw the surface and ways on it, the longest ones first in the list."""
    width, height = _SIZE
    with canvas(width, height):
        opengl.clear()
        look(fitted(mesh.vertices, front, width / height, _ANGLE, _MARGIN), mesh)
        colors = np.full((len(mesh.vertices), 3), _GROUND)
        show(register("surface", mesh), mesh, Paint("colors", colors, ""))
        for kind in KINDS:
            for is_long in (False, True):
                own = [
                    way
                    for place, way in enumerate(ways)
                    if way.kind == kind and (place < _LONGEST) == is_long
                ]
                if own:
                    _draw(mesh, own, kind, is_long)
        return Image.fromarray(drawn(transparent=True))


def _draw(mesh: TriangleMesh, ways: list[Way], kind: str, is_long: bool) -> None:
    color = np.array(linear(CRITICAL[kind])[:3])
    if not is_long:
        color += _PALE * (_GROUND - color)
    places = [viewport(mesh).drawn(way.points.positions) for way in ways]
    starts = np.cumsum([0, *map(len, places)])
    steps = [np.arange(a, b - 1) for a, b in pairwise(starts)]
    edges = np.concatenate(steps)[:, None] + np.array([0, 1])
    name, look = f"{kind}, {is_long}", {"color": tuple(color), "material": opengl.MATERIAL}
    tubes = opengl.ps.register_curve_network(name, np.concatenate(places), edges, **look)
    tubes.reset_transform()
    tubes.set_radius(_WIDE if is_long else _THIN, relative=False)
    if is_long:
        ends = np.array([way.points.positions[-1] for way in ways])
        overlays.draw_points(f"ends of each {kind}", mesh, ends, triple(color), _END)


def _smooth(track: Track) -> Track:
    """Return a track without the steps from face to face: means over some intervals."""
    places = uniform_filter1d(track.points.positions, _MEANS, axis=0, mode="nearest")
    return replace(track, points=project_onto_surface(track.points.mesh, places))
