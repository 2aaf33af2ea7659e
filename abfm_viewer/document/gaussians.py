"""Gaussians in the spec (text) of a function, and specs with one Gaussian changed.

A Gaussian is a term of a sum. The sum may be scaled, smoothed or composed with a vertex map.
Gaussians are numbered from 0; ``bump`` is such a number.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np

from abfm import FunctionError, TriangleMesh, functions

_WIDTH = 0.1


def gaussians(spec: str) -> list[functions.Gaussian]:
    return [term for term in _terms(functions.parse(spec)) if isinstance(term, functions.Gaussian)]


def is_mapped(spec: str) -> bool:
    """Return whether a spec permutes the vertices, so that its Gaussians peak at other vertices."""
    parts = functions.functions_in(functions.parse(spec))
    return any(isinstance(part, functions.Permuted) for part in parts)


def changed(spec: str, bump: int, **values: Any) -> str:
    """Return a spec with changed values of Gaussian number ``bump``.

    A new value of ``vertex`` also replaces x, y and z. An invalid value raises a `FunctionError`.
    """
    if values.get("vertex") is not None:
        values |= {"x": None, "y": None, "z": None}
    return _with_bump(spec, bump, replace(gaussians(spec)[bump], **values))


def added(spec: str, mesh: TriangleMesh) -> str:
    """Return a spec with one more Gaussian, far from all others and as wide as the last one."""
    return _with_bump(spec, None, _farthest(gaussians(spec), mesh))


def landmark(specs: Iterable[str], mesh: TriangleMesh) -> str:
    """Return the spec of a Gaussian that is far from those in ``specs``, and as wide as the last.

    As source and target of a channel it fixes a place while the others move. Gaussians at vertices
    that the mesh does not have are ignored.
    """
    known = []
    for spec in specs:
        for one in gaussians(spec):
            with suppress(FunctionError):
                centre(one, mesh)
                known.append(one)
    return str(_farthest(known, mesh))


def _farthest(known: Sequence[functions.Gaussian], mesh: TriangleMesh) -> functions.Gaussian:
    width = known[-1].width if known else _WIDTH
    centres = np.concatenate([one.sources(mesh) for one in known]) if known else np.array([0])
    distances = [np.linalg.norm(mesh.vertices - mesh.vertices[one], axis=1) for one in centres]
    vertex = int(mesh.vertex_ids[int(np.argmax(np.min(distances, axis=0)))])
    return functions.Gaussian(vertex=(vertex,), width=width)


def removed(spec: str, bump: int) -> str:
    """Return a spec without Gaussian number ``bump``; a spec with a single term stays the same."""
    return _with_bump(spec, bump) if len(_terms(functions.parse(spec))) > 1 else spec


def centre(gaussian: functions.Gaussian, mesh: TriangleMesh) -> int:
    """Return the first centre of a Gaussian, as the number of a vertex in the mesh's file.

    If the mesh does not have this vertex, a `FunctionError` is raised.
    """
    return int(mesh.vertex_ids[gaussian.sources(mesh)[0]])


def _terms(tree: functions.Spec) -> tuple[functions.Spec, ...]:
    while isinstance(tree, functions.Wrapper):
        tree = tree.function
    return tree.terms if isinstance(tree, functions.Sum) else (tree,)


def _with_inner(tree: functions.Spec, inner: functions.Spec) -> functions.Spec:
    if isinstance(tree, functions.Wrapper):
        return replace(tree, function=_with_inner(tree.function, inner))
    return inner


def _with_bump(spec: str, bump: int | None, *by: functions.Spec) -> str:
    """Return a spec in which ``by`` replaces Gaussian number ``bump``, or is appended if None."""
    tree = functions.parse(spec)
    terms = list(_terms(tree))
    places = [i for i, term in enumerate(terms) if isinstance(term, functions.Gaussian)]
    place = len(terms) if bump is None else places[bump]
    terms[place : place + 1] = by
    inner = functions.Sum(tuple(terms)) if len(terms) > 1 else terms[0]
    return str(_with_inner(tree, inner))
