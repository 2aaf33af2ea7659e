"""Hemispheres of the brain, by the names of files and of anatomical structures."""

import os
import re

HEMISPHERES = {"L": "left", "R": "right"}
"""Words of the hemispheres."""
STRUCTURES = {side: f"Cortex{word.title()}" for side, word in HEMISPHERES.items()}
"""GIFTI's ``AnatomicalStructurePrimary`` of a cortex, by its hemisphere."""
_SIDES = {"lh": "L", "rh": "R"}
_WORDS = {word: side for side, word in HEMISPHERES.items()}  # in capitals or not
_IMAGING = re.compile(
    r"\.(gii|nii|annot|label|stc|mgh|mgz|asc|white|pial|inflated|smoothwm|orig|sphere|reg|sulc|curv"
    r"|thickness|area|volume)(\.gz)?$",
    re.IGNORECASE,
)


def hemisphere(path: str | os.PathLike[str]) -> str | None:
    """Return "L" or "R" if a file's name gives the hemisphere, or None.

    Names give it by ``hemi-L``, by ``lh``, ``L`` or ``left`` between dots and underscores, by
    ``-lh`` at the end of such a word, and the like; a name with both gives none.
    """
    words = re.split(r"[._]", os.path.basename(path))
    given = [word.removeprefix("hemi-") for word in words if word.startswith("hemi-")]
    sides = {_side(word) for word in given or words} - {None}
    return sides.pop() if len(sides) == 1 else None


def _side(word: str) -> str | None:
    if word in STRUCTURES:
        return word
    small = word.lower()
    return _WORDS.get(small) or _SIDES.get(small.rpartition("-")[2])


def named_side(path: str | os.PathLike[str]) -> str | None:
    """Return the `hemisphere` in the name of a file of brain imaging, or None: other files
    may call a hand ``left``.
    """
    name = os.path.basename(path).lower()
    words = [word.rpartition("-") for word in re.split(r"[._]", name)]
    is_clear = any(key == "hemi" or word in _SIDES for key, _, word in words)
    return hemisphere(path) if is_clear or _IMAGING.search(name) else None


def side_of(structure: str | None) -> str | None:
    """Return "L" or "R" of an anatomical structure such as ``CortexLeft``, or None."""
    known = {"Left": "L", "Right": "R"}
    return next((side for end, side in known.items() if (structure or "").endswith(end)), None)
