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
        self._latest, self._document = self._present(), session.document.identity

    def update(self) -> None:
        """Remember what the user changed in this frame, but not what a project brings."""
        present, document = self._present(), self._session.document.identity
        for name, value in present.items():
            if self._latest[name] != value and document is self._document:
                self._state.set_preference(name, value)
        self._latest, self._document = present, document

    def _apply(self) -> None:
        """Set what the user set last, as far as it makes sense and no project brings its own."""
        session, known = self._session, self._state.preferences()
        names = ("theme", "ui_scale", "follow", "flow_after_match")
        theme, scale, follow, flow = map(known.get, names)
        view = replace(session.view, ui_scale=1.0)
        if theme in THEMES and session.saves.path is None:
            view = replace(view, theme=theme)
        if isinstance(scale, int | float) and _LEAST_SCALE <= scale <= _LARGEST_SCALE:
            view = replace(view, ui_scale=float(scale))
        if isinstance(flow, bool):
            view = replace(view, flow_after_match=flow)
        if isinstance(follow, bool):
            session.solver.follow = follow
        if view != session.view:
            session.editor.amend(view=view)

    def _present(self) -> dict[str, object]:
        view = self._session.view
        look = {name: getattr(view, name) for name in ("theme", "ui_scale", "flow_after_match")}
        return look | {"follow": self._session.solver.follow}
