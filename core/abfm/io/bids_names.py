"""Names of brain imaging files: what they say, and names for what is made of them.

BIDS (https://bids-specification.readthedocs.io) calls files by entities in a fixed order, a suffix
and an extension: ``sub-01_hemi-L_space-fsaverage_desc-abfm_sphere.surf.gii``.
"""

import os
import re
from typing import NamedTuple

from abfm.errors import ParameterError, brief, did_you_mean
from abfm.reading import hemisphere

ENTITIES = (
    *("sub", "tpl", "ses", "cohort", "sample", "task", "tracksys", "acq", "nuc", "voi", "ce"),
    *("trc", "stain", "rec", "dir", "run", "mod", "echo", "flip", "inv", "mt", "part", "proc"),
    *("hemi", "space", "split", "recording", "chunk", "seg", "scale", "res", "den", "label"),
    *("from", "to", "mode", "desc"),
)
"""Keys of entities in their order, those of transforms before the description."""
_VALUE = re.compile(r"[0-9A-Za-z+]+")
_ENTITY = re.compile(rf"([A-Za-z]+)-({_VALUE.pattern})")
_WORD = re.compile(r"[0-9A-Za-z]+")
_EXTENSION = re.compile(r"(\.[0-9A-Za-z]+)+")
_FREESURFER = re.compile(r"[lr]h\.([0-9A-Za-z]+)")
_EXTENSIONS = (".surf.gii", ".shape.gii", ".func.gii", ".label.gii")  # of names that are no BIDS


class BidsName(NamedTuple):
    """What a name says: values of entities by their keys, in its order, suffix and extension."""

    entities: dict[str, str]
    suffix: str
    extension: str


def parse_bids_name(path: str | os.PathLike[str]) -> BidsName | None:
    """Return what a file's name says, or None if it is not made as BIDS has it."""
    stem, dot, rest = os.path.basename(path).partition(".")
    *pairs, suffix = stem.split("_")
    found = [_ENTITY.fullmatch(pair) for pair in pairs]
    entities = {match[1]: match[2] for match in found if match}
    extension = dot + rest
    is_bids = len(entities) == len(pairs) > 0 and _WORD.fullmatch(suffix)
    if not (is_bids and _EXTENSION.fullmatch(extension)):
        return None
    return BidsName(entities, suffix, extension)


def bids_name(
    source: str | os.PathLike[str],
    suffix: str | None = None,
    extension: str | None = None,
    **entities: str | int | None,
) -> str:
    """Return a name, without a folder, for what is made of a file.

    It says what the name of the source says, but for what is given. Entities stand in the order of
    BIDS; those of the source that BIDS does not know come before ``desc``. Of a source that is not
    called as BIDS has it, the hemisphere is taken, and of FreeSurfer's ``lh.white`` the suffix.

    Parameters
    ----------
    source : path
        It need not exist.
    suffix, extension : str, optional
        Such as ``sphere`` and ``.surf.gii``.
    **entities : str, int or None
        Values by keys of `ENTITIES`, such as ``sub="01", hemi="L", desc="abfm"``; None leaves one
        of the source's out.

    Raises
    ------
    ParameterError
        If a key or a value is none of BIDS, no entity is left, or neither the source nor the
        arguments say the suffix or the extension.

    Examples
    --------
    >>> bids_name("sub-01_hemi-L_white.surf.gii", suffix="sphere", space="fsaverage", desc="abfm")
    'sub-01_hemi-L_space-fsaverage_desc-abfm_sphere.surf.gii'
    >>> bids_name("surf/rh.sulc", extension=".shape.gii", sub="01")
    'sub-01_hemi-R_sulc.shape.gii'
    """
    known = parse_bids_name(source) or _other_name(source)
    found = dict(known.entities)
    for key, value in entities.items():
        if key not in ENTITIES:
            raise ParameterError(
                f"{brief(key)} is no entity of BIDS{did_you_mean(key, ENTITIES)}; there are "
                f"{', '.join(ENTITIES)}"
            )
        found.pop(key, None)
        if value is not None:
            found[key] = _part(key, str(value), _VALUE, "01")
    if not found:
        raise ParameterError(
            f"no entity is left for a name made of {brief(os.fspath(source))}: give one, such as "
            "sub='01'"
        )
    word = _part("suffix", suffix or known.suffix, _WORD, "sphere")
    end = _part("extension", extension or known.extension, _EXTENSION, ".surf.gii")
    keys = sorted(found, key=_place)
    return "_".join([*(f"{key}-{found[key]}" for key in keys), word]) + end


def _other_name(source: str | os.PathLike[str]) -> BidsName:
    """Return what can be told of a name that is not as BIDS has it."""
    name, side = os.path.basename(source), hemisphere(source)
    entities = {"hemi": side} if side else {}
    if freesurfer := _FREESURFER.fullmatch(name):
        return BidsName(entities, freesurfer[1], "")
    endings = (ending for ending in _EXTENSIONS if name.endswith(ending))
    return BidsName(entities, "", next(endings, ""))


def _place(key: str) -> tuple[float, str]:
    """Return where a key stands; those that are not known just before the description."""
    return ENTITIES.index(key) if key in ENTITIES else len(ENTITIES) - 1.5, key


def _part(name: str, value: str, form: re.Pattern[str], example: str) -> str:
    if not form.fullmatch(value):
        given = f"is {brief(value)}" if value else "is missing"
        raise ParameterError(
            f"{name} of a BIDS name {given}; give letters and digits, such as {example!r}"
        )
    return value
