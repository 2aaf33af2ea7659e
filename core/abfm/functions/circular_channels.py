"""Conversion of circular functions to two channels each, cosine and sine."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from abfm.errors import FunctionError, brief
from abfm.functions.circular import Circular, as_circle, checked_period
from abfm.functions.family import texts_of
from abfm.functions.spec import parse


def without_circle(text: str) -> str:
    """Return the text inside ``circular:(...)``; return other texts unchanged."""
    tree = parse(text)
    return str(tree.function) if isinstance(tree, Circular) else text


def split_channels(
    sources: Sequence[str],
    targets: Sequence[str],
    weights: Sequence[float],
    period: float | None = None,
) -> tuple[list[str], list[str], list[float]]:
    """Replace each circular channel by its cosine and sine, two channels of the same weight.

    With a ``period``, all functions become circular. Raises FunctionError if only one of a source
    and its target is circular.
    """
    found: tuple[list[str], list[str], list[float]] = ([], [], [])
    for *pair, weight in zip(sources, targets, weights, strict=True):
        parts = [_parts(text, period) for text in pair]
        if len(parts[0]) != len(parts[1]):
            raise FunctionError(
                f"only one of {brief(pair[0])} and {brief(pair[1])} is circular; expected both "
                "or none"
            )
        found[0].extend(parts[0])
        found[1].extend(parts[1])
        found[2].extend([weight] * len(parts[0]))
    return found


def _parts(text: str, period: float | None) -> list[str]:
    if not text and period is None:
        return [text]
    tree = parse(text)
    if period is not None and not isinstance(tree, Circular):
        tree = Circular(period=period, function=tree)
    return [*map(str, tree.parts)] if isinstance(tree, Circular) else [text]


def circular_channels(f: Any, g: Any, weights: Any, circular: object) -> tuple[Any, Any, Any]:
    """Return the functions f, g and weights of a problem, with two channels for each circular one.

    Arrays (V,) or (V, C) and texts are circular if ``circular`` is True or a period. Texts may also
    be of the family ``circular``.
    """
    period, (sources, targets) = checked_period(circular), map(texts_of, (f, g))
    if sources is not None and targets is not None and len(sources) == len(targets):
        counts = np.ones(len(sources)) if weights is None else np.asarray(weights)
        if counts.shape == (len(sources),):
            found = split_channels(sources, targets, counts.tolist(), period)
            return found if len(found[0]) > len(counts) else (f, g, weights)
    if period is None or f is None or g is None:
        return f, g, weights
    on_source, on_target = (as_circle(values, period) for values in (f, g))
    return on_source, on_target, None if weights is None else np.repeat(weights, 2)
