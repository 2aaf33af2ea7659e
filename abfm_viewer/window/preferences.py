"""What the user set and finds again at the next launch."""

from dataclasses import replace

from abfm_viewer.document.document import THEMES
from abfm_viewer.files.state_folder import StateFolder
from abfm_viewer.session.session import Session

_LEAST_SCALE, _LARGEST_SCALE = 0.5, 4.0


class Preferences:
    """Keeps a session's theme, size and ways in the state folder."""

    def __init__(self, session: Session, state: StateFolder) -> None:
        self._session = session
        self._state = state
        self._apply()
        self._latest, self._mesh = self._present(), session.mesh

    def update(self) -> None:
        """Remember what the user changed: call once per frame; a project that is opened may look otherwise."""
        present, mesh = self._present(), self._session.mesh
        for name, value in present.items():
            if self._latest[name] != value and mesh is self._mesh:
                self._state.set_preference(name, value)
        self._latest, self._mesh = present, mesh

    def _apply(self) -> None:
        """Set what the user set last, unless a project brings a look of its own; what makes no sense is left out."""
        session, known = self._session, self._state.preferences()
        theme, scale, follow, flow = (known.get(n) for n in ("theme", "ui_scale", "follow", "flow_after_match"))
        view = replace(session.view, ui_scale=1.0)
        if theme in THEMES and session.path is None:
            view = replace(view, theme=theme)
        if isinstance(scale, int | float) and _LEAST_SCALE <= scale <= _LARGEST_SCALE:
            view = replace(view, ui_scale=float(scale))
        if isinstance(flow, bool):
            view = replace(view, flow_after_match=flow)
        if isinstance(follow, bool):
            session.solver.follow = follow
        if view != session.view:
            session.amend(view=view)

    def _present(self) -> dict[str, object]:
        view = self._session.view
        look = {name: getattr(view, name) for name in ("theme", "ui_scale", "flow_after_match")}
        return look | {"follow": self._session.solver.follow}
