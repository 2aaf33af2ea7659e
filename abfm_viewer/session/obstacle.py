"""Why a match cannot start."""

from abfm_viewer.computing.evaluation import Evaluated
from abfm_viewer.document.document import Document


def obstacle(document: Document, specs: tuple[str, ...], found: Evaluated) -> str:
    """Why a match of a document cannot start, its functions being evaluated so far; empty if it can."""
    if not document.channels:
        return "a source and a target for this mesh are being chosen"
    for spec in specs:
        if spec in found.errors:
            return f"{spec}: {found.errors[spec]}"
    if any(spec not in found.values for spec in specs):
        return "the functions are being computed"
    mask = found.values.get(document.mask)
    if mask is not None and (mask.min() < 0 or not mask.any()):
        return "the mask must not be negative, nor zero everywhere"
    return "" if any(channel.weight for channel in document.channels) else "all channels have the weight 0"
