"""Coarser meshes made ahead."""

from __future__ import annotations

import abfm.matching.solving.levels
from abfm import Parameters
from abfm_viewer.computing.background import Latest
from abfm_viewer.computing.coarse_meshes import CoarseMeshes
from tests.shapes import torus
from tests.viewer.sessions import opened, until


def test_they_are_made_once_for_a_mesh_and_a_number_of_levels(monkeypatch):
    asked = []
    monkeypatch.setattr(
        abfm.matching.solving.levels, "prepare", lambda mesh, parameters: asked.append((mesh, parameters.levels))
    )
    mesh, meshes = torus(12, 8), CoarseMeshes()
    for parameters in (Parameters(), Parameters(sigma=0.1), Parameters(levels=2)):
        for _ in range(3):
            meshes.prepare(mesh, parameters)
            until(lambda: not meshes.busy)
    assert asked == [(mesh, 0), (mesh, 2)]
    meshes.close()


def test_an_opened_mesh_gets_them(monkeypatch):
    asked = []
    monkeypatch.setattr(abfm.matching.solving.levels, "prepare", lambda mesh, parameters: asked.append(mesh))
    session = opened()
    until(lambda: asked, session)
    assert asked == [session.mesh]
    session.close()


def test_pictures_off_the_screen_need_none(monkeypatch):
    monkeypatch.setattr(Latest, "at_once", True)
    meshes = CoarseMeshes()
    meshes.prepare(torus(12, 8), Parameters())
    assert not meshes.busy
