"""Parsing of BIDS names of brain imaging files, and names for derived files.

BIDS names (https://bids-specification.readthedocs.io) have entities in a fixed order, a suffix and
an extension: ``sub-01_hemi-L_space-fsaverage_desc-abfm_sphere.surf.gii``.
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
"""Keys of entities in their order; those of transforms precede the description."""
_VALUE = re.compile(r"[0-9A-Za-z+]+")
_ENTITY = re.compile(rf"([A-Za-z]+)-({_VALUE.pattern})")
_WORD = re.compile(r"[0-9A-Za-z]+")
_EXTENSION = re.compile(r"(\.[0-9A-Za-z]+)+")
_FREESURFER = re.compile(r"[lr]h\.([0-9A-Za-z]+)")
_EXTENSIONS = (".surf.gii", ".shape.gii", ".func.gii", ".label.gii")  # if a name is not of BIDS


class BidsName(NamedTuple):
    """Parts of a name: values of entities by key, in their order, the suffix and the extension."""

    entities: dict[str, str]
    suffix: str
    extension: str


def parse_bids_name(path: str | os.PathLike[str]) -> BidsName | None:
    """Return the parts of a file name, or None if it is not a BIDS name."""
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
    """Return a BIDS name, without a folder, for a file derived from another one.

    The parts of the new name are those of the source's name, except for the arguments. Entities
    have the order of BIDS; unknown ones of the source precede ``desc``. If the source does not have
    a BIDS name, only its hemisphere is used, and the suffix of a FreeSurfer name such as
    ``lh.white``.

    Parameters
    ----------
    source : path
        A file, which does not need to exist.
    suffix, extension : str, optional
        Suffix and extension of the new name, such as ``sphere`` and ``.surf.gii``.
    **entities : str, int or None
        Values by keys of `ENTITIES`, such as ``sub="01", hemi="L", desc="abfm"``; None removes an
        entity of the source.

    Raises
    ------
    ParameterError
        If a key or a value is not valid in BIDS. Also if entities, suffix or extension are missing
        in both source and arguments.

    Examples
    --------
    >>> bids_name("sub-01_hemi-L_white.surf.gii", suffix="sphere", space="fsaverage", desc="abfm")
    'sub-01_hemi-L_space-fsaverage_desc-abfm_sphere.surf.gii'
    >>> bids_name("surf/rh.sulc", extension=".shape.gii", sub="01")
    'sub-01_hemi-R_sulc.shape.gii'
    """
    parsed = parse_bids_name(source) or _other_name(source)
    found = dict(parsed.entities)
    for key, value in entities.items():
        if key not in ENTITIES:
            raise ParameterError(
                f"{brief(key)} is not an entity of BIDS{did_you_mean(key, ENTITIES)}; expected one "
                f"of {', '.join(ENTITIES)}"
            )
        found.pop(key, None)
        if value is not None:
            found[key] = _part(key, str(value), _VALUE, "01")
    if not found:
        raise ParameterError(
            f"a BIDS name needs an entity, but {brief(os.fspath(source))} has none. Use for "
            "example sub='01'"
        )
    word = _part("suffix", suffix or parsed.suffix, _WORD, "sphere")
    end = _part("extension", extension or parsed.extension, _EXTENSION, ".surf.gii")
    keys = sorted(found, key=_place)
    return "_".join([*(f"{key}-{found[key]}" for key in keys), word]) + end


def _other_name(source: str | os.PathLike[str]) -> BidsName:
    name, side = os.path.basename(source), hemisphere(source)
    entities = {"hemi": side} if side else {}
    if freesurfer := _FREESURFER.fullmatch(name):
        return BidsName(entities, freesurfer[1], "")
    endings = (ending for ending in _EXTENSIONS if name.endswith(ending))
    return BidsName(entities, "", next(endings, ""))


def _place(key: str) -> tuple[float, str]:
    """Return a sorting key with the order of BIDS; unknown entities precede ``desc``."""
    return ENTITIES.index(key) if key in ENTITIES else len(ENTITIES) - 1.5, key


def _part(name: str, value: str, form: re.Pattern[str], example: str) -> str:
    if not form.fullmatch(value):
        problem = f"is {brief(value)}" if value else "is missing"
        raise ParameterError(
            f"{name} of a BIDS name {problem}; expected letters and digits, such as {example!r}"
        )
    return value
