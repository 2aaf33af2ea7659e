"""Arrows of a sequence: faint where the field is undetermined, absent for a standing wave."""

from dataclasses import replace

import numpy as np
import pytest

import abfm
from abfm.sequences import defaults
from abfm_viewer.files.documents import document_of_sequence
from abfm_viewer.session.session import Session
from abfm_viewer.shown.eye import Eye
from abfm_viewer.shown.paint import Painter
from tests.viewer.sessions import SPHERE, until

FRONT = Eye(np.eye(3))


@pytest.fixture
def shown_of(tmp_path, watched):
    """Return a function that returns the shown quantities of a sequence, with arrows."""
    sessions = []

    def show(frames, time):
        found = abfm.sequence(SPHERE, frames, None, defaults(alpha=1.0, order=1, sigma=0.3))
        document = document_of_sequence(found, tmp_path / "wave.npz")
        session = Session(SPHERE, "sphere")
        sessions.append(session)
        view = replace(document.view, arrows=True)
        session.restore(replace(document, view=view, time=time), {}, None)
        return found, watched(session)

    yield show
    for session in sessions:
        session.close()


def arrows_of(shown):
    shown.session.update()
    field = shown.quantities.field()
    return None if field is None else shown.quantities.arrows(field, 300.0, FRONT)


def test_arrows_fade_where_the_field_is_undetermined(shown_of):
    angles = 0.15 * np.arange(4)
    bump = np.stack([np.sin(angles), 0 * angles, np.cos(angles)], axis=1)
    sequence, shown = shown_of(np.exp(6 * (bump @ SPHERE.vertices.T - 1)), 0.0)
    until(lambda: (arrows := arrows_of(shown)) is not None and arrows.opacities.min() < 1)
    found = arrows_of(shown).opacities
    assert np.isin(found, np.maximum(sequence.determined[0], 0.2)).all()
    assert found.min() < 0.6
    assert found.max() > 0.9


def test_standing_wave_has_no_arrows(shown_of):
    amplitudes = np.cos(0.2 * np.arange(5) + 0.5)
    frames = amplitudes[:, None] * np.cos(6 * SPHERE.vertices[:, 0])
    sequence, shown = shown_of(frames, 1.25)
    assert (sequence.confirmed, sequence.has_motion) == (0, False)
    until(lambda: (arrows := arrows_of(shown)) is not None and not len(arrows.spines))
    painter = Painter(shown)
    until(lambda: painter.paint("advected") is not None and not shown.busy, shown.session)
    expected = 0.75 * frames[1] + 0.25 * frames[2]
    np.testing.assert_allclose(painter.paint("advected").values, expected, atol=1e-6)
