"""The open table of batch or population results; the window shows one of its rows as a document."""

from __future__ import annotations

import time as clock
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import NamedTuple
from weakref import WeakKeyDictionary

import numpy as np

import abfm
from abfm.types import FloatArray
from abfm.wording import counted
from abfm_viewer.computing.background import Jobs, Latest, Memo
from abfm_viewer.document.comparison import Comparison, ComparisonKind
from abfm_viewer.document.document import Channel, Document, Identity, Surface
from abfm_viewer.document.kinds import SubjectDocument
from abfm_viewer.document.result_table import COLUMNS, Name, PopulationTable, ResultRow, ResultTable
from abfm_viewer.files.documents import Opened, read_document
from abfm_viewer.files.result_tables import POPULATION, TableReader
from abfm_viewer.session.functions import with_values
from abfm_viewer.session.loading import OPENING, Load
from abfm_viewer.session.session import Session

Key = tuple[int, str]
_REFRESH_SECONDS = 2.0  # between checks of the table's folder


class FoundTable(NamedTuple):
    reader: TableReader
    table: ResultTable
    row: ResultRow | None
    opened: Opened | None


def find_table(place: Path, kind: ComparisonKind = "difference") -> FoundTable:
    """Read a table of results, and open its worst row that can be shown."""
    reader = TableReader(place)
    table = reader.read()
    row = next(filter(table.can_show, table.shown("verdict", False, "")), None)
    opened = None if row is None else document_of_row(table, row, kind)
    return FoundTable(reader, table, row, opened)


def document_of_row(table: ResultTable, row: ResultRow, kind: ComparisonKind) -> Opened:
    """Return a document of a row: of its values on the template, if any, or of its result."""
    if isinstance(table, PopulationTable) and table.has_values(row):
        return document_of_subject(table, row, kind)
    return document_of_result(row)


def document_of_result(row: ResultRow) -> Opened:
    assert row.path is not None
    document, known = read_document(row.path)
    return row.label_document(document), known


def document_of_subject(table: PopulationTable, row: ResultRow, kind: ComparisonKind) -> Opened:
    """Return a document with a subject's functions on the template and the mean of the others.

    Missing values are interpolated from their surroundings and have weight 0. ``kind`` is the
    quantity by which the subject is compared with the other subjects.
    """
    found = table.population
    path = table.place / POPULATION if table.place.is_dir() else table.place
    known: dict[str, FloatArray] = {}

    def spec(column: str, values: FloatArray) -> str:
        text = str(abfm.functions.ValuesFile(path=str(path.absolute()), column=column))
        known[text] = values
        return text

    mask = np.asarray(found.masks[row.number] * found.template_mask)
    channels: dict[tuple[str, str], int] = {}
    listed, display_names = [], dict[str, str]()
    for number, channel in enumerate(found.channels):
        of_subject = found.values[row.number, :, number]
        mean = found.mean_of_others(row.number, number)
        is_known = np.isfinite(of_subject) & np.isfinite(mean)
        if not is_known.any():  # a held-out channel that the subject does not have
            continue
        if not channel.is_held_out:
            mask = np.where(is_known, mask, 0)
        columns = f"{row.name}: {channel.name}", f"without {row.name}: {channel.name}"
        source, target = (
            spec(column, _filled(found.template, values))
            for column, values in zip(columns, (of_subject, mean), strict=True)
        )
        channels[source, target] = number
        listed.append(Channel(source, target, weight=float(found.channel_weights[number])))
        display_names |= dict.fromkeys((source, target), channel.name)
    document = SubjectDocument(
        (Surface(found.template, f"{row.name} of {table.title}"),),
        tuple(listed),
        mask="" if (mask == 1).all() else spec(f"{row.name}: mask", mask),
        comparison=Comparison(found, row.number, channels, kind),
        display_names=display_names,
    )
    return document, known


def _filled(mesh: abfm.TriangleMesh, values: FloatArray) -> FloatArray:
    known = np.isfinite(values)
    if known.all():
        return np.array(values)
    from abfm.calculus.channels import extend

    return np.asarray(extend(mesh, np.where(known, values, 0), known))


class Tables:
    """Opens a table of results, reads it again when its folder changes, and shows its rows.

    ``load`` executes a `Load` in the background; its document replaces the current one.
    """

    def __init__(self, session: Session, load: Callable[[Load], None]) -> None:
        self.table: ResultTable | None = None
        self.column: Name = "verdict"  # by which rows are sorted
        self.falls = False  # whether rows are in descending order
        self.search = ""
        self.comparison_kind: ComparisonKind = "difference"  # how subjects are compared
        self.cursor: Key | None = None  # key of the selected row
        self.selected: tuple[Key, ...] = ()  # keys of several selected rows
        self.menu_cell = ""  # text of the cell on which a menu was opened
        self.is_comparing = False  # whether the selected rows are shown side by side
        self.has_keys = False  # whether the keys Up and Down move the cursor
        self.scrolls = False  # whether the selected row must be scrolled into view
        self._session, self._load = session, load
        self._jobs = Jobs(session.at_once)
        self._latest: Latest[ResultTable] = self._jobs.latest()
        self._reader: TableReader | None = None
        self._checks, self._next_check = 0, 0.0
        self._rows: Memo[tuple[ResultRow, ...]] = Memo()
        # place of the table and key of the row for documents that belong to a table
        self._rows_of: WeakKeyDictionary[Identity, tuple[Path, Key | None]] = WeakKeyDictionary()
        self._last_document: Identity | None = None

    @property
    def rows(self) -> tuple[ResultRow, ...]:
        if self.table is None:
            return ()
        of = self.column, self.falls, self.search
        return self._rows.get((self.table, *of), partial(self.table.shown, *of))

    @property
    def chosen(self) -> ResultRow | None:
        return None if self.table is None else self.table.find(self.cursor)

    @property
    def selection(self) -> tuple[ResultRow, ...]:
        """The selected rows in the order of the table: several, or that of the cursor."""
        keys = self.selected or (self.cursor,)
        return tuple(row for row in self.rows if row.key in keys)

    @property
    def error(self) -> str:
        """Reason why the table could not be read again; empty without an error."""
        return self._latest.error

    @property
    def is_of_document(self) -> bool:
        place, _ = self._rows_of.get(self._session.document.identity, (None, None))
        return self.table is not None and place == self.table.place

    @property
    def unshown_row(self) -> ResultRow | None:
        """The selected row if it has no result, so that another row is still shown; or None."""
        row = self.chosen if self.is_of_document else None
        can_show = row is None or self.table is None or self.table.can_show(row)
        return None if can_show else row

    @property
    def summary(self) -> str:
        """Text above the rows: count of verdicts, or that the selected row has no result."""
        if len(self.selection) > 1:
            return f"{len(self.selection)} of {counted(len(self.rows), 'row')} selected"
        if (row := self.unshown_row) is not None:
            return f"{row.name} has no result; {self._session.document.name} is still shown"
        return "" if self.table is None else f"{self.table.summary}; {self.table.title}"

    def attach_to(self, document: Document) -> None:
        """Keep the table open for a document that was made from the document of one of its rows."""
        if self.table is not None and self.is_of_document:
            self._rows_of[document.identity] = self.table.place, None

    def read(self, place: Path) -> Callable[[], None]:
        """Read a table, and return a function that shows it with its worst row."""
        return partial(self._show_found, find_table(place, self.comparison_kind))

    def _show_found(self, found: FoundTable) -> None:
        if found.row is not None and found.opened is not None:
            self._show(found.table, found.row, found.opened)
        self.take(found)
        self._session.notices.resolve(OPENING)
        self._session.notices.show(f"opened {found.table.title}: {found.table.summary}")

    def take(self, found: FoundTable) -> None:
        self.table, self._reader = found.table, found.reader
        self.column, self.falls, self.search = "verdict", False, ""
        self.cursor = None if found.row is None else found.row.key
        self.scrolls = self.has_keys = True
        self._next_check = clock.perf_counter() + _REFRESH_SECONDS
        self._last_document = self._session.document.identity
        self._rows_of[self._last_document] = found.table.place, self.cursor

    def close_table(self) -> None:
        self.table, self._reader, self.cursor, self.has_keys = None, None, None, False
        self.selected, self.is_comparing = (), False

    def select_also(self, row: ResultRow, is_range: bool = False) -> None:
        """Add a row to the selection or remove it, or add all rows from the cursor to this row."""
        keys = self.selected or ((self.cursor,) if self.cursor else ())
        if is_range:
            of_rows = [each.key for each in self.rows]
            ends = [of_rows.index(key) for key in (self.cursor, row.key) if key in of_rows]
            self.selected = tuple(of_rows[min(ends) : max(ends) + 1])
        elif row.key in keys:
            self.selected = tuple(key for key in keys if key != row.key)
        else:
            self.selected = (*keys, row.key)
        self.has_keys = True

    def sort(self, column: Name) -> None:
        """Sort by a column, numbers descending and texts ascending; a second call reverses."""
        if column == self.column:
            self.falls = not self.falls
        else:
            self.column, self.falls = column, bool(COLUMNS[column].digits)
        self.scrolls = True

    def refresh(self) -> None:
        """Read the table again at the next `update`."""
        self._next_check = 0.0

    def move(self, step: int) -> None:
        if not (rows := self.rows):
            return
        keys = [row.key for row in rows]
        place = keys.index(self.cursor) + step if self.cursor in keys else 0
        if (row := rows[min(max(place, 0), len(rows) - 1)]).key != self.cursor:
            self.scrolls = True
            self.choose(row)

    def choose(self, row: ResultRow) -> None:
        """Select a row and show its document; without a result, show a notice with the reason."""
        if self.table is None:
            return
        self.cursor, self.has_keys, self.selected = row.key, True, ()
        if self.table.can_show(row):
            self._open(row, partial(document_of_row, self.table, row, self.comparison_kind))
            return
        reason = row.facts.reason or "it has not been solved yet"
        text = f"{row.name} has no result: {reason}"
        self._session.notices.show(f"{text}; {self._session.document.name} is still shown")

    def open_result(self, row: ResultRow) -> None:
        """Show the result of a row; for a subject of a population, its match to the template."""
        self._open(row, partial(document_of_result, row))

    def compare(self, kind: ComparisonKind) -> None:
        self.comparison_kind = kind
        document = self._session.document
        if isinstance(document, SubjectDocument):
            other = replace(document.comparison, kind=kind)
            self._session.editor.change("change the comparison", comparison=other)

    def update(self) -> None:
        """Update the table from its folder, and select the row of the shown document."""
        if self._reader is None or self.table is None:
            return
        if (shown := self._session.document.identity) is not self._last_document:
            self._last_document = shown
            self.has_keys = self.has_keys and self.is_of_document
            self.cursor = self._key_of(shown)
            self.scrolls = True
        elif (
            self._session.loading.now is None
            and self.unshown_row is None
            and self.cursor is not None
        ):
            # opening another row may have been cancelled
            self.cursor = self._key_of(shown) or self.cursor
        now = clock.perf_counter()
        if now >= self._next_check and not self._latest.busy:
            self._checks, self._next_check = self._checks + 1, now + _REFRESH_SECONDS
        if self._checks:
            request = self._reader, self._checks
            found = self._latest.request(request, partial(self._reader.read, anew=False))
            if found is not None and found.place == self.table.place:
                self.table = found

    def close(self) -> None:
        self._jobs.close()

    def _key_of(self, shown: Identity) -> Key | None:
        place, key = self._rows_of.get(shown, (None, None))
        return key if self.table is not None and place == self.table.place else None

    def _open(self, row: ResultRow, make: Callable[[], Opened]) -> None:
        table = self.table
        assert table is not None
        show = partial(self._show, table, row)
        self._load(Load(f"opening {row.name}", lambda: partial(show, with_values(*make()))))

    def _show(self, table: ResultTable, row: ResultRow, opened: Opened) -> None:
        """Show the document of a row; on the same mesh, keep viewpoint and enlarged picture."""
        session, (document, known) = self._session, opened
        now, mesh = session.document.surfaces, document.surfaces[-1].mesh
        is_same = len(now) == len(document.surfaces) and now[-1].mesh.digest == mesh.digest
        viewpoint = session.view.viewpoint if is_same else None
        enlarged = session.view.enlarged if is_same else ""
        if is_same and isinstance(document, SubjectDocument):  # keep the active channel
            channel = min(session.document.channel, len(document.channels) - 1)
            document = replace(document, channel=channel)
        view = replace(session.view, viewpoint=viewpoint, enlarged=enlarged)
        if session.document.sequence_result is None:
            view = document.view_of_result(view)
        session.restore(replace(document, view=view), known, None)
        self._last_document = session.document.identity
        self._rows_of[self._last_document] = table.place, row.key
        self.cursor = row.key
        reason = f", {row.facts.reason}" if row.facts.reason else ""
        session.notices.show(f"{row.name}: {row.verdict}{reason}")
