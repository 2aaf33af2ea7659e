"""What is told of a population, to people and to machines."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from abfm import Population
from abfm.errors import printable
from abfm.matching.judging.facts import finite


def facts(found: Population) -> dict[str, Any]:
    """Return all that is told, as plain numbers and texts; None for unknown numbers."""
    scores = [found.scores(c) for c in range(len(found.channels))]
    channels = []
    for c, channel in enumerate(found.channels):
        known = scores[c][found.fits]
        before, after = (_mean(each) for each in known.T)
        phase = found.phase_and_amplitude(c)._asdict()
        channels.append(
            {
                "name": channel.name,
                "held_out": channel.is_held_out,
                "weight": float(found.channel_weights[c]),
                **{name: finite(value) for name, value in phase.items()},
                "before": before,
                "after": after,
            }
        )
    subjects = [
        {
            "name": found.names[i],
            "fits": bool(found.fits[i]),
            "reason": found.reasons[i] or None,
            "verdict": found.verdicts[i] or None,
            "weight": float(found.weights[i]),
            **{
                name: finite(getattr(found, name)[i])
                for name in (
                    "correlation",
                    "distance",
                    "residual",
                    "displacement",
                    "log2_area",
                    "folded",
                    "landmarks",
                )
            },
            "scores": {
                channel.name: list(map(finite, scores[c][i]))
                for c, channel in enumerate(found.channels)
            },
            "digest": found.digests[i] or None,
        }
        for i in found.worst_first()
    ]
    return {
        "vertices": len(found.template.vertices),
        "faces": len(found.template.faces),
        "changes": list(map(finite, found.changes)),
        "log2_area_deviation": _mean(found.log2_area_deviation),
        "channels": channels,
        "subjects": subjects,
    }


def lines(population: Population, facts: Mapping[str, Any]) -> list[str]:
    """Return the same for people."""
    found = [population.headline]
    for each in facts["channels"]:
        parts = [
            f"correlation with the mean of the others {_told(each['before'])} before, "
            f"{_told(each['after'])} after"
        ]
        if each["total"]:
            share = each["phase"] / each["total"]
            parts.insert(0, f"{100 * share:.0f}% of the variance is position")
        held = ", held out" if each["held_out"] else ""
        found.append(f"{printable(each['name'])}{held}: {'; '.join(parts)}")
    found += [
        f"left out: {printable(each['name'])}: {each['reason']}"
        for each in facts["subjects"]
        if not each["fits"]
    ]
    return found


def _told(value: float | None) -> str:
    return "unknown" if value is None else f"{value:.3f}"


def _mean(values: Any) -> float | None:
    known = values[np.isfinite(values)]
    return float(known.mean()) if len(known) else None
