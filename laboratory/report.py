"""A report of the benchmark for readers."""

from typing import Any

from laboratory.machine import in_words
from laboratory.tables import aligned, markdown, number


def format_report(report: dict[str, Any]) -> str:
    """Return the report of `run` as aligned lines of text."""
    return "\n".join([*aligned(_rows(report)), "", _context(report)])


def markdown_table(report: dict[str, Any]) -> str:
    """Return the report of `run` as a table in Markdown, with the machine below it."""
    return "\n".join([*markdown([("measured", "value"), *_rows(report)]), "", _context(report)])


def _rows(report: dict[str, Any]) -> list[tuple[str, str]]:
    ratios, settings, seconds = report["ratios"], report["settings"], report["seconds"]
    limit, level = f"{settings['seconds']:g} s", f"{settings['mismatch_level']:g}"

    def lowest(key: str) -> str:
        return (
            f"{number(report['lowest_energy'][key])} "
            f"({number(seconds[f'{key}_until_its_lowest'])} s)"
        )

    def ratio(key: str) -> str:
        return number(ratios[f"{key}_to_solver_seconds"])

    rows = [
        (f"paper's algorithm, {limit}: lowest energy (found after)", lowest("paper")),
        ("solver below that after", f"{number(seconds['solver_below_paper'])} s"),
        (f"{limit} / solver's time", ratio("paper_seconds")),
        (
            "time at which the paper's algorithm found it / solver's time",
            ratio("paper_seconds_until_its_lowest"),
        ),
        (f"plain L-BFGS, exact gradient, {limit}: lowest energy (found after)", lowest("plain")),
        ("solver below that after", f"{number(seconds['solver_below_plain'])} s"),
        (
            "time at which plain L-BFGS found it / solver's time",
            ratio("plain_seconds_until_its_lowest"),
        ),
    ]
    for key, finest_to_coarsest in ratios["iterations_finest_to_coarsest"].items():
        name, iterations = key.replace("_", " "), report["iterations_to_mismatch"][key]
        rows += [
            (f"iterations to mismatch {level}, {name} (vertices)", _each(iterations)),
            (f"the same, finest / coarsest mesh, {name}", number(finest_to_coarsest)),
        ]
    for size, energies in report["energy_after_iterations"].items():
        rows.append(
            (f"energy at {size} vertices after (iterations), constant sigma", _each(energies))
        )
    for size, cost in ratios["gradient_to_advection"].items():
        rows.append(
            (f"energy and exact gradient / forward advection at {size} vertices", number(cost))
        )
    for row in report["bracket_gradient"]:
        what = (
            f"cosine of bracket and exact gradient, n = {row['substeps']} (with the dropped factor)"
        )
        rows.append((what, f"{row['cosine']:.3f} ({row['completed_cosine']:.3f})"))
    return rows


def _each(values: dict[str, float | None]) -> str:
    return ", ".join(f"{number(value)} ({key})" for key, value in values.items())


def _context(report: dict[str, Any]) -> str:
    return (
        f"{in_words(report['machine'])}. Sphere of {report['settings']['vertices']} vertices "
        "unless said."
    )
