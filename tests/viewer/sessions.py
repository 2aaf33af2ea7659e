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
SIZE = (560, 400)  # of windows: drawing takes as long as there are pixels
PAIR = Channel("gaussian:x=1,y=0,z=0,width=0.15", "gaussian:x=0,y=1,z=0,width=0.15")
QUICK = Parameters.of(iterations=20, refine=0)
SHORT = Parameters.of(iterations=20, cooling_stages=1, refine=0)
ENDLESS = Parameters.of(
    **PAPER, iterations=100_000, max_displacement=1e-3, tolerance=0, cooling_stages=1
)
"""One stage with so small steps that a run goes on until it is told otherwise."""


def problem(parameters=QUICK, channel=PAIR):
    """What a session with one channel on the sphere would solve."""
    return ProblemSpec(SPHERE, (channel,), parameters, "")


def opened(parameters=QUICK, channel=PAIR):
    """A session on the sphere whose functions are known, at the beginning of its history."""
    session = Session(SPHERE, "sphere")
    view = replace(session.view, flow_after_match=False)  # tests look at what stands still
    session.editor.amend(channels=(channel,), parameters=parameters, view=view)
    return ready(session)


def until(condition, session=None, seconds=30):
    """Wait for a condition, with frames of the session if there is one."""
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "waited in vain"
        if session:
            session.update()
        time.sleep(0.002)


def ready(session):
    """The session with its functions known."""
    until(lambda: not session.obstacle, session)
    return session


def matched(session):
    """The session after its match."""
    session.match()
    until(lambda: session.solver.finished, session)
    return session


def stepped(match, shares=(0.3, 0.7)):
    """The match at the end of a path, whose other steps are shares of its field."""
    functions, known = match.problem.functions, {"folded": 0.0, "log2_shape": 0.2}
    smoother = []
    for s in shares:
        field = s * match.fine_velocity
        carried = Flow(match.mesh, field, match.parameters.tau).push(match.source)
        left = functions.residual(carried.T)
        step = PathStep(1 - s, 0.01, 0.0, field, left, 0.9, log2_area=s / 3, **known)
        smoother.append(step)
    end = replace(match.path[match.step], log2_area=0.5, log2_shape=0.7)
    return replace(match, path=(*smoother, end), step=len(shares))


def heard(gui, monkeypatch, how):
    """Return what draws a frame and tells what is written in it by a method of `Ui`: texts and the
    words for their colours.
    """
    said, write = [], getattr(Ui, how)

    def listen(ui, text, kind="muted", *more, **others):
        said.append((text, kind))
        write(ui, text, kind, *more, **others)

    def now():
        said.clear()
        gui.frames(1)
        return list(said)

    monkeypatch.setattr(Ui, how, listen)
    return now


def solving(session, rows=5):
    """The session during a run that has made more than some steps."""
    session.match()
    until(lambda: session.matching.record and len(session.matching.record.stages) > rows, session)
    return session


def hold(session):
    """Pause the run, and wait until the evaluation under way has ended."""
    session.solver.pause()

    def stands_still():
        held = session.matching.snapshot
        time.sleep(0.2)
        return session.matching.snapshot is held

    until(stands_still)


def end_run(session):
    """End the run, if there is one, and take its best field."""
    session.solver.cancel()
    until(lambda: not session.solver.running, session)


# In a window


def match(gui):
    gui.click("Match")
    gui.wait(lambda s: s.solver.finished)


def begin(gui, iterations=-1):
    """Start a run, and wait until it has made more than so many iterations."""
    gui.click("Match")
    gui.wait(lambda s: s.matching.snapshot and s.matching.snapshot.iteration.iteration > iterations)


def cancel(gui):
    gui.click("Cancel")
    gui.wait(lambda s: s.solver.finished)


def take_back(gui):
    """Take back every step."""
    while gui.session.editor.undo_label:
        gui.key("ctrl+z")


def restart(gui, document=None):
    """Begin the next step of a tour with a document, by default the present one, as if it had just
    been opened.
    """
    gui.session.solver.cancel()
    gui.wait(lambda s: not s.solver.running)
    for card in gui.session.notices.cards:
        gui.session.notices.dismiss(card)
    document = document or gui.session.document
    gui.session.editor.document = replace(document, identity=Identity())
    gui.session.reset_history()
    gui.wait(lambda s: not s.obstacle)
