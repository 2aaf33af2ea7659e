"""A report of the benchmark for readers."""

from __future__ import annotations

from typing import Any

from abfm.benchmark.machine import in_words


def format_report(report: dict[str, Any]) -> str:
    """The report of `run` as aligned lines of text."""
    rows = _rows(report)
    width = max(len(what) for what, _ in rows)
    return "\n".join([f"{what:<{width}}  {value}" for what, value in rows] + ["", _context(report)])


def markdown_table(report: dict[str, Any]) -> str:
    """The report of `run` as a table in Markdown, with the machine below it."""
    rows = [("measured", "value"), ("---", "---"), *_rows(report)]
    return "\n".join([f"| {what} | {value} |" for what, value in rows] + ["", _context(report)])


def _rows(report: dict[str, Any]) -> list[tuple[str, str]]:
    ratios, iterations, seconds = report["ratios"], report["iterations_to_mismatch"], report["seconds"]
    settings, lowest = report["settings"], report["lowest_energy"]
    limit, level = f"{settings['seconds']:g} s", f"{settings['mismatch_level']:g}"
    rows = [
        (
            f"paper's algorithm, {limit}: lowest energy (found after)",
            f"{_number(lowest['paper'])} ({_number(seconds['paper_until_its_lowest'])} s)",
        ),
        ("solver below that after", f"{_number(seconds['solver_below_paper'])} s"),
        (f"{limit} / solver's time", _number(ratios["paper_seconds_to_solver_seconds"])),
        (
            "time at which the paper's algorithm found it / solver's time",
            _number(ratios["paper_seconds_until_its_lowest_to_solver_seconds"]),
        ),
        (
            f"plain L-BFGS, exact gradient, {limit}: lowest energy (found after)",
            f"{_number(lowest['plain'])} ({_number(seconds['plain_until_its_lowest'])} s)",
        ),
        ("solver below that after", f"{_number(seconds['solver_below_plain'])} s"),
        (
            "time at which plain L-BFGS found it / solver's time",
            _number(ratios["plain_seconds_until_its_lowest_to_solver_seconds"]),
        ),
    ]
    for key, name in (("default_cooling", "default cooling"), ("constant_sigma", "constant sigma")):
        counts = ", ".join(f"{_number(count)} ({size})" for size, count in iterations[key].items())
        rows.append((f"iterations to mismatch {level}, {name} (vertices)", counts))
        rows.append(
            (f"the same, finest / coarsest mesh, {name}", _number(ratios["iterations_finest_to_coarsest"][key]))
        )
    for size, energies in report["energy_after_iterations"].items():
        values = ", ".join(f"{_number(energy)} ({count})" for count, energy in energies.items())
        rows.append((f"energy at {size} vertices after (iterations), constant sigma", values))
    for size, ratio in ratios["gradient_to_advection"].items():
        rows.append((f"energy and exact gradient / forward advection at {size} vertices", _number(ratio)))
    for row in report["bracket_gradient"]:
        what = f"cosine of bracket and exact gradient, n = {row['substeps']} (with the dropped factor)"
        rows.append((what, f"{row['cosine']:.3f} ({row['completed_cosine']:.3f})"))
    return rows


def _context(report: dict[str, Any]) -> str:
    return f"{in_words(report['machine'])}. Sphere of {report['settings']['vertices']} vertices unless said."


def _number(value: float | None) -> str:
    return "not reached" if value is None else f"{value:.3g}"
