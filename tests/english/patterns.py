"""Patterns of private English, each with a remedy: what to write instead."""

import re
from collections.abc import Iterator
from dataclasses import dataclass

WORDS_PER_SENTENCE_MAX = 25


@dataclass(frozen=True)
class Pattern:
    """A pattern that prose must not contain, and its remedy, the words to write instead."""

    name: str
    regex: re.Pattern[str]
    remedy: str


def _pattern(name: str, regex: str, remedy: str) -> Pattern:
    return Pattern(name, re.compile(regex, re.IGNORECASE), remedy)


PATTERNS = (
    _pattern("tell", r"\b(tell|tells|told|telling)\b", "report, log, show, warn"),
    _pattern("say", r"\b(say|says|said|saying)\b", "report, print, state, mean"),
    _pattern("ask", r"\b(ask|asks|asked|asking)\b", "request, query, prompt"),
    _pattern("hear", r"\b(hear|hears|heard)\b", "receive"),
    _pattern(
        "headless clause",
        r"\b(what|who) (is|was|are|were|it|they|comes?|came|goes|has|had|have|does|no)\b"
        r"(?![^.]*\?)",
        "name the thing",
    ),
    _pattern("that which", r"\b(that which|those that are|that what)\b", "name the thing"),
    _pattern("too at the end", r", too\b", "also, before the verb"),
    _pattern(
        "is no", r"(?<!there )\b(is|are|was) no (?!longer\b|more\b|less\b|other\b)", "is not a"
    ),
    _pattern("but for", r"\bbut for\b", "except"),
    _pattern("witness", r"\bwitness(es)?\b", "check"),
    _pattern("course", r"(?<!of )\bcourses?\b", "continuation, schedule"),
    _pattern("film", r"\bfilms?\b", "sequence, frames, interval"),
    _pattern("bear out", r"\b(bears?|borne|bore) (it )?out\b", "verify, agree"),
    _pattern("come to", r"\b(come|comes|came|coming) (out|close|to)\b", "result, converge, reach"),
    _pattern("go on", r"\b(go|goes|going|went|gone) on\b", "resume, continue"),
    _pattern("mend", r"\bmend(s|ed|ing)?\b", "fix"),
    _pattern("needle", r"\bneedles?\b", "thin triangle, sliver"),
    _pattern("doubt", r"\b(doubts?|doubted|believed?|believes)\b", "warning, consistent"),
    _pattern("again and again", r"\bagain and again\b", "iteratively"),
    _pattern("hang on", r"\bhangs? on\b", "depend on"),
    _pattern("odd subject", r"\bodd subjects?\b", "outlier"),
    _pattern("carry", r"\b(carry|carries|carried|carrying)\b", "transfer, advect, push forward"),
    _pattern("beside", r"\bbeside\b", "next to, compared with"),
    _pattern("at home", r"\bat home\b", "in the user's directory"),
    _pattern("room", r"\b(rooms?|houses?|doors?)\b", "package, project, input, space"),
    _pattern(
        "is left",
        r"\b(is|are|was|were|be|nothing|all|%|X) left\b"
        r"(?! (and|or|of the|hemisphere|out|alone|open|unchanged|empty))",
        "residual",
    ),
    _pattern("way to", r"\b(ways? to|ways? of|way down)\b", "method, option"),
    _pattern("whole number", r"\bwhole numbers?\b", "integer"),
    _pattern("leading zero", r"(?<![\w.\])}:`/])\.\d", "write 0.5"),
)
HEADLESS_SUMMARY = re.compile(r"(What|Who|Whom|Where|How|Which|That|Those)\b(?![^.]*\?)")


def violations(words: str) -> Iterator[tuple[str, str, str]]:
    """Yield the name of each pattern that a text contains, an excerpt, and the remedy."""
    for pattern in PATTERNS:
        for match in pattern.regex.finditer(words):
            yield pattern.name, words[max(0, match.start() - 30) : match.end() + 30], pattern.remedy
    for sentence in sentences(words):
        count = len(re.findall(r"\w[\w'.,/+-]*", sentence))
        if count > WORDS_PER_SENTENCE_MAX:
            yield "long sentence", f"{count} words: {sentence[:60]}...", "split it"


def sentences(words: str) -> list[str]:
    return re.split(r"(?<=[.!?])[\"')\]]*\s+(?=[A-Z\"'`(\[])", words)
