"""The quality of a map: how far its points came from the surface, and how many faces it folds.

A flow takes a surface to itself and folds nothing. The coordinates that the discrete flow carries
leave the surface and fold it where triangles are too coarse for the field, and a match of functions
does not notice.
"""

from dataclasses import dataclass

import numpy as np

from abfm.maps.point_maps import PointMap

LARGEST_DISTANCE, RMS_DISTANCE = 0.1, 0.02
"""Distances from the surface, in sqrt(area), beyond which a map is warned of.

Of 30 flows of known smooth fields on five surfaces every one with a largest distance beyond the
first had points more than 0.16 from the ends of exact flow lines; every one with an RMS beyond the
second was wrong by 0.03 on average.
"""
FOLDED = 0.1
"""Share of folded faces beyond which a map is warned of.

Of the same flows those within all three bounds were wrong by at most 0.022 on average, the others
by up to 0.13.
"""


@dataclass(frozen=True)
class MapQuality:
    """Numbers that tell a map from none.

    Attributes
    ----------
    largest_distance, rms_distance : float
        How far its points were from the surface before they were brought onto it, in sqrt(area) of
        the surface.
    folded : float
        Share of the faces, 0 to 1, that the map turns over (`abfm.maps.Distortion.flipped`).
    """

    largest_distance: float
    rms_distance: float
    folded: float

    @property
    def faults(self) -> str:
        """Name what exceeds its bound, in a few words; empty where nothing does."""
        wrong = []
        if self.largest_distance > LARGEST_DISTANCE or self.rms_distance > RMS_DISTANCE:
            wrong.append(
                f"points up to {self.largest_distance:.3g} sqrt(area) off the surface (RMS "
                f"{self.rms_distance:.3g})"
            )
        if self.folded > FOLDED:
            wrong.append(f"{100 * self.folded:.0f}% of the faces folded")
        return " and ".join(wrong)

    @property
    def warning(self) -> str | None:
        """Say what is wrong and what helps, in a line; None where nothing exceeds its bound."""
        advice = "a shorter time, a larger alpha or a finer mesh helps"
        return f"this map is not to be trusted: {self.faults}; {advice}" if self.faults else None

    def report(self) -> str:
        """Return the numbers in a line."""
        return (
            f"off the surface: largest {self.largest_distance:.3g}, RMS {self.rms_distance:.3g} "
            f"sqrt(area); folded: {100 * self.folded:.1f} % of the faces"
        )


def map_quality(points: PointMap) -> MapQuality:
    """Measure how far a map leaves its codomain and how many faces it folds."""
    folded = points.distortion().flipped
    distances = points.distances / points.codomain.length_scale
    return MapQuality(
        float(distances.max()), float(np.sqrt(np.mean(distances**2))), float(folded.mean())
    )
