"""What cannot be drawn is refused with what to do, wherever it comes from."""

from __future__ import annotations

import numpy as np
import pytest

import abfm
from abfm import FunctionError, MeshError, TriangleMesh
from abfm_viewer.app import main
from abfm_viewer.document import Channel, Document
from abfm_viewer.pictures import match_picture
from abfm_viewer.session import Session
from abfm_viewer.single_precision import check_function, check_mesh
from tests.mesh_writers import off_text
from tests.shapes import icosphere
from tests.viewer.sessions import opened, until

SPHERE = icosphere(1)
UNDRAWABLE = [
    (1e30, 0.0, "scale its coordinates"),
    (1e-30, 0.0, "scale its coordinates"),
    (1.0, 1e7, "subtract its centre"),
]


def moved(scale: float, offset: float) -> TriangleMesh:
    return TriangleMesh(scale * SPHERE.vertices + offset, SPHERE.faces)


@pytest.mark.parametrize(("scale", "offset", "advice"), UNDRAWABLE)
def test_meshes_are_refused(scale, offset, advice):
    mesh = moved(scale, offset)
    document = Document(mesh, "far", (Channel("coordinate:x", "coordinate:y"),))
    session = opened()
    before = session.document
    for attempt in (
        lambda: check_mesh(mesh),
        lambda: Session(mesh, "far"),
        lambda: session.set_mesh(mesh, "far"),
        lambda: session.restore(document, {}, None),
    ):
        with pytest.raises(MeshError, match=advice):
            attempt()
    assert session.document is before
    session.close()


@pytest.mark.parametrize(("scale", "offset"), [(1e6, 0.0), (1e-6, 0.0), (1.0, 100.0), (1e9, 1e12)])
def test_other_meshes_are_not(scale, offset):
    check_mesh(moved(scale, offset))


def test_a_file_is_refused_in_one_line(tmp_path, capsys):
    path = tmp_path / "far.off"
    mesh = moved(1.0, 1e7)
    path.write_text(off_text(mesh.vertices, mesh.faces))
    assert main([str(path)]) == 2
    assert "subtract its centre" in capsys.readouterr().err
    session = opened()
    session.open_mesh(path)
    until(lambda: session.notice.is_error, session)
    assert "subtract its centre" in session.notice.text
    session.close()


def test_no_sheet_is_drawn_of_what_cannot_be_drawn():
    mesh = moved(1.0, 1e7)
    result = abfm.match(mesh, SPHERE.vertices[:, 0], SPHERE.vertices[:, 1], abfm.Parameters(iterations=0))
    with pytest.raises(MeshError, match="subtract its centre"):
        match_picture(result)


def test_functions_are_refused():
    for value in (1e31, 1e-31):
        with pytest.raises(FunctionError, match="scale it"):
            check_function("f", np.array([0.0, -value]))
    for value in (0.0, 1e-29, 1e29):
        check_function("f", np.array([0.0, -value]))
