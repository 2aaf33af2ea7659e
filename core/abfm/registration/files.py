"""Reading files of correspondences and registrations."""

from __future__ import annotations

from abfm.io import results
from abfm.matching.files import loaded_match
from abfm.registration.correspondence import Correspondence, correspondence_of
from abfm.registration.registration import Registration
from abfm.types import File


def load_correspondence(path: File) -> Correspondence:
    """Read a file of `Correspondence.save`; ResultError if it is missing, damaged, or none."""
    return results.loaded(path, results.CORRESPONDENCE, correspondence_of)


def load_registration(path: File) -> Registration:
    """Read a file of `Registration.save`; ResultError if it is missing, damaged, or none.

    As by `abfm.load`, what the field does not bear out is recomputed, and told in
    ``match.doubt``.
    """
    found = results.loaded(path, results.REGISTRATION, _registration_of)
    return found.matched_by(found.match.borne_out())


def _registration_of(arrays: results.Arrays) -> Registration:
    initial = correspondence_of(arrays)
    own = {name: arrays[name] for name in arrays.keys() & results.RESULT.entries.keys()}
    notes, warnings = (
        tuple(arrays[name].tolist()) if name in arrays else () for name in ("notes", "warnings")
    )
    match, functions = loaded_match(initial.b, own), arrays.get("a_functions")
    return Registration(initial, match, notes, functions, warnings)
