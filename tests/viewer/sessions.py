"""Sessions for tests: a small sphere, and waiting without a window."""

import time
from dataclasses import replace

from abfm import Flow, Parameters
from abfm.matching import PathStep
from abfm.parameters import PAPER
from abfm_viewer.computing.matching import ProblemSpec
from abfm_viewer.document.document import Channel, Identity
from abfm_viewer.session.session import Session
from abfm_viewer.widgets.toolkit import Ui
from tests.shapes import ellipsoid, icosphere

SPHERE = icosphere(3)
EGG = ellipsoid(3, 1.0, 0.7, 0.55)
SIZE = (560, 400)  # of windows; small, because drawing time is proportional to the pixels
PAIR = Channel("gaussian:x=1,y=0,z=0,width=0.15", "gaussian:x=0,y=1,z=0,width=0.15")
QUICK = Parameters.of(iterations=20, refine=0)
SHORT = Parameters.of(iterations=20, cooling_stages=1, refine=0)
ENDLESS = Parameters.of(
    **PAPER, iterations=100_000, max_displacement=1e-3, tolerance=0, cooling_stages=1
)
"""Parameters of one stage with such small steps that a run continues until it is cancelled."""


def problem(parameters=QUICK, channel=PAIR):
    return ProblemSpec(SPHERE, (channel,), parameters, "")


def opened(parameters=QUICK, channel=PAIR):
    """Return a session on the sphere with computed functions and an empty undo history."""
    session = Session(SPHERE, "sphere")
    view = replace(session.view, flow_after_match=False)  # tests need a constant time
    session.editor.amend(channels=(channel,), parameters=parameters, view=view)
    return ready(session)


def until(condition, session=None, seconds=30):
    """Wait until a condition holds, and update the session, if one is given, meanwhile."""
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, f"the condition was not met within {seconds} s"
        if session:
            session.update()
        time.sleep(0.005)


def ready(session):
    """Wait until the functions of the session are computed, and return the session."""
    until(lambda: not session.obstacle, session)
    return session


def matched(session):
    session.match()
    until(lambda: session.solver.finished, session)
    return session


def stepped(match, shares=(0.3, 0.7)):
    """Return the match with new steps before the last; step i has its field times ``shares[i]``."""
    functions, known = match.problem.functions, {"folded": 0.0, "log2_shape": 0.2}
    smoother = []
    for s in shares:
        field = s * match.fine_velocity
        advected = Flow(match.mesh, field, match.parameters.tau).push(match.source)
        residual = functions.residual(advected.T)
        step = PathStep(1 - s, 0.01, 0.0, field, residual, 0.9, log2_area=s / 3, **known)
        smoother.append(step)
    end = replace(match.path[match.step], log2_area=0.5, log2_shape=0.7)
    return replace(match, path=(*smoother, end), step=len(shares))


def drawn_texts(gui, monkeypatch, method):
    """Return a function that draws a frame and returns texts and colours drawn by a `Ui` method."""
    texts, write = [], getattr(Ui, method)

    def write_and_record(ui, text, kind="muted", *more, **others):
        texts.append((text, kind))
        write(ui, text, kind, *more, **others)

    def draw():
        texts.clear()
        gui.frames(1)
        return list(texts)

    monkeypatch.setattr(Ui, method, write_and_record)
    return draw


def solving(session, rows=5):
    """Return the session during a run of more than ``rows`` iterations."""
    session.match()
    until(lambda: session.matching.record and len(session.matching.record.stages) > rows, session)
    return session


def hold(session):
    """Pause the run, and wait until the current evaluation has ended."""
    session.solver.pause()

    def is_paused():
        snapshot = session.matching.snapshot
        time.sleep(0.2)
        return session.matching.snapshot is snapshot

    until(is_paused)


def end_run(session):
    """End the run, if there is one, with its best field as the result."""
    session.solver.cancel()
    until(lambda: not session.solver.running, session)


# In a window


def match(gui):
    gui.click("Match")
    gui.wait(lambda s: s.solver.finished)


def begin(gui, iterations=-1):
    """Start a run, and wait until it has made more than ``iterations`` iterations."""
    gui.click("Match")
    gui.wait(lambda s: s.matching.snapshot and s.matching.snapshot.iteration.iteration > iterations)


def cancel(gui):
    gui.click("Cancel")
    gui.wait(lambda s: s.solver.finished)


def take_back(gui):
    while gui.session.editor.undo_label:
        gui.key("ctrl+z")


def restart(gui, document=None):
    """Start the next step of a tour with a document (None: the current one) as if just opened."""
    gui.session.solver.cancel()
    gui.wait(lambda s: not s.solver.running)
    for card in gui.session.notices.cards:
        gui.session.notices.dismiss(card)
    document = document or gui.session.document
    gui.session.editor.document = replace(document, identity=Identity())
    gui.session.reset_history()
    gui.wait(lambda s: not s.obstacle)
