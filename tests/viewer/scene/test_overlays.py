from dataclasses import replace

import numpy as np

from abfm_viewer.scene.opengl import ps
from tests.viewer.sessions import matched


def test_transparency_is_on_only_for_faint_arrows(gui, monkeypatch):
    modes, quantities = [], gui.window.shown.quantities
    monkeypatch.setattr(ps, "set_transparency_mode", modes.append)
    usual, opacity = quantities.arrows, 1.0

    def arrows(*given):
        found = usual(*given)
        return found and replace(found, opacities=np.full_like(found.opacities, opacity))

    monkeypatch.setattr(quantities, "arrows", arrows)
    matched(gui.session)
    gui.session.editor.set_view("look", arrows=True)
    gui.wait(lambda _: ps.has_surface_mesh("arrows"))
    assert set(modes) == {"none"}
    opacity = 0.5
    gui.wait(lambda _: modes[-1] == "pretty")
    gui.session.editor.set_view("look", arrows=False)
    gui.wait(lambda _: not ps.has_surface_mesh("arrows"))
    assert modes[-1] == "none"
