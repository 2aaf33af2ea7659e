"""Names of files to write, made from the document."""

import re

from abfm.mesh.files import MESH_ENDINGS
from abfm_viewer.document.document import Document
from abfm_viewer.files.contents import FRAME_ENDINGS, PROJECT, RESULT

_ENDINGS = re.compile(
    f"({'|'.join(map(re.escape, (*MESH_ENDINGS, *FRAME_ENDINGS, PROJECT, RESULT)))})$",
    re.IGNORECASE,
)
_LENGTH_MAX = 80


def suggested_name(document: Document, kind: str, suffix: str) -> str:
    """Return a file name for an export of a document, such as ``homer-match.png``.

    ``kind`` is a word for the content, such as "match"; if empty, the name has no such word.
    """
    words = [_ENDINGS.sub("", word) or word for word in document.name.split()]
    stem = re.sub(r"[^\w.-]+", "-", "-".join(words)).strip("-.")[:_LENGTH_MAX]
    parts = [stem] if not kind or stem == kind or stem.endswith(f"-{kind}") else [stem, kind]
    return "-".join(filter(None, parts)) + suffix
