"""Preferences of the user, which all documents and launches share."""

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field, fields, replace
from typing import Annotated, Any, TypeVar, get_type_hints

from abfm_viewer.document.document import Range, Theme
from abfm_viewer.files.project import value_of
from abfm_viewer.files.state_folder import StateFolder

_FILE = "preferences.json"
Settings = TypeVar("Settings", bound=Any)


@dataclass(frozen=True)
class Preferences:
    """All preferences, with the values of the first launch."""

    theme: Theme = "light"
    ui_scale: Annotated[float, Range(0.5, 4)] = 1.0
    follow: bool = True  # whether changes of the problem restart a run
    flow_after_match: bool = True
    tour_seen: bool = False
    native_dialogs: bool = True  # whether to use the file dialogs of the system
    # recent folders by the kind of file, the latest first
    folders: dict[str, tuple[str, ...]] = field(default_factory=dict)
    export: dict[str, Any] = field(default_factory=dict)  # last settings, by their names
    columns: dict[str, tuple[str, ...]] = field(default_factory=dict)  # shown ones, by the table


class PreferenceFile:
    """The preferences of the user, stored as JSON in the state folder.

    Values that are missing or damaged have their defaults. Without a folder, changes last until the
    program ends.
    """

    def __init__(self, state: StateFolder | None) -> None:
        self._state = state
        self.now = with_stored(Preferences(), state.read(_FILE, dict) if state else {})

    def change(self, **values: Any) -> None:
        """Set preferences by their names, and store those that differ."""
        changed = {
            name: value for name, value in values.items() if getattr(self.now, name) != value
        }
        if changed:
            self.now = replace(self.now, **changed)
            if self._state:  # another window may have changed other preferences
                self._state.write(_FILE, self._state.read(_FILE, dict) | changed)


def with_stored(settings: Settings, stored: Mapping[str, Any]) -> Settings:
    """Return settings (a dataclass) with stored values; invalid values have no effect."""
    hints = get_type_hints(type(settings), include_extras=True)
    for name in [one.name for one in fields(settings) if one.name in stored]:
        with suppress(ValueError):
            value = value_of(hints[name], stored[name], name)
            settings = replace(settings, **{name: value})
    return settings
