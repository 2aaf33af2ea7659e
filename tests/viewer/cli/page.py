"""The content of a static page."""

import base64
import io
from html.parser import HTMLParser

import numpy as np
from PIL import Image


class Page(HTMLParser):
    """Parsed content of a static page: text, tags, links, names, pictures by title, and facts."""

    def __init__(self, text):
        super().__init__(convert_charrefs=True)
        self.open, self.text, self.facts = [], "", ""
        self.tags, self.links, self.ids, self.names, self.pictures = [], [], [], [], {}
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag, attributes):
        values = dict(attributes)
        self.tags.append(tag)
        self.ids.append(values.get("id"))
        if tag not in ("meta", "img"):
            self.open.append((tag, values.get("class")))
        if tag == "script":
            assert values == {"type": "application/json", "id": "facts"}
        self.links += [values[name] for name in ("src", "href", "action", "data") if name in values]
        if tag == "img":
            kind, _, data = values["src"].partition(",")
            assert kind == "data:image/png;base64"
            assert values["alt"] not in self.pictures
            with Image.open(io.BytesIO(base64.b64decode(data, validate=True))) as image:
                self.pictures[values["alt"]] = np.asarray(image.convert("RGB")).astype(float)

    def handle_endtag(self, tag):
        assert self.open.pop()[0] == tag

    def handle_data(self, data):
        where = {tag for tag, _ in self.open}
        if "script" in where:
            self.facts += data
        elif "style" in where:
            assert "url(" not in data
            assert "@import" not in data
        else:
            self.text += data
        if ("div", "name") in self.open:
            self.names.append(data)


def page_at(path):
    return Page(path.read_text(encoding="utf-8"))
