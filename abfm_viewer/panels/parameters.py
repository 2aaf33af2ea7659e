"""Parameters of the match."""

from dataclasses import replace
from functools import cache
from typing import Any, NamedTuple

from abfm import Parameters
from abfm.parameters import (
    AREA_PRESERVING_DIVERGENCE,
    CHOICES,
    FIELDS,
    LAST_SIGMA,
    TABLE_1,
    is_integer,
    row_of,
)
from abfm.wording import sentence
from abfm_viewer.panels.context import Context
from abfm_viewer.panels.solver import draw_switches
from abfm_viewer.session.session import Session
from abfm_viewer.widgets.containers import section
from abfm_viewer.widgets.toolkit import AUTO, Auto, Ui
from abfm_viewer.widgets.widget_record import Range

_OWN_VALUES = "own values"
_DEFAULTS = "defaults"
_DEFAULT_PARAMETERS = Parameters()


class _About(NamedTuple):
    """What a parameter is called, where the paper has it, and its slider."""

    label: str
    place: str
    slider: Range = Range(0, 1)


_PARAMETER_TEXTS = {
    "alpha": _About("smoothness α", "section 3, Eq. 3", Range(1e-4, 1e4, log=True)),
    "sigma": _About(
        "closeness σ", "Eq. 3, section 7, where it is absolute", Range(1e-3, 20, log=True)
    ),
    "beta": _About("slopes β", "section 3, Eq. 3", Range(0, 1, log=True)),
    "tau": _About("time τ", "Eq. 3, section 7", Range(0.1, 10, log=True)),
    "reach": _About("reach", "", Range(0, 2)),
    "divergence": _About("keeping areas", "1", Range(0.1, 1000, log=True)),
    "iterations": _About("iterations", "section 7", Range(1, 2000, log=True)),
    "sigma_unit": _About("unit of σ", "absolute"),
    "landmark_sigma": _About("landmarks' λ", "", Range(1e-4, 0.1, log=True)),
    "cooling_stages": _About("stages of σ", "section 7, Table 1", Range(0, 6)),
    "cooling_factor": _About("σ divided by", "section 7, Table 1", Range(1.5, 100, log=True)),
    "stage_iterations": _About("stage length", "section 7", Range(0, 200)),
    "goal": _About("goal", "", Range(0.01, 0.5, log=True)),
    "refine": _About("refinements", ""),
    "levels": _About("mesh levels", "", Range(0, 5)),
    "order": _About("norm's order", "only 1", Range(1, 2)),
    "method": _About("method", "Eqs. 4 and 5, section 5"),
    "segments": _About("fields in a row", "Eq. 6, section 5", Range(0, 40)),
    "gradient": _About("gradient", "Eqs. 7 and 9"),
    "substeps": _About("sub-steps n", "section 7", Range(1, 200, log=True)),
    "quadrature": _About("intervals k", "Eq. 9", Range(1, 50)),
    "memory": _About("memory", "section 7", Range(1, 100)),
    "max_displacement": _About("longest step", "", Range(0.01, 1, log=True)),
    "tolerance": _About("tolerance", "", Range(0, 0.1, log=True)),
    "preconditioner": _About("preconditioner", "section 7"),
}
"""In the order in which they are drawn."""
_REMEDIES = {
    "alpha": "Smaller if the target is missed, larger if the field is rough.",
    "sigma": "Auto is mostly best; smaller if the match is loose, larger if the field is wild. It "
    "is relative to the functions, whatever their scale and width, unless the unit of σ is "
    "absolute: half as large asks for half the residual.",
    "beta": "0 is mostly best; try 1e-4 if the target's edges are blurred.",
    "tau": "Leave it and change the smoothness: mostly only speed and time trade places.",
    "reach": "Larger if the source shrinks where it is instead of moving to the target.",
    "divergence": "Auto is mostly best; 1 if areas have to change much, more if they must not.",
    "iterations": "More if it ended at the iteration limit.",
    "sigma_unit": "relative, which fits functions of any scale and width.",
    "landmark_sigma": "Smaller if landmarks are left too far, larger if they tear at the map.",
    "cooling_stages": "More if functions far apart do not meet.",
    "cooling_factor": "Smaller if a new stage undoes the last one.",
    "stage_iterations": "More if the energy still falls where a stage ends.",
    "goal": "Smaller if what counts as matched is not close enough.",
    "refine": "More if flow lines confirm less than the match shows, 0 if it takes long.",
    "levels": "More if a large mesh takes long, 1 if its coarser ones lose thin parts.",
    "order": "2 keeps fields continuous; 1 fits more closely, with fields whose flow differs.",
    "method": "nonlinear if the result is jagged.",
    "segments": "1 for a single field, more if one does not come close or linearised steps leave "
    "noise.",
    "gradient": "adjoint, which is exact.",
    "substeps": "More if the line search fails early.",
    "quadrature": "More if the line search fails early.",
    "memory": "More if it is slow, fewer if memory runs out.",
    "max_displacement": "Smaller if the field overshoots in the first iterations.",
    "tolerance": "Smaller if it converges too early.",
    "preconditioner": "hodge, which is faster on all but the coarsest meshes.",
}
"""What another value mends."""
_CHOICES = CHOICES | {"refine": (AUTO, "0", "1", "2")}
_AUTO = {
    "sigma": Auto(
        LAST_SIGMA,
        "The match comes as close as can be certified, and says how close. Untick it, or move the "
        "slider, to end at a closeness of your own.",
    ),
    "divergence": Auto(
        AREA_PRESERVING_DIVERGENCE,
        "10 where the functions match exactly, and 1 where they were measured. Untick it, or move "
        "the slider, to choose.",
    ),
}
_MAIN_PARAMETERS = ("alpha", "sigma", "beta", "tau", "reach")
_MASK = (
    "A function that weighs the mismatch at each vertex, 0 or more: where it is 0, anything may "
    "happen. Any spec, for example indicator:vertex=12,radius=0.3 or expression:x>0. Empty: every "
    "vertex counts alike.\nNot in the paper. Bad result in one region: give it more weight."
)


def draw(context: Context) -> None:
    ui, session = context.ui, context.session
    parameters = session.parameters
    _preset(ui, session)
    for name in _MAIN_PARAMETERS:
        _control(ui, session, name)
    draw_switches(ui, session)
    with section(ui, "Advanced", False) as is_open:
        if is_open:
            useless = (
                {"substeps", "quadrature"} if parameters.paper.gradient == "adjoint" else set()
            )
            if parameters.paper.method == "linearised":
                useless = {"gradient", "substeps", "quadrature"}
            for name in [name for name in _PARAMETER_TEXTS if name not in _MAIN_PARAMETERS]:
                with ui.disabled(name in useless):
                    _control(ui, session, name)
            spec = ui.text("mask", session.document.mask, _MASK, hint="none: all vertices count")
            if spec is not None:
                with ui.refusals.refusing("mask"):
                    session.editor.set_mask(spec.strip())
            ui.refusal("mask", otherwise=session.work.error("mask"))
            tip = "All parameters as they are at first."
            if ui.button(
                "Reset to defaults", tip, enabled=parameters != _DEFAULT_PARAMETERS, width=-1
            ):
                session.editor.reset_parameters()


def _preset(ui: Ui, session: Session) -> None:
    now = row_of(session.parameters)
    shown = (
        now.name if now else _DEFAULTS if session.parameters == _DEFAULT_PARAMETERS else _OWN_VALUES
    )
    rows = {row.name: row for row in TABLE_1.values()}
    tips = {_OWN_VALUES: ""} if shown == _OWN_VALUES else {}
    tips[_DEFAULTS] = "What is best for most meshes and functions."
    tips |= {name: row.about for name, row in rows.items()}
    about = "All parameters at once: the defaults, or a row of the paper's Table 1."
    chosen = ui.combo("preset", shown, tips, f"{about}\n\n{tips[shown]}".strip())
    if chosen == shown:
        return
    if chosen == _DEFAULTS:
        session.editor.reset_parameters()
    elif chosen in rows:
        session.editor.set_parameter(label=f"preset {chosen}", **rows[chosen].values)


def _control(ui: Ui, session: Session, name: str) -> None:
    about, value = _PARAMETER_TEXTS[name], session.parameters.to_dict()[name]
    label, whole = f"{about.label}##{name}", is_integer(FIELDS[name])
    ends, tip = replace(about.slider, whole=whole), _tip(name)
    new: Any
    if name in _CHOICES:
        chosen = ui.combo(label, AUTO if value is None else str(value), _CHOICES[name], tip)
        new = int(chosen) if chosen.isdecimal() else chosen
        ui.refusal(name)
    elif name in _AUTO:
        new = ui.number_or_auto(label, value, ends, tip, _AUTO[name])
    else:
        new = ui.number(label, value, ends, tip)
    if whole and isinstance(new, float) and new.is_integer():
        new = int(new)
    if new is None or new == (AUTO if value is None else value):
        return
    with ui.refusals.refusing(name, about.label):
        given = {name: None if new == AUTO else new}
        session.editor.set_parameter(name, f"change {about.label}", **given)


@cache
def _tip(name: str) -> str:
    help, symbol = FIELDS[name].metadata["help"], FIELDS[name].metadata["symbol"]
    default, about = FIELDS[name].default, _PARAMETER_TEXTS[name]
    shown = f"{default:g}" if isinstance(default, int | float) else default or AUTO
    in_paper = ", ".join(filter(None, [symbol.strip("*"), about.place])) or "not there"
    return (
        f"{sentence(help)} Default: {shown}.\nIn the paper: {in_paper}.\n"
        f"In files and on the command line: {name}.\nBad result? {_REMEDIES[name]}"
    )
