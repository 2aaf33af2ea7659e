"""Hemispheres of the brain in names of files and of anatomical structures."""

import os
import re

HEMISPHERES = {"L": "left", "R": "right"}  # words for the hemispheres
STRUCTURES = {side: f"Cortex{word.title()}" for side, word in HEMISPHERES.items()}
"""``AnatomicalStructurePrimary`` of GIFTI for the cortex of each hemisphere."""
_SIDES = {"lh": "L", "rh": "R"}
_WORDS = {word: side for side, word in HEMISPHERES.items()}  # words in upper or lower case
_IMAGING = re.compile(
    r"\.(gii|nii|annot|label|stc|mgh|mgz|asc|white|pial|inflated|smoothwm|orig|sphere|reg|sulc|curv"
    r"|thickness|area|volume)(\.gz)?$",
    re.IGNORECASE,
)


def hemisphere(path: str | os.PathLike[str]) -> str | None:
    """Return the hemisphere "L" or "R" in the name of a file; None if it has neither or both.

    The left hemisphere is a word between dots and underscores: ``hemi-L``, ``lh``, ``L``, ``left``,
    or one that ends with ``-lh``. The right hemisphere has the corresponding words.
    """
    words = re.split(r"[._]", os.path.basename(path))
    entities = [word.removeprefix("hemi-") for word in words if word.startswith("hemi-")]
    sides = {_side(word) for word in entities or words} - {None}
    return sides.pop() if len(sides) == 1 else None


def _side(word: str) -> str | None:
    if word in STRUCTURES:
        return word
    small = word.lower()
    return _WORDS.get(small) or _SIDES.get(small.rpartition("-")[2])


def named_side(path: str | os.PathLike[str]) -> str | None:
    """Return the `hemisphere` in the name of a brain imaging file; None for other files.

    In other names, ``left`` may refer to a hand, for example.
    """
    name = os.path.basename(path).lower()
    words = [word.rpartition("-") for word in re.split(r"[._]", name)]
    is_clear = any(key == "hemi" or word in _SIDES for key, _, word in words)
    return hemisphere(path) if is_clear or _IMAGING.search(name) else None


def side_of(structure: str | None) -> str | None:
    """Return "L" or "R" for an anatomical structure such as ``CortexLeft``; None for others."""
    endings = {"Left": "L", "Right": "R"}
    return next((side for end, side in endings.items() if (structure or "").endswith(end)), None)
