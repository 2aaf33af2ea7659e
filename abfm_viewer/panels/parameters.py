"""Parameters of the match."""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cache
from typing import Any

from abfm import AbfmError, ParameterError, Parameters
from abfm.experiments import TITLES
from abfm.experiments.table_1 import NOTE, TABLE_1, row_of
from abfm.parameters import CHOICES
from abfm_viewer.panels.context import Context
from abfm_viewer.panels.solver import draw_switches
from abfm_viewer.session.session import Session
from abfm_viewer.widgets.toolkit import Ui

_OWN, _DEFAULTS = "own values", "defaults"
_INITIAL = Parameters()
_HELP = {entry.name: entry.metadata for entry in fields(Parameters)}


@dataclass(frozen=True)
class _Number:
    """A parameter's slider, and what its tooltip says besides what the parameter does.

    Attributes
    ----------
    place : str
        Where the paper has it.
    remedy : str
        What to try when the result is bad.
    """

    name: str
    low: float
    high: float
    place: str
    remedy: str
    log: bool = False
    whole: bool = False


_MODEL = (
    _Number(
        "alpha", 1e-4, 1e4, "section 3, Eq. 3", "Smaller if the target is missed, larger if the field is rough.", True
    ),
    _Number("beta", 0, 1, "section 3, Eq. 3", "0 is mostly best; try 1e-4 if the target's edges are blurred.", True),
    _Number(
        "order",
        1,
        2,
        "only 1",
        "2 keeps fields continuous; 1 fits more closely, with fields whose flow differs.",
        whole=True,
    ),
    _Number(
        "sigma",
        1e-4,
        1,
        "Eq. 3, section 7, where it is absolute",
        "Smaller if the match is loose, larger if the field is wild. It is relative to the functions, whatever their "
        "scale and width, unless sigma_unit is absolute: half as large asks for half the mismatch.",
        True,
    ),
)
_WAY = (
    _Number("reach", 0, 2, "", "Larger if the source shrinks where it is instead of moving to the target."),
    _Number(
        "tau", 0.1, 10, "Eq. 3, section 7", "Leave it and change alpha: mostly only speed and tau trade places.", True
    ),
)
_SEGMENTS = _Number("segments", 1, 40, "Eq. 6, section 5", "More if linearised steps leave noise.", whole=True)
_BRACKET = (
    _Number("substeps", 1, 200, "section 7", "More if the line search fails early.", True, True),
    _Number("quadrature", 1, 50, "Eq. 9", "More if the line search fails early.", whole=True),
)
_EFFORT = (
    _Number("iterations", 1, 2000, "section 7", "More if it ended at the iteration limit.", True, True),
    _Number("cooling_stages", 1, 6, "section 7, Table 1", "More if functions far apart do not meet.", whole=True),
    _Number("levels", 0, 5, "", "More if a large mesh takes long, 1 if its coarser ones lose thin parts.", whole=True),
)
_ADVANCED = (
    _Number("balance", 0, 1, "", "Larger if flow lines confirm less than the match shows, 0 for the match alone."),
    _Number("cooling_factor", 1.5, 100, "section 7, Table 1", "Smaller if a new stage undoes the last one.", True),
    _Number("stage_iterations", 0, 200, "section 7", "More if the energy still falls where a stage ends.", whole=True),
    _Number("memory", 1, 100, "section 7", "More if it is slow, fewer if memory runs out.", whole=True),
    _Number("max_displacement", 0.01, 1, "", "Smaller if the field overshoots in the first iterations.", True),
    _Number("tolerance", 0, 0.1, "", "Smaller if it converges too early.", True),
)
_WORDS = {
    "sigma_unit": ("absolute", "relative, which fits functions of any scale and width."),
    "method": ("Eqs. 4 and 5, section 5", "nonlinear if the result is jagged."),
    "gradient": ("Eqs. 7 and 9", "adjoint, which is exact."),
    "preconditioner": ("section 7", "hodge, which is faster on all but the coarsest meshes."),
}
_MASK_TIP = (
    "A function that weighs the mismatch at each vertex, 0 or more: where it is 0, anything may happen. Any spec, for "
    "example indicator:vertex=12,radius=0.3 or expression:x>0. Empty: every vertex counts alike.\n"
    "Not in the paper. Bad result in one region: give it more weight."
)


def draw(context: Context) -> None:
    """Draw everything that can be set about a match."""
    ui, session = context.ui, context.session
    parameters = session.parameters
    _preset(ui, session)
    for number in _MODEL:
        _number(ui, session, number)
    _choice(ui, session, "sigma_unit")
    for number in _WAY:
        _number(ui, session, number)
    _choice(ui, session, "method")
    _number(ui, session, _SEGMENTS)
    with ui.disabled(parameters.method == "linearised"):
        _choice(ui, session, "gradient")
        with ui.disabled(parameters.gradient == "adjoint"):
            for number in _BRACKET:
                _number(ui, session, number)
    for number in _EFFORT:
        _number(ui, session, number)
    _mask(ui, session)
    draw_switches(ui, session)
    with ui.section("Advanced", False) as is_open:
        if is_open:
            for number in _ADVANCED:
                _number(ui, session, number)
            _choice(ui, session, "preconditioner")
    enabled = parameters != _INITIAL
    if ui.button("Reset to defaults", "All parameters as they are at first.", enabled=enabled, width=-1):
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


def _number(ui: Ui, session: Session, number: _Number) -> None:
    name = number.name
    value = ui.number(
        name,
        getattr(session.parameters, name),
        number.low,
        number.high,
        _tip(name, number.place, number.remedy),
        log=number.log,
        whole=number.whole,
    )
    if value is not None:
        _set(ui, session, name, value)


def _choice(ui: Ui, session: Session, name: str) -> None:
    value = getattr(session.parameters, name)
    chosen = ui.combo(name, value, CHOICES[name], _tip(name, *_WORDS[name]))
    if chosen != value:
        _set(ui, session, name, chosen)
    ui.refusal(name)


def _set(ui: Ui, session: Session, name: str, value: Any) -> None:
    """Change a parameter, or say in place why not."""
    try:
        session.set_parameter(name, **{name: value})
        ui.refuse(name, "")
    except ParameterError as error:
        ui.refuse(name, str(error))


def _mask(ui: Ui, session: Session) -> None:
    spec = ui.text("mask", session.document.mask, _MASK_TIP, hint="none: all vertices count")
    if spec is not None:
        try:
            session.set_mask(spec.strip())
            ui.refuse("mask", "")
        except AbfmError as error:
            ui.refuse("mask", str(error))
    ui.refusal("mask")
    problem = session.error(session.document.mask)
    if problem:
        ui.note(problem, "error")


@cache
def _tip(name: str, place: str, remedy: str) -> str:
    help, symbol = _HELP[name]["help"], _HELP[name]["symbol"]
    default = getattr(_INITIAL, name)
    shown = f"{default:g}" if isinstance(default, int | float) else default
    in_paper = ", ".join(filter(None, [symbol.strip("*"), place])) or "not there"
    return f"{help[0].upper()}{help[1:]}. Default: {shown}.\nIn the paper: {in_paper}.\nBad result? {remedy}"
