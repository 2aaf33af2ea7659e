"""The Gaussians of a function: which there are, and the text with one of them changed."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Any

import numpy as np

from abfm import TriangleMesh
from abfm.functions import Spec, Sum, parse
from abfm.functions.gaussian import Gaussian


def gaussians(spec: str) -> list[Gaussian]:
    """The Gaussians among a function's terms, in their order.

    Raises
    ------
    FunctionError
        If the text is no spec.
    """
    return [term for term in _terms(parse(spec)) if isinstance(term, Gaussian)]


def changed(spec: str, bump: int, **values: Any) -> str:
    """The spec with other parameters of one Gaussian; a vertex takes the place of x, y and z."""
    if "vertex" in values:
        values |= {"vertex": (values["vertex"],), "x": None, "y": None, "z": None}
    gaussian = gaussians(spec)[bump]
    return _replaced(spec, bump, [_rebuilt(gaussian, values)])


def added(spec: str, mesh: TriangleMesh) -> str:
    """The spec with one more Gaussian, as wide as the last and as far as possible from all of them."""
    known = gaussians(spec)
    width = known[-1].width if known else 0.1
    centres = np.concatenate([gaussian.sources(mesh) for gaussian in known]) if known else np.array([0])
    gaps = np.min([np.linalg.norm(mesh.vertices - mesh.vertices[centre], axis=1) for centre in centres], axis=0)
    vertex = int(mesh.vertex_ids[int(np.argmax(gaps))])
    return str(Sum((*_terms(parse(spec)), Gaussian(vertex=(vertex,), width=width))))


def removed(spec: str, bump: int) -> str:
    """The spec without one Gaussian, unless nothing would be left."""
    return _replaced(spec, bump, []) if len(_terms(parse(spec))) > 1 else spec


def centre(gaussian: Gaussian, mesh: TriangleMesh) -> int:
    """The vertex it sits at, as the mesh file counts; of several the first.

    Raises
    ------
    FunctionError
        If the mesh has no such vertex.
    """
    return int(mesh.vertex_ids[gaussian.sources(mesh)[0]])


def _terms(tree: Spec) -> tuple[Spec, ...]:
    return tree.terms if isinstance(tree, Sum) else (tree,)


def _replaced(spec: str, bump: int, by: list[Spec]) -> str:
    """The text with the k-th Gaussian replaced by other terms."""
    terms: list[Spec] = []
    seen = 0
    for term in _terms(parse(spec)):
        is_bump = isinstance(term, Gaussian)
        terms += by if is_bump and seen == bump else [term]
        seen += is_bump
    return str(Sum(tuple(terms)) if len(terms) > 1 else terms[0])


def _rebuilt(gaussian: Gaussian, values: dict[str, Any]) -> Gaussian:
    return replace(gaussian, **{entry.name: values[entry.name] for entry in fields(gaussian) if entry.name in values})

