"""The table of the attack, for the terminal and for the page docs/promises.md, where it adds up
over all runs.
"""

import json

from tests.attack.trial import Tally
from tests.processes import ROOT

PAGE, TOTALS = ROOT / "docs" / "promises.md", ROOT / "docs" / "attack.json"
BEGIN, END = "<!-- table of ./run attack -->", "<!-- end of the table -->"
_HEADS = (
    *("part", "trials", "as promised", "refused in one line", "faults", "longest (s)"),
    "most memory (MB)",
)


def _row(tally):
    counts = [f"{count:,}" for count in (tally.trials, tally.ok, tally.refused, tally.fault_count)]
    measured = [
        f"{number:.2g}" if 0 < number < 10 else f"{number:.0f}"
        for number in (tally.seconds, tally.megabytes)
    ]
    return [tally.part.replace("_", " "), *counts, *("" if n == "0" else n for n in measured)]


def text_table(tallies):
    """Lines for the terminal, the faults below."""
    rows = [_HEADS, *map(_row, tallies.values())]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = [
        "  ".join(cell.rjust(width) for cell, width in zip(row, widths, strict=True))
        for row in rows
    ]
    for tally in tallies.values():
        lines += [f"{command}\n    {detail}" for command, detail in tally.faults]
        if tally.fault_count > len(tally.faults):
            lines.append(f"... and {tally.fault_count - len(tally.faults)} more of {tally.part}")
    return "\n".join(lines)


def write(tallies):
    """Add the numbers to those of earlier runs, and write the page's table anew."""
    known = json.loads(TOTALS.read_text(encoding="utf-8")) if TOTALS.exists() else {}
    totals = {part: Tally(part, **numbers) for part, numbers in known.items()}
    for part, tally in tallies.items():
        total = totals.setdefault(part, Tally(part))
        for count in ("ok", "refused", "fault_count"):
            setattr(total, count, getattr(total, count) + getattr(tally, count))
        for worst in ("seconds", "megabytes"):
            setattr(total, worst, max(getattr(total, worst), getattr(tally, worst)))
        found = [(command, detail.replace(f"{ROOT}/", "")) for command, detail in tally.faults]
        total.faults = list(dict.fromkeys([*map(tuple, total.faults), *found]))
    plain = {
        part: {name: value for name, value in vars(total).items() if name != "part"}
        for part, total in totals.items()
    }
    TOTALS.write_text(json.dumps(plain, indent=1) + "\n", encoding="utf-8")
    before, _, rest = PAGE.read_text(encoding="utf-8").partition(BEGIN)
    _, _, after = rest.partition(END)
    PAGE.write_text(f"{before}{BEGIN}\n\n{_markdown(totals)}\n\n{END}{after}", encoding="utf-8")


def _markdown(totals):
    """The table, and the faults that were found on the way."""
    rows = [_HEADS, ["---"] * len(_HEADS), *map(_row, totals.values())]
    lines = ["| " + " | ".join(row) + " |" for row in rows]
    faults = [fault for total in totals.values() for fault in total.faults]
    if faults:
        lines += ["", "What was found on the way:", ""]
        lines += [f"- `{command}`: {detail[:150]}" for command, detail in faults]
    return "\n".join(lines)
