"""The page with all figures."""

from __future__ import annotations

import base64
import re
from html.parser import HTMLParser

from PIL import Image

from abfm.experiments import Measure
from abfm.parameters import TABLE_1
from abfm_viewer.cli.figure import Entry, page

_VOID = {"meta", "img"}


class Balanced(HTMLParser):
    """Checks that every tag is closed, and collects text and links."""

    def __init__(self, text):
        super().__init__()
        self.open, self.text, self.links, self.ids = [], "", [], []
        self.feed(text)
        assert self.open == []

    def handle_starttag(self, tag, attributes):
        if tag not in _VOID:
            self.open.append(tag)
        named = dict(attributes)
        self.ids.append(named.get("id"))
        self.links += [named[name] for name in ("src", "href") if name in named]

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text += data


def test_the_page_has_everything_and_needs_nothing_else():
    entries = [
        Entry(
            1,
            "two & more",
            "f < g",
            "a <sphere>",
            (Measure("mismatch", 0.0123, "small", True, 0.05), Measure("drift", 0.5)),
            Image.new("RGB", (4, 3), "red"),
        ),
        Entry(
            9,
            "a symmetry",
            "it works",
            problem="Not on this mesh: no symmetry",
            notes=("beyond <colours>",),
        ),
    ]
    parsed = Balanced(page(entries))
    for text in (
        "two & more",
        "f < g",
        "a <sphere>",
        "0.0123",
        "0.05 yes",
        "drift",
        "Not on this mesh: no symmetry",
        "beyond <colours>",
    ):
        assert text in parsed.text
    assert all(link.startswith(("data:image/png;base64,", "#")) for link in parsed.links)
    assert {link[1:] for link in parsed.links if link.startswith("#")} <= set(parsed.ids)
    [picture] = [link for link in parsed.links if link.startswith("data:")]
    assert base64.b64decode(picture.partition(",")[2]).startswith(b"\x89PNG")


def test_what_fails_and_what_does_not_reproduce_is_said():
    failing = Measure("mismatch", 0.2, "matches", False, 0.05)
    text = page([Entry(3, "t", "c", measures=(failing,))])
    assert re.search(r"0\.05 <span class=\"bad\">no</span>", text)
    assert text.count('class="bad">no') == 2


def test_table_1_has_all_rows():
    text = Balanced(page([])).text
    assert all(f"Figure {row.figure}" in text for row in TABLE_1.values())
