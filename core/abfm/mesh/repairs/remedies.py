"""Options with which a mesh that was refused can be used: they are tried."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import product

from abfm.errors import MeshError, Remedy
from abfm.mesh.draft import Draft
from abfm.mesh.options import MeshOptions
from abfm.reading import HEMISPHERES

FACES_MAX = 1_000_000
"""Of larger meshes no options are tried, as that takes long."""
Attempt = Callable[[MeshOptions], Draft]


class DefectError(MeshError):
    """What is wrong with a mesh, and what to do if no option helps."""

    def __init__(self, problem: str, advice: str) -> None:
        super().__init__(f"{problem}: {advice}")
        self.problem = problem


def with_remedies(
    defect: DefectError, options: MeshOptions, attempt: Attempt, can_merge: bool, joins: bool
) -> MeshError:
    """Return the error that names options with which the mesh can be used, or what is wrong with
    all of them. They merge vertices if that ``joins`` components.
    """
    last = ""
    for group in _candidates(options, can_merge, joins):
        works = []
        for each in group:
            try:
                works.append((each, attempt(each)))
            except MeshError as error:
                is_other = not isinstance(error, DefectError) or error.problem != defect.problem
                last = f"; with {each.words}, {error}" if is_other else ""
        if group[0].hemisphere != options.hemisphere:
            works *= len(works) == len(group)
        elif works:
            works = [max(works, key=lambda pair: len(pair[1].faces))]
        if works:
            return _advised(defect.problem, works)
    return MeshError(f"{defect.problem}{last}" if last else str(defect))


def _candidates(options: MeshOptions, can_merge: bool, joins: bool) -> Iterator[list[MeshOptions]]:
    """Yield options, those of a group together: of the first group that works the one that keeps
    most faces is advised, or both hemispheres if both work.

    Merging comes first, as it also joins the sides of seams that leave a surface connected.
    """
    merges = [replace(options, merge=True)] * can_merge + [options] * (not joins)
    cleans = [] if options.clean else [replace(each, clean=True) for each in merges]
    yield from ([each] for each in [*merges, *cleans] if each != options)
    if not (options.hemisphere or options.largest_component):
        for largest, each in product((False, True), [*merges, *cleans]):
            sides = (replace(each, hemisphere=side) for side in HEMISPHERES)
            yield [replace(side, largest_component=largest) for side in sides]
    for group in filter(None, (merges, cleans)):
        yield [replace(each, largest_component=True) for each in group]


def _advised(problem: str, works: list[tuple[MeshOptions, Draft]]) -> MeshError:
    words = " or ".join(f"{options.words} (keeps {draft.kept})" for options, draft in works)
    error = MeshError(f"{problem}: use {words}; in Python: {works[0][0].keywords}")
    error.problem = problem
    error.remedies = tuple(
        Remedy(options.given, options.button, draft.kept) for options, draft in works
    )
    return error
