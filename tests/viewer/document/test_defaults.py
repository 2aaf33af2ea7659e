"""The functions that a mesh is opened with."""

from __future__ import annotations

import numpy as np
import pytest

from abfm import TriangleMesh, load_mesh
from abfm.assets import asset_names, asset_path
from abfm.calculus.geodesics import geodesic_distance
from abfm.functions import function, parse
from abfm_viewer.document.defaults import default_functions
from tests.shapes import disc, torus

MESHES = [name for name in asset_names() if name.endswith(".off")]


@pytest.mark.parametrize("mesh", [*MESHES, torus(30, 20), disc(8)], ids=str)
def test_any_mesh_gets_two_gaussians_a_quarter_of_the_body_apart(mesh):
    mesh = load_mesh(asset_path(mesh)) if isinstance(mesh, str) else mesh
    source, target = (int(np.argmax(function(mesh, spec))) for spec in default_functions(mesh))
    end = int(np.argmax(geodesic_distance(mesh, [0])))
    apart = geodesic_distance(mesh, [source])[target] / geodesic_distance(mesh, [end]).max()
    assert 0.15 < apart < 0.4


def test_vertices_are_counted_as_the_file_does():
    whole = torus(12, 8)
    gap = TriangleMesh(np.vstack([np.zeros((5, 3)), whole.vertices]), whole.faces + 5)
    for spec, shifted in zip(default_functions(whole), default_functions(gap), strict=True):
        assert parse(shifted).vertex[0] == parse(spec).vertex[0] + 5
