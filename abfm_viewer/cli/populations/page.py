"""The page of a population: its mean and how it varies, and its subjects, the worst first."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

from abfm.wording import number_text, percents
from abfm_viewer.cli.reports.report_page import (
    document,
    facts_block,
    numbers_list,
    pictures_row,
    rows_table,
    sentence,
    table,
)

if TYPE_CHECKING:
    from abfm_viewer.pictures.population_pictures import PopulationPictures

Facts = Mapping[str, Any]
_STYLE = """
.wide { overflow-x: auto; }
table.subjects { width: 100%; }
table.subjects td { padding: .35rem 0 .35rem 1rem; white-space: nowrap; }
table.subjects td:first-child {
  width: 40%; min-width: 14rem; white-space: normal; overflow-wrap: anywhere; padding-left: 0;
}
table.subjects th { vertical-align: bottom; }
.name { font-weight: 600; } .reason { font-size: .87rem; }
tr.odd td, tr.odd .reason { color: var(--bad); }
"""


def page(facts: Facts, pictures: PopulationPictures | None) -> str:
    """Return the page of facts, with pictures where there are any."""
    title = f"Population of {facts['table']}"
    parts = [
        f"<h1>{escape(title)}</h1>",
        f'<p class="muted">{escape(_about(facts))}</p>',
        _summary(facts),
        _numbers(facts),
        _subjects(facts),
        _channels(facts, pictures),
        _areas(facts, pictures),
        _misfits(facts, pictures),
        f"<footer>abfm {escape(version('abfm'))}</footer>",
        facts_block(facts),
    ]
    return document(title, parts, _STYLE)


def _about(facts: Facts) -> str:
    return (
        f"{len(facts['subjects'])} subjects on {facts['template']}, {facts['vertices']:,} vertices "
        f"and {facts['faces']:,} faces"
    )


def _summary(facts: Facts) -> str:
    odd = [each for each in facts["subjects"] if not each["fits"]]
    rest, rounds = facts["changes"][-1] <= facts["bound"], len(facts["changes"])
    word = "The mean has come to rest" if rest else "The mean still changes"
    more = "" if rest else " The same command with more <code>--rounds</code> goes on from here."
    why = (
        f"<p>It changed by {facts['changes'][-1]:.2g} of its deviation over the surface in the "
        f"last of {rounds} rounds, where {facts['bound']:g} was asked for.{more}</p>"
    )
    left = "".join(
        f"<li><b>{escape(each['name'])}</b>: {escape(each['reason'] or '')}.</li>" for each in odd
    )
    told_odd = f'<p>Left out of it:</p><ul class="warnings">{left}</ul>' if odd else ""
    tone = "good" if rest and not odd else "ink"
    return f'<div class="verdict {tone}"><strong>{word}</strong>{why}{told_odd}</div>'


def _numbers(facts: Facts) -> str:
    fitting = sum(each["fits"] for each in facts["subjects"])
    cells = [("subjects that fit", f"{fitting} of {len(facts['subjects'])}", "plain")]
    for each in facts["channels"]:
        scores = _both((each["before"], each["after"]))
        cells.append((f"{_channel_name(each)}: like the others", scores, "plain"))
    cells.append(("areas: deviation of log2 J", _number(facts["log2_area_deviation"]), "plain"))
    return numbers_list(cells)


def _subjects(facts: Facts) -> str:
    held = [each["name"] for each in facts["channels"] if each["held_out"]]
    has_landmarks = any(each["landmarks"] is not None for each in facts["subjects"])
    heads = (
        "",
        "like the others",
        "distance",
        "left",
        "moved",
        "|log2\u00a0J|",
        "folded",
        *(["landmarks"] if has_landmarks else []),
        *(f"{name}, held out" for name in held),
    )
    lines = []
    for each in facts["subjects"]:
        words = f'<div class="name">{escape(each["name"])}</div>'
        verdict = sentence(each["verdict"] or "failed")
        weight = "" if each["weight"] == 1 else f", weight {each['weight']:g}"
        reason = f"; left out: {escape(each['reason'])}" if each["reason"] else ""
        words += f'<div class="reason">{verdict}{weight}{reason}</div>'
        numbers = [_number(each[name]) for name in ("correlation", "distance", "residual")]
        numbers += [_number(each["displacement"]), _number(each["log2_area"])]
        numbers += [percents(each["folded"])]
        numbers += [_number(each["landmarks"])] if has_landmarks else []
        numbers += [_both(each["scores"][name]) for name in held]
        cells = "".join(f"<td>{escape(cell)}</td>" for cell in numbers)
        mark = "" if each["fits"] else ' class="odd"'
        lines.append(f"<tr{mark}><td>{words}</td>{cells}</tr>")
    text = (
        "Who does not fit first, then those that are least like the others: their correlation with "
        "the mean of the others that fit, and how far they are from it, over its deviation. Left "
        "is the residual of the registration; moved how far the flow moves the subject, of √area; "
        "|log2 J| how much it changes areas; "
        + ("landmarks how far these are left on average, of √area; " if has_landmarks else "")
        + "of channels that are held out, the correlation before and after."
    )
    found = table(heads, lines, "subjects")
    return f'<h2>Subjects</h2><p>{text}</p><div class="wide">{found}</div>'


def _channels(facts: Facts, pictures: PopulationPictures | None) -> str:
    heads = ("", "variance", "position", "value", "C_R", "like the others, before", "after")
    rows = []
    for each in facts["channels"]:
        total = each["total"]
        parts = (_part(each[name], total) for name in ("phase", "amplitude"))
        numbers = (_number(each[name]) for name in ("factor", "before", "after"))
        rows.append((_channel_name(each), number_text(total, ".3g"), *parts, *numbers))
    text = (
        "The variance over subjects, per area, is position, which registering removes, and value, "
        "which it leaves, as Kneip and Ramsay (2008) part them; C_R is how much larger squares are "
        "before than after. Noise is value, as far as it is not smoothed between vertices."
    )
    drawn = "".join(
        f"<section><h3>{escape(row.title)}</h3>{pictures_row(row)}</section>"
        for row in (pictures.channels if pictures else ())
    )
    return f"<h2>Channels</h2><p>{text}</p>{rows_table(heads, rows)}{drawn}"


def _areas(facts: Facts, pictures: PopulationPictures | None) -> str:
    text = (
        "J is the area of a face where it lies on a subject over its own, both surfaces scaled to "
        "one area: the mean over subjects of its logarithm, and the deviation, which is "
        f"{_number(facts['log2_area_deviation'])} on average."
    )
    drawn = "" if pictures is None else pictures_row(pictures.areas)
    return f"<section><h2>Areas</h2><p>{text}</p>{drawn}</section>"


def _misfits(facts: Facts, pictures: PopulationPictures | None) -> str:
    if pictures is None or not pictures.misfits:
        return ""
    reasons = {each["name"]: each["reason"] for each in facts["subjects"]}
    sections = "".join(
        f"<section><h3>{escape(row.title)}</h3><p>{sentence(reasons[row.title] or '')}.</p>"
        f"{pictures_row(row)}</section>"
        for row in pictures.misfits
    )
    return f"<h2>Who does not fit</h2>{sections}"


def _channel_name(facts: Facts) -> str:
    if facts["held_out"]:
        return f"{facts['name']}, held out"
    return facts["name"] if facts["weight"] == 1 else f"{facts['name']}, weight {facts['weight']:g}"


def _both(ends: Sequence[float | None]) -> str:
    """Return what is before and after, or that neither is known."""
    return " → ".join(map(_number, ends)) if any(end is not None for end in ends) else "-"


def _part(variance: float | None, total: float | None) -> str:
    """Return a part of a variance, which has the channel's unit, and its share."""
    share = f" ({100 * variance / total:.0f}%)" if variance is not None and total else ""
    return f"{number_text(variance, '.3g')}{share}"


def _number(value: float | None) -> str:
    return number_text(value, "z.3f")
