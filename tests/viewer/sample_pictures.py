"""The thumbnails of the menu Samples, drawn into one image that is shipped with the app.

    python -m tests.viewer.sample_pictures

Run this program when a figure or a bundled mesh is added or removed.
"""

from __future__ import annotations

import json
from dataclasses import replace

from PIL import Image

from abfm import load_mesh
from abfm.assets import asset_path
from abfm.pages.front import front_of
from abfm.parameters import FIGURES
from abfm.types import FloatArray
from abfm_viewer.appearance.samples import COLUMNS, CORTEX, MESHES, PICTURES, SIDE, TABLE, WAVE
from abfm_viewer.computing.defaults import default_functions
from abfm_viewer.document.document import Channel, Document, Surface, View
from abfm_viewer.document.kinds import MatchDocument
from abfm_viewer.pictures.document_pictures import DocumentRenderer, PictureOptions
from abfm_viewer.window.samples import cortex_document, figure_document
from abfm_viewer.window.wave import wave_document

_VIEW = View(layout="advected only", color_bar=False)
_SUPERSAMPLING = 2  # keeps thin limbs smooth


def draw_all() -> None:
    """Write the pictures, transparent around the surfaces, and the table of vertices."""
    documents: dict[str, tuple[Document, dict[str, FloatArray]]] = {
        name: _mesh_document(name) for name in MESHES
    }
    documents |= {f"Figure {figure}": figure_document(figure, _VIEW) for figure in FIGURES}
    documents[CORTEX] = cortex_document(_VIEW)
    documents[WAVE] = wave_document(_VIEW), {}
    rows = -(-len(documents) // COLUMNS)
    sheet = Image.new("RGBA", (COLUMNS * SIDE, rows * SIDE))
    for number, (document, known) in enumerate(documents.values()):
        plain = replace(document, view=_VIEW, time=0.0, lines=(), points=())
        options = PictureOptions(labels=False, color_bar=False, background="transparent")
        with DocumentRenderer(
            plain, known, (_SUPERSAMPLING * SIDE, _SUPERSAMPLING * SIDE), options
        ) as pictures:
            picture = (
                pictures.picture(0.0).convert("RGBA").resize((SIDE, SIDE), Image.Resampling.LANCZOS)
            )
        sheet.paste(picture, (number % COLUMNS * SIDE, number // COLUMNS * SIDE))
    sheet.quantize(256, method=Image.Quantize.FASTOCTREE).save(PICTURES, optimize=True)
    vertices = {
        name: len(document.surface().mesh.vertices) for name, (document, _) in documents.items()
    }
    TABLE.write_text(json.dumps(vertices, indent=1) + "\n", encoding="utf-8")


def _mesh_document(name: str) -> tuple[MatchDocument, dict[str, FloatArray]]:
    mesh = load_mesh(asset_path(name))
    surface = Surface(mesh, name, front_of(mesh))  # as it is opened
    return MatchDocument((surface,), (Channel(*default_functions(mesh)),)), {}


if __name__ == "__main__":
    draw_all()
