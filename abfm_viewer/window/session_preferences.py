"""Preferences that a session contains: theme, UI scale and two switches."""

from dataclasses import replace

from abfm_viewer.files.preferences import PreferenceFile
from abfm_viewer.session.session import Session


class SessionPreferences:
    """Applies stored preferences to a session, and stores those that the user changes."""

    def __init__(self, session: Session, stored: PreferenceFile) -> None:
        self._session, self._stored, now = session, stored, stored.now
        session.matching.follow = now.follow
        view = session.view.with_appearance(theme=now.theme, ui_scale=now.ui_scale)
        view = replace(view, flow_after_match=now.flow_after_match)
        if view != session.view:
            session.editor.amend(view=view)
        self._latest, self._document = self._present(), session.document.identity

    def update(self) -> None:
        """Store the changes of this frame, except those by another document."""
        present, document = self._present(), self._session.document.identity
        if present != self._latest and document is self._document:
            self._stored.change(**present)
        self._latest, self._document = present, document

    def _present(self) -> dict[str, object]:
        view = self._session.view
        of_view = {name: getattr(view, name) for name in ("theme", "ui_scale", "flow_after_match")}
        return of_view | {"follow": self._session.matching.follow}
