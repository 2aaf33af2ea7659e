"""Plot of the errors of velocities that were recovered from known waves, from a table of a page."""

from collections import defaultdict
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

METHODS = {  # colour, marker and line of each
    "Horn-Schunck": ("#8a8f98", "s", "--"),
    "abfm, frame by frame": ("#3b7dd8", "o", "-"),
    "abfm, all intervals together": ("#d1495b", "o", "-"),
}


def draw(page: Path, path: Path) -> None:
    """Plot the table ``waves`` of a page: means over the kinds of waves, one column per noise."""
    errors = _errors(page.read_text(encoding="utf-8"))
    noises, displacements = (sorted({key[i] for key in errors}) for i in (0, 1))
    figure = Figure(figsize=(10, 5.6), layout="constrained")
    plots = figure.subplots(2, len(noises), sharex=True, sharey="row")
    for column, noise in enumerate(noises):
        means = np.array([np.mean(errors[noise, d], axis=0) for d in displacements])
        for row, title in enumerate(("error of the angle (degrees)", "error of the speed (%)")):
            plot = plots[row, column]
            for number, (name, (color, marker, line)) in enumerate(METHODS.items()):
                values = means[:, 3 * row + number]
                plot.plot(displacements, values, line, color=color, marker=marker, label=name)
            plot.set_xscale("log", base=2)
            plot.set_xticks(displacements, [f"{d:g}" for d in displacements])
            plot.spines[["top", "right"]].set_visible(False)
            plot.grid(color="#e6e8ec")
            if column == 0:
                plot.set_ylabel(title)
        plots[0, column].set_title(f"{noise:g}% noise" if noise else "no noise")
        plots[1, column].set_xlabel("displacement (mean edges per frame)")
    for row in plots:  # plots in a row share their range
        row[0].set_ylim(bottom=0)
    plots[0, 0].legend(frameon=False, fontsize=9)
    figure.savefig(path, dpi=100)


def _errors(text: str) -> dict[tuple[float, float], list[list[float]]]:
    """Return the six errors of each wave, by noise (percent) and displacement (mean edges)."""
    table = text.partition("<!-- table: waves -->")[2].partition("<!-- end: waves -->")[0]
    errors = defaultdict(list)
    for line in table.strip().splitlines()[2:]:
        _, noise, displacement, *numbers = (cell.strip(" *°%") for cell in line.split("|")[1:-1])
        errors[float(noise), float(displacement)].append([float(number) for number in numbers])
    return errors
