import pytest

from abfm_viewer.document.document import Surface
from abfm_viewer.document.kinds import MatchDocument, PairDocument
from abfm_viewer.files.names import suggested_name
from tests.shapes import icosphere

BALL = icosphere(0)


@pytest.mark.parametrize(
    ("names", "kind", "expected"),
    [
        (["homer.off"], "match", "homer-match.png"),
        (["homer-match.npz"], "match", "homer-match.png"),
        (["lh.pial.surf.gii"], "", "lh.pial.surf.png"),
        (["lh.pial"], "picture", "lh.pial-picture.png"),
        (["a man.obj", "B of reg.npz"], "match", "a-man-to-B-of-reg-match.png"),
        (["x/y: *.ply"], "match", "x-y-match.png"),
        ([".off"], "match", "off-match.png"),
        (["é" * 200], "", "é" * 80 + ".png"),
    ],
)
def test_names_of_exports_come_from_the_document(names, kind, expected):
    surfaces = tuple(Surface(BALL, name) for name in names)
    kinds = {1: MatchDocument, 2: PairDocument}
    assert suggested_name(kinds[len(names)](surfaces), kind, ".png") == expected
