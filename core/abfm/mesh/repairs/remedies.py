"""Search for options with which a refused mesh can be used."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import product

from abfm.errors import MeshError, Remedy
from abfm.mesh.draft import Draft
from abfm.mesh.options import MeshOptions
from abfm.reading import HEMISPHERES

FACES_MAX = 1_000_000
"""Number of faces above which no options are tried, because that takes too long."""
Attempt = Callable[[MeshOptions], Draft]


class DefectError(MeshError):
    """A defect of a mesh, with advice that is given if no loading option helps."""

    def __init__(self, problem: str, advice: str) -> None:
        super().__init__(f"{problem}. {advice}")
        self.problem = problem


def with_remedies(
    defect: DefectError,
    options: MeshOptions,
    attempt: Attempt,
    can_merge: bool,
    merging_joins: bool,
) -> MeshError:
    """Return an error about a defect, which advises options with which the mesh can be used.

    ``attempt`` loads the mesh with other options. If none help, the error has the usual advice.
    ``can_merge`` is True if vertices share a position, ``merging_joins`` if merging them joins
    components.
    """
    last = ""
    for group in _candidates(options, can_merge, merging_joins):
        works = []
        for each in group:
            try:
                works.append((each, attempt(each)))
            except MeshError as error:
                is_other = not isinstance(error, DefectError) or error.problem != defect.problem
                last = f". With {each.arguments}: {error}" if is_other else ""
        if group[0].hemisphere != options.hemisphere:
            works *= len(works) == len(group)
        elif works:
            works = [max(works, key=lambda pair: len(pair[1].faces))]
        if works:
            return _advised(defect.problem, works)
    return MeshError(f"{defect.problem}{last}" if last else str(defect))


def _candidates(
    options: MeshOptions, can_merge: bool, merging_joins: bool
) -> Iterator[list[MeshOptions]]:
    """Yield groups of options to try; the first group that works is advised.

    A group of two hemispheres works if both can be loaded. In other groups one must work, and the
    option that keeps most faces is advised. Merging comes first because it also closes seams.
    """
    merges = [replace(options, merge=True)] * can_merge + [options] * (not merging_joins)
    cleans = [] if options.clean else [replace(each, clean=True) for each in merges]
    yield from ([each] for each in [*merges, *cleans] if each != options)
    if not (options.hemisphere or options.largest_component):
        for largest, each in product((False, True), [*merges, *cleans]):
            sides = (replace(each, hemisphere=side) for side in HEMISPHERES)
            yield [replace(side, largest_component=largest) for side in sides]
    for group in filter(None, (merges, cleans)):
        yield [replace(each, largest_component=True) for each in group]


def _advised(problem: str, works: list[tuple[MeshOptions, Draft]]) -> MeshError:
    advice = " or ".join(
        f"{options.arguments} (keeps {draft.kept_counts})" for options, draft in works
    )
    error = MeshError(f"{problem}. Use {advice}; in Python: {works[0][0].keywords}")
    error.problem = problem
    error.remedies = tuple(
        Remedy(options.changed, options.button, draft.kept_counts) for options, draft in works
    )
    return error
