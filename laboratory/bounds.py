"""What a bound of distortion costs, and whether it is kept."""

from collections.abc import Callable, Iterator, Sequence
from time import process_time

import numpy as np

from abfm import match
from abfm.maps.distortion import Distortion
from abfm.matching import SHARE
from abfm.registration import Prepared, within

HEADS = (
    "",
    "bound",
    "kept by the initial map, %",
    "by the match, %",
    "within the bound, %",
    "folded",
    "left by the match",
    "within the bound",
    "times a match",
)
"""Of a table of `rows`: shares of the faces, the residuals, and CPU time."""


def rows(
    name: str, prepared: Prepared, bounds: Callable[[Distortion], Sequence[float]]
) -> Iterator[list[str]]:
    """Yield a row a bound, of those that an initial map's distortion asks for."""
    began = process_time()
    found = prepared.matched_by(match(prepared.problem))
    whole, first = process_time() - began, found.initial.distortion()
    for most in bounds(first):
        began = process_time()
        kept = within(found, most)
        times = (process_time() - began) / whole
        told = kept.distortion()
        shares = (each.share_within(most) for each in (first, found.distortion(), told))
        yield [
            name,
            f"{most:g}",
            *(f"{100 * share:.2f}" for share in shares),
            str(told.folded),
            f"{found.match.residual:.3f}",
            f"{kept.match.residual:.3f}",
            f"{times:.1f}",
        ]


def least(first: Distortion) -> float:
    """Return the least bound, in tenths, that 99% of the faces keep."""
    logs = np.abs(np.log2(np.maximum([first.area, first.conformal], 1e-9))).max(axis=0)
    return float(np.ceil(10 * np.quantile(logs, SHARE, method="inverted_cdf"))) / 10


def around(first: Distortion) -> list[float]:
    """Return a bound that an initial map exceeds, one that it just keeps, and a looser one."""
    most = least(first)
    return [round(share * most, 1) for share in (0.8, 1.0, 1.25)]
