"""The parameters of the match in the tab Match."""

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
from abfm_viewer.panels.explanations import draw_help
from abfm_viewer.panels.solver import draw_switch
from abfm_viewer.session.session import Session
from abfm_viewer.widgets.containers import section
from abfm_viewer.widgets.toolkit import AUTO, Auto, Ui
from abfm_viewer.widgets.widget_record import Range

_CUSTOM_VALUES = "custom values"
_DEFAULTS = "defaults"
_DEFAULT_PARAMETERS = Parameters()


class _About(NamedTuple):
    """Label of a parameter, where the paper describes it, and the range of its slider."""

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
    "divergence": _About("divergence", "1", Range(0.1, 1000, log=True)),
    "iterations": _About("iterations", "section 7", Range(1, 2000, log=True)),
    "sigma_unit": _About("unit of σ", "absolute"),
    "landmark_sigma": _About("landmark λ", "", Range(1e-4, 0.1, log=True)),
    "cooling_stages": _About("cooling stages", "section 7, Table 1", Range(0, 6)),
    "cooling_factor": _About("cooling factor", "section 7, Table 1", Range(1.5, 100, log=True)),
    "stage_iterations": _About("stage length", "section 7", Range(0, 200)),
    "goal": _About("goal", "", Range(0.01, 0.5, log=True)),
    "refine": _About("refinements", ""),
    "levels": _About("mesh levels", "", Range(0, 5)),
    "order": _About("norm order", "only 1", Range(1, 2)),
    "method": _About("method", "Eqs. 4 and 5, section 5"),
    "segments": _About("consecutive fields", "Eq. 6, section 5", Range(0, 40)),
    "gradient": _About("gradient", "Eqs. 7 and 9"),
    "substeps": _About("sub-steps n", "section 7", Range(1, 200, log=True)),
    "quadrature": _About("intervals k", "Eq. 9", Range(1, 50)),
    "memory": _About("memory", "section 7", Range(1, 100)),
    "max_displacement": _About("longest step", "", Range(0.01, 1, log=True)),
    "tolerance": _About("tolerance", "", Range(0, 0.1, log=True)),
    "preconditioner": _About("preconditioner", "section 7"),
}
"""Labels of the parameters by name, in the order in which they are drawn."""
_REMEDIES = {
    "alpha": "Decrease it if the target is missed, increase it if the field is rough.",
    "sigma": "Usually leave it at auto. Decrease it if the residual is too large, increase it if "
    "the field is rough. Half as large a relative σ gives about half the residual.",
    "beta": "Usually leave it at 0. Try 1e-4 if the edges of the target are blurred.",
    "tau": "Change the smoothness instead. Usually τ only rescales the speed.",
    "reach": "Increase it if the source shrinks in place instead of moving to the target.",
    "divergence": "Usually leave it at auto. Use 1 if areas must change much, more to preserve "
    "areas.",
    "iterations": "Increase it if the run ended at the iteration limit.",
    "sigma_unit": "Use relative, which works for functions of any scale and width.",
    "landmark_sigma": "Decrease it if landmark errors are too large, increase it if landmarks "
    "distort the map.",
    "cooling_stages": "Increase it if functions far apart do not reach each other.",
    "cooling_factor": "Decrease it if a new stage undoes the previous one.",
    "stage_iterations": "Increase it if the energy still decreases at the end of a stage.",
    "goal": "Decrease it if a match with verdict matched is not accurate enough.",
    "refine": "Increase it if the residual along flow lines is much larger. Use 0 to save time.",
    "levels": "Increase it if a large mesh takes long. Use 1 if coarse meshes lose thin parts.",
    "order": "2 gives continuous fields. 1 fits more closely, but flow lines may disagree.",
    "method": "Use nonlinear if the result is jagged.",
    "segments": "Use 1 for a single field. Increase it if one field does not reach the target or "
    "linearised steps produce noise.",
    "gradient": "Use adjoint, which is exact.",
    "substeps": "Increase it if the line search fails early.",
    "quadrature": "Increase it if the line search fails early.",
    "memory": "Increase it if convergence is slow, decrease it if memory runs out.",
    "max_displacement": "Decrease it if the field overshoots in the first iterations.",
    "tolerance": "Decrease it if the solver stops too early.",
    "preconditioner": "Use hodge, which is faster on all but the coarsest meshes.",
}
"""Advice on when to change a parameter, by its name; part of its tooltip."""
_CHOICES = CHOICES | {"refine": (AUTO, "0", "1", "2")}
_AUTO = {
    "sigma": Auto(
        LAST_SIGMA,
        "Use the smallest σ that passes verification. Untick it, or move the slider, to set σ.",
    ),
    "divergence": Auto(
        AREA_PRESERVING_DIVERGENCE,
        "Use 10 for functions that match exactly, and 1 for measured functions. Untick it, or move "
        "the slider, to set a value.",
    ),
}
_MAIN_PARAMETERS = ("alpha", "sigma", "beta", "tau", "reach")
_MASK = (
    "Weight of the mismatch at each vertex, 0 or more, given by a function. Examples: "
    "indicator:vertex=12,radius=0.3 or expression:x>0.\nEmpty: all vertices have the same weight. "
    "Not in the paper.\nBad result in one region? Give it more weight."
)


def draw(context: Context) -> None:
    ui, session = context.ui, context.session
    parameters = session.parameters
    _preset(ui, session)
    draw_help(context, *_MAIN_PARAMETERS, name="Explain parameters")
    for name in _MAIN_PARAMETERS:
        _control(ui, session, name)
    draw_switch(ui, session)
    with section(ui, "Advanced", False) as is_open:
        if is_open:
            unused = {"substeps", "quadrature"} if parameters.paper.gradient == "adjoint" else set()
            if parameters.paper.method == "linearised":
                unused = {"gradient", "substeps", "quadrature"}
            for name in [name for name in _PARAMETER_TEXTS if name not in _MAIN_PARAMETERS]:
                with ui.disabled(name in unused, "The chosen method and gradient do not use it."):
                    _control(ui, session, name)
            spec = ui.text("mask", session.document.mask, _MASK, hint="empty: equal weights")
            if spec is not None:
                with ui.refusals.refusing("mask"):
                    session.editor.set_mask(spec.strip())
            ui.refusal("mask", otherwise=session.work.error("mask"))
            tip = "Reset all parameters to their defaults."
            is_default = parameters == _DEFAULT_PARAMETERS
            with ui.disabled(is_default, "All parameters have their defaults."):
                if ui.button("Reset to defaults", tip, width=-1):
                    session.editor.reset_parameters()


def _preset(ui: Ui, session: Session) -> None:
    now, is_default = row_of(session.parameters), session.parameters == _DEFAULT_PARAMETERS
    shown = now.label if now else _DEFAULTS if is_default else _CUSTOM_VALUES
    rows = {row.label: row for row in TABLE_1.values()}
    tips = {_CUSTOM_VALUES: ""} if shown == _CUSTOM_VALUES else {}
    tips[_DEFAULTS] = "Recommended for most meshes and functions."
    tips |= {name: row.about for name, row in rows.items()}
    about = "Set all parameters: to the defaults, or to a row of the paper's Table 1."
    chosen = ui.combo("preset", shown, tips, f"{about}\n\n{tips[shown]}".strip())
    if chosen == shown:
        return
    if chosen == _DEFAULTS:
        session.editor.reset_parameters()
    elif chosen in rows:
        session.editor.set_parameter(label=f"preset {chosen}", **rows[chosen].values)


def _control(ui: Ui, session: Session, name: str) -> None:
    about, value = _PARAMETER_TEXTS[name], session.parameters.to_dict()[name]
    label, has_integers = f"{about.label}##{name}", is_integer(FIELDS[name])
    ends, tip = replace(about.slider, is_integer=has_integers), _tip(name)
    new: Any
    if name in _CHOICES:
        chosen = ui.combo(label, AUTO if value is None else str(value), _CHOICES[name], tip)
        new = int(chosen) if chosen.isdecimal() else chosen
        ui.refusal(name)
    else:
        new = ui.number_or_auto(label, value, ends, tip, _AUTO.get(name))
    if has_integers and isinstance(new, float) and new.is_integer():
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
    in_paper = ", ".join(filter(None, [symbol.strip("*"), about.place])) or "not used"
    return (
        f"{sentence(help)} Default: {shown}.\nIn the paper: {in_paper}.\n"
        f"In files and on the command line: {name}.\nBad result? {_REMEDIES[name]}"
    )
