"""Report of a population: numbers for programs and lines for people."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from abfm.errors import printable
from abfm.io import export_vtu, write_csv, write_values
from abfm.matching.judging.facts import finite
from abfm.population.population import Population

_MEASURES = (
    *("correlation", "distance", "residual", "displacement", "log2_area", "folded", "landmarks"),
)


def details(found: Population) -> dict[str, Any]:
    """Return the report of a population as plain numbers and texts; None for unknown values."""
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
            **{name: finite(getattr(found, name)[i]) for name in _MEASURES},
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
        "bound": finite(found.bound),
        "changes": list(map(finite, found.changes)),
        "log2_area_deviation": _mean(found.log2_area_deviation),
        "channels": channels,
        "subjects": subjects,
    }


def lines(population: Population) -> list[str]:
    facts = details(population)
    found = [population.headline]
    for each in facts["channels"]:
        parts = [
            f"correlation with the mean of the other subjects {_score_text(each['before'])} before "
            f"registration, {_score_text(each['after'])} after"
        ]
        if each["total"]:
            share = each["phase"] / each["total"]
            parts.insert(0, f"{100 * share:.0f}% of its variance is variation of position (phase)")
        held_out = ", held out" if each["held_out"] else ""
        found.append(f"{printable(each['name'])}{held_out}: {'; '.join(parts)}")
    found += [
        f"excluded: {printable(each['name'])}: {each['reason']}"
        for each in facts["subjects"]
        if not each["fits"]
    ]
    return found


def _score_text(value: float | None) -> str:
    return "unknown" if value is None else f"{value:.3f}"


def _mean(values: Any) -> float | None:
    known = values[np.isfinite(values)]
    return float(known.mean()) if len(known) else None


def export_mean_vtu(path: Path, found: Population) -> None:
    """Write the template with means and standard deviations of all channels and of log2 J."""
    export_vtu(path, found.template, *_arrays(found))


def export_mean_values(path: Path, found: Population) -> None:
    """Write means and standard deviations of channels at the vertices of the template's file."""
    on_vertices, _ = _arrays(found)
    values = found.template.on_file(np.stack(list(on_vertices.values()), axis=1))
    write_values(path, values, found.template.structure, list(on_vertices))


def export_subjects(path: Path, found: Population) -> None:
    write_csv(path, _table(details(found)))


def _arrays(found: Population) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the exported arrays by name: those at vertices, (V,), and those at faces, (F,)."""
    on_vertices: dict[str, Any] = {}
    for c, channel in enumerate(found.channels):
        name = re.sub(r"[^A-Za-z0-9_.-]", "_", channel.name)
        if f"mean_{name}" in on_vertices:
            name = f"{name}_{c}"
        on_vertices[f"mean_{name}"] = found.mean(c)
        on_vertices[f"deviation_{name}"] = found.deviation(c)
        on_vertices[f"plain_mean_{name}"] = found.plain_mean(c)
    on_faces = {
        "log2_area_mean": found.log2_area_mean,
        "log2_area_deviation": found.log2_area_deviation,
    }
    return on_vertices, on_faces


def _table(facts: Mapping[str, Any]) -> list[list[Any]]:
    names = [each["name"] for each in facts["channels"]]
    columns = [name for name in facts["subjects"][0] if name != "scores"]
    ends = ("before", "after")
    rows = [[*columns, *(f"{name} {end}" for name in names for end in ends)]]
    for subject in facts["subjects"]:
        scores = [value for name in names for value in subject["scores"][name]]
        rows.append([*(subject[name] for name in columns), *scores])
    return rows
