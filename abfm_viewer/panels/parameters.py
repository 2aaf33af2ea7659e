"""Parameters of the match."""

from dataclasses import fields
from functools import cache
from typing import Any, NamedTuple

from abfm import Parameters
from abfm.experiments import TITLES
from abfm.experiments.table_1 import NOTE, TABLE_1, row_of
from abfm.parameters import CHOICES
from abfm_viewer.panels.context import Context
from abfm_viewer.panels.solver import draw_switches
from abfm_viewer.session.session import Session
from abfm_viewer.widgets.toolkit import Ui

_OWN, _DEFAULTS = "own values", "defaults"
_INITIAL = Parameters()
_FIELDS = {entry.name: entry for entry in fields(Parameters)}


class _About(NamedTuple):
    """Where the paper has a parameter, what to try when the result is bad, and a number's slider."""

    place: str
    remedy: str
    low: float = 0
    high: float = 0
    log: bool = False


_ABOUT = {
    "alpha": _About(
        "section 3, Eq. 3", "Smaller if the target is missed, larger if the field is rough.", 1e-4, 1e4, log=True
    ),
    "beta": _About("section 3, Eq. 3", "0 is mostly best; try 1e-4 if the target's edges are blurred.", 0, 1, log=True),
    "order": _About("only 1", "2 keeps fields continuous; 1 fits more closely, with fields whose flow differs.", 1, 2),
    "sigma": _About(
        "Eq. 3, section 7, where it is absolute",
        "Smaller if the match is loose, larger if the field is wild. It is relative to the functions, whatever their "
        "scale and width, unless sigma_unit is absolute: half as large asks for half the mismatch.",
        1e-4,
        1,
        log=True,
    ),
    "sigma_unit": _About("absolute", "relative, which fits functions of any scale and width."),
    "reach": _About("", "Larger if the source shrinks where it is instead of moving to the target.", 0, 2),
    "tau": _About(
        "Eq. 3, section 7", "Leave it and change alpha: mostly only speed and tau trade places.", 0.1, 10, log=True
    ),
    "method": _About("Eqs. 4 and 5, section 5", "nonlinear if the result is jagged."),
    "segments": _About("Eq. 6, section 5", "More if linearised steps leave noise.", 1, 40),
    "gradient": _About("Eqs. 7 and 9", "adjoint, which is exact."),
    "substeps": _About("section 7", "More if the line search fails early.", 1, 200, log=True),
    "quadrature": _About("Eq. 9", "More if the line search fails early.", 1, 50),
    "iterations": _About("section 7", "More if it ended at the iteration limit.", 1, 2000, log=True),
    "cooling_stages": _About("section 7, Table 1", "More if functions far apart do not meet.", 1, 6),
    "levels": _About("", "More if a large mesh takes long, 1 if its coarser ones lose thin parts.", 0, 5),
    "balance": _About("", "Larger if flow lines confirm less than the match shows, 0 for the match alone.", 0, 1),
    "cooling_factor": _About("section 7, Table 1", "Smaller if a new stage undoes the last one.", 1.5, 100, log=True),
    "stage_iterations": _About("section 7", "More if the energy still falls where a stage ends.", 0, 200),
    "memory": _About("section 7", "More if it is slow, fewer if memory runs out.", 1, 100),
    "max_displacement": _About("", "Smaller if the field overshoots in the first iterations.", 0.01, 1, log=True),
    "tolerance": _About("", "Smaller if it converges too early.", 0, 0.1, log=True),
    "preconditioner": _About("section 7", "hodge, which is faster on all but the coarsest meshes."),
}
_MASK_TIP = (
    "A function that weighs the mismatch at each vertex, 0 or more: where it is 0, anything may happen. Any spec, for "
    "example indicator:vertex=12,radius=0.3 or expression:x>0. Empty: every vertex counts alike.\n"
    "Not in the paper. Bad result in one region: give it more weight."
)


def draw(context: Context) -> None:
    ui, session = context.ui, context.session
    parameters = session.parameters
    _preset(ui, session)
    _controls(ui, session, "alpha", "beta", "order", "sigma", "sigma_unit", "reach", "tau", "method", "segments")
    with ui.disabled(parameters.method == "linearised"):
        _controls(ui, session, "gradient")
        with ui.disabled(parameters.gradient == "adjoint"):
            _controls(ui, session, "substeps", "quadrature")
    _controls(ui, session, "iterations", "cooling_stages", "levels")
    _mask(ui, session)
    draw_switches(ui, session)
    with ui.section("Advanced", False) as is_open:
        if is_open:
            _controls(ui, session, "balance", "cooling_factor", "stage_iterations", "memory", "max_displacement")
            _controls(ui, session, "tolerance", "preconditioner")
    tip = "All parameters as they are at first."
    if ui.button("Reset to defaults", tip, enabled=parameters != _INITIAL, width=-1):
        session.set_parameter(label="reset the parameters", **_INITIAL.to_dict())
        ui.accept_all()


def _preset(ui: Ui, session: Session) -> None:
    now = row_of(session.parameters)
    shown = now.name if now else _DEFAULTS if session.parameters == _INITIAL else _OWN
    rows = TABLE_1.values()
    about = "\n".join(f"{row.name}: {TITLES[row.figure]}" for row in rows)
    chosen = ui.combo("preset", shown, [row.name for row in rows], f"{NOTE}\n\n{about}")
    for row in rows:
        if chosen == row.name != shown:
            session.set_parameter(label=f"preset {row.name}", **row.values)
            ui.accept_all()


def _controls(ui: Ui, session: Session, *names: str) -> None:
    """Draw the widgets of some parameters, which say in place why a value is refused."""
    for name in names:
        about, value = _ABOUT[name], getattr(session.parameters, name)
        new: Any
        if name in CHOICES:
            new = ui.combo(name, value, CHOICES[name], _tip(name))
        else:
            whole = _FIELDS[name].type == "int"
            new = ui.number(name, value, about.low, about.high, _tip(name), log=about.log, whole=whole)
        if new is not None and new != value:
            with ui.refusing(name):
                session.set_parameter(name, **{name: new})
        if name in CHOICES:
            ui.refusal(name)


def _mask(ui: Ui, session: Session) -> None:
    spec = ui.text("mask", session.document.mask, _MASK_TIP, hint="none: all vertices count")
    if spec is not None:
        with ui.refusing("mask"):
            session.set_mask(spec.strip())
    ui.refusal("mask")
    if problem := session.error(session.document.mask):
        ui.note(problem, "failure")


@cache
def _tip(name: str) -> str:
    help, symbol = _FIELDS[name].metadata["help"], _FIELDS[name].metadata["symbol"]
    default, (place, remedy, *_) = getattr(_INITIAL, name), _ABOUT[name]
    shown = f"{default:g}" if isinstance(default, int | float) else default
    in_paper = ", ".join(filter(None, [symbol.strip("*"), place])) or "not there"
    return f"{help[0].upper()}{help[1:]}. Default: {shown}.\nIn the paper: {in_paper}.\nBad result? {remedy}"
