"""What witnesses that know nothing of how a match was found say of it, for an experiment's findings."""

import math
from dataclasses import dataclass

from abfm.errors import ParameterError
from abfm.experiments.experiment import Measure
from abfm.matching.result import Match


@dataclass(frozen=True, eq=False)
class Witnessed:
    """A match as its witnesses see it.

    The measures are the mismatch by flow lines, that on the subdivided mesh, and the folded faces, as far as they are
    known; the label, for the panel of the match, has both mismatches; the note is what is not known and why, a sentence
    after a space, empty if all is known.
    """

    measures: tuple[Measure, ...]
    label: str
    note: str


def witnessed(match: Match) -> Witnessed:
    """Ask the witnesses of `abfm.verify`."""
    try:
        found = match.verify()
    except ParameterError as error:
        return Witnessed((), "matched", f" Not verified: {error}.")
    numbers = {
        "mismatch by flow lines, relative L2": found.flow_lines,
        "mismatch on the subdivided mesh, relative L2": found.subdivided,
        "folded faces, as a share of all": found.folded,
    }
    return Witnessed(
        tuple(Measure(name, value) for name, value in numbers.items() if math.isfinite(value)),
        f"matched: {match.mismatch:.2g}, {found.flow_lines:.2g} by flow lines",
        " On the subdivided mesh the flow overflows." if math.isinf(found.subdivided) else "",
    )
