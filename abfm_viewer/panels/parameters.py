"""Parameters of the match."""

from __future__ import annotations

from abfm import ParameterError
from abfm_viewer.session import Session
from abfm_viewer.ui import Ui

_RANGES = {"alpha": (1e-4, 1e2), "sigma": (1e-4, 1.0), "tau": (0.1, 10.0)}


def draw(ui: Ui, session: Session) -> None:
    """Draw sliders."""
    for name, (low, high) in _RANGES.items():
        value = ui.number(name, getattr(session.parameters, name), low, high, log=True)
        if value is not None:
            try:
                session.set_parameter(name, **{name: value})
                ui.refuse(name, "")
            except ParameterError as error:
                ui.refuse(name, str(error))
