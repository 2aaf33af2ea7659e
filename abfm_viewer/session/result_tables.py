"""The table that is open beside the surfaces, and which of its rows they show."""

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
from abfm_viewer.computing.background import Jobs, Latest, Memo
from abfm_viewer.document.comparison import Comparison, ComparisonKind
from abfm_viewer.document.document import Channel, Document, Identity, Surface
from abfm_viewer.document.kinds import SubjectDocument
from abfm_viewer.document.result_table import COLUMNS, Name, PopulationTable, ResultRow, ResultTable
from abfm_viewer.files.documents import Opened, read_document
from abfm_viewer.files.result_tables import POPULATION, TableReader
from abfm_viewer.session.loading import OPENING, Load
from abfm_viewer.session.session import Session

Key = tuple[int, str]
_SECONDS = 2.0  # after which a table is looked at again


class FoundTable(NamedTuple):
    """A table that was read, and the first of its rows that has a result."""

    reader: TableReader
    table: ResultTable
    row: ResultRow | None
    opened: Opened | None


def find_table(place: Path, what: ComparisonKind = "difference") -> FoundTable:
    """Read a table, and its worst row that has a result; AbfmError if it is none."""
    reader = TableReader(place)
    table = reader.read()
    row = next(filter(table.can_show, table.shown("verdict", False, "")), None)
    opened = None if row is None else document_of_row(table, row, what)
    return FoundTable(reader, table, row, opened)


def document_of_row(table: ResultTable, row: ResultRow, what: ComparisonKind) -> Opened:
    """Return what is shown of a row: a subject's values on the template, or else its result."""
    if isinstance(table, PopulationTable) and table.has_values(row):
        return document_of_subject(table, row, what)
    return document_of_result(row)


def document_of_result(row: ResultRow) -> Opened:
    """Return a row's result as its file opens, called by the row's name."""
    assert row.path is not None
    document, known = read_document(row.path)
    return row.label_document(document), known


def document_of_subject(table: PopulationTable, row: ResultRow, what: ComparisonKind) -> Opened:
    """Return a subject's functions as they were carried to the template, beside the mean of the
    others; where they are unknown they are filled in from around, and do not count.
    """
    found = table.population
    path = table.place / POPULATION if table.place.is_dir() else table.place
    known: dict[str, FloatArray] = {}

    def spec(column: str, values: FloatArray) -> str:
        text = str(abfm.functions.ValuesFile(path=str(path.absolute()), column=column))
        known[text] = values
        return text

    counts = np.asarray(found.masks[row.number] * found.template_mask)
    channels: dict[tuple[str, str], int] = {}
    listed, called = [], dict[str, str]()
    for number, channel in enumerate(found.channels):
        own = found.values[row.number, :, number]
        mean = found.mean_of_others(row.number, number)
        is_known = np.isfinite(own) & np.isfinite(mean)
        if not is_known.any():  # a channel that is held out and that it does not have
            continue
        if not channel.is_held_out:
            counts = np.where(is_known, counts, 0)
        columns = f"{row.name}: {channel.name}", f"without {row.name}: {channel.name}"
        source, target = (
            spec(column, _filled(found.template, values))
            for column, values in zip(columns, (own, mean), strict=True)
        )
        channels[source, target] = number
        listed.append(Channel(source, target, weight=float(found.channel_weights[number])))
        called |= dict.fromkeys((source, target), channel.name)
    document = SubjectDocument(
        (Surface(found.template, f"{row.name} of {table.title}"),),
        tuple(listed),
        mask="" if (counts == 1).all() else spec(f"{row.name}: mask", counts),
        comparison=Comparison(found, row.number, channels, what),
        display_names=called,
    )
    return document, known


def _filled(mesh: abfm.TriangleMesh, values: FloatArray) -> FloatArray:
    known = np.isfinite(values)
    if known.all():
        return np.array(values)
    from abfm.calculus.channels import extend

    return np.asarray(extend(mesh, np.where(known, values, 0), known))


class Tables:
    """Opens a table, keeps it as its folder is, and shows its rows.

    `load` takes what is to be read in the background and takes the document's place. `cursor` is
    the row that was chosen; `has_keys` whether Up and Down move it.
    """

    def __init__(self, session: Session, load: Callable[[Load], None]) -> None:
        self.table: ResultTable | None = None
        self.column: Name = "verdict"
        self.falls = False
        self.search = ""
        self.comparison_kind: ComparisonKind = "difference"
        self.cursor: Key | None = None
        self.has_keys = False
        self.scrolls = False  # whether the cursor's row must come into view
        self._session, self._load = session, load
        self._jobs = Jobs(session.at_once)
        self._latest: Latest[ResultTable] = self._jobs.latest()
        self._reader: TableReader | None = None
        self._looks, self._next = 0, 0.0
        self._rows: Memo[tuple[ResultRow, ...]] = Memo()
        # of documents that a table is beside: its place, and which row they are of
        self._rows_of: WeakKeyDictionary[Identity, tuple[Path, Key | None]] = WeakKeyDictionary()
        self._seen: Identity | None = None

    @property
    def rows(self) -> tuple[ResultRow, ...]:
        """Those that are searched for, as they are sorted."""
        if self.table is None:
            return ()
        of = self.column, self.falls, self.search
        return self._rows.get((self.table, *of), partial(self.table.shown, *of))

    @property
    def chosen(self) -> ResultRow | None:
        return None if self.table is None else self.table.find(self.cursor)

    @property
    def error(self) -> str:
        """Say why the table cannot be read again."""
        return self._latest.error

    @property
    def is_of_document(self) -> bool:
        """Whether the table is of what the surfaces show, and not of another document."""
        place, _ = self._rows_of.get(self._session.document.identity, (None, None))
        return self.table is not None and place == self.table.place

    @property
    def unshown_row(self) -> ResultRow | None:
        """The chosen row, if it has no result, so that the surfaces show something else."""
        row = self.chosen if self.is_of_document else None
        is_shown = row is None or self.table is None or self.table.can_show(row)
        return None if is_shown else row

    @property
    def summary(self) -> str:
        """What is said above the rows: that the chosen one is not shown, or what all came to."""
        if (row := self.unshown_row) is not None:
            return f"{row.name} has no result: {self._session.document.name} is still shown"
        return "" if self.table is None else f"{self.table.summary}; {self.table.title}"

    def attach_to(self, document: Document) -> None:
        """Keep the table beside what was made of the document that it is beside."""
        if self.table is not None and self.is_of_document:
            self._rows_of[document.identity] = self.table.place, None

    def read(self, place: Path) -> Callable[[], None]:
        """Read a table; what is returned shows it with the worst of its rows that has a result."""
        return partial(self._show_found, find_table(place, self.comparison_kind))

    def _show_found(self, found: FoundTable) -> None:
        if found.row is not None and found.opened is not None:
            self._show(found.table, found.row, found.opened)
        self.take(found)
        self._session.notices.resolve(OPENING)
        self._session.notices.show(f"opened {found.table.title}: {found.table.summary}")

    def take(self, found: FoundTable) -> None:
        """Begin with a table whose row is shown already."""
        self.table, self._reader = found.table, found.reader
        self.column, self.falls, self.search = "verdict", False, ""
        self.cursor = None if found.row is None else found.row.key
        self.scrolls = self.has_keys = True
        self._next = clock.perf_counter() + _SECONDS
        self._seen = self._session.document.identity
        self._rows_of[self._seen] = found.table.place, self.cursor

    def close_table(self) -> None:
        """Take the table away; what the surfaces show stays."""
        self.table, self._reader, self.cursor, self.has_keys = None, None, None, False

    def sort(self, column: Name) -> None:
        """Sort by a column, or the other way round; of numbers the largest come first."""
        if column == self.column:
            self.falls = not self.falls
        else:
            self.column, self.falls = column, bool(COLUMNS[column].digits)
        self.scrolls = True

    def refresh(self) -> None:
        """Read the table anew."""
        self._next = 0.0

    def move(self, step: int) -> None:
        """Show the row so many below the chosen one."""
        if not (rows := self.rows):
            return
        keys = [row.key for row in rows]
        place = keys.index(self.cursor) + step if self.cursor in keys else 0
        if (row := rows[min(max(place, 0), len(rows) - 1)]).key != self.cursor:
            self.scrolls = True
            self.choose(row)

    def choose(self, row: ResultRow) -> None:
        """Show what there is of a row, or say why there is nothing."""
        if self.table is None:
            return
        self.cursor, self.has_keys = row.key, True
        if self.table.can_show(row):
            self._open(row, partial(document_of_row, self.table, row, self.comparison_kind))
            return
        reason = row.facts.reason or "it has not been solved yet"
        text = f"{row.name} has no result to show: {reason}"
        self._session.notices.show(f"{text}; {self._session.document.name} is still shown")

    def open_result(self, row: ResultRow) -> None:
        """Show the result of a row that has one: of a subject its registration."""
        self._open(row, partial(document_of_result, row))

    def compare(self, what: ComparisonKind) -> None:
        """Hold the subject that is shown, and those that are chosen later, against something."""
        self.comparison_kind = what
        document = self._session.document
        if isinstance(document, SubjectDocument):
            other = replace(document.comparison, kind=what)
            self._session.editor.change(f"compare with the {what}", comparison=other)

    def update(self) -> None:
        """Take in what has changed in the folder, and which document is shown: once per frame."""
        if self._reader is None or self.table is None:
            return
        if (shown := self._session.document.identity) is not self._seen:
            self._seen = shown
            self.has_keys = self.has_keys and self.is_of_document
            self.cursor = self._key_of(shown)
            self.scrolls = True
        elif (
            self._session.loading.now is None
            and self.unshown_row is None
            and self.cursor is not None
        ):
            # another one may have been chosen, which was not opened after all
            self.cursor = self._key_of(shown) or self.cursor
        if clock.perf_counter() >= self._next and not self._latest.busy:
            self._looks, self._next = self._looks + 1, clock.perf_counter() + _SECONDS
        if self._looks:
            asked = self._reader, self._looks
            found = self._latest.ask(asked, partial(self._reader.read, anew=False))
            if found is not None and found.place == self.table.place:
                self.table = found

    def close(self) -> None:
        self._jobs.close()

    def _key_of(self, shown: Identity) -> Key | None:
        """Return which row of the table a document is of."""
        place, key = self._rows_of.get(shown, (None, None))
        return key if self.table is not None and place == self.table.place else None

    def _open(self, row: ResultRow, make: Callable[[], Opened]) -> None:
        table = self.table
        assert table is not None
        show = partial(self._show, table, row)
        self._load(Load(f"opening {row.name}", lambda: partial(show, make())))

    def _show(self, table: ResultTable, row: ResultRow, opened: Opened) -> None:
        """Show a row's document, as the one before was looked at where it is on the same mesh."""
        session, (document, known) = self._session, opened
        now, mesh = session.document.surfaces, document.surfaces[-1].mesh
        is_same = len(now) == len(document.surfaces) and now[-1].mesh.digest == mesh.digest
        viewpoint = session.view.viewpoint if is_same else None
        enlarged = session.view.enlarged if is_same else ""
        if is_same and isinstance(document, SubjectDocument):  # the same channel as before
            channel = min(session.document.channel, len(document.channels) - 1)
            document = replace(document, channel=channel)
        view = replace(session.view, viewpoint=viewpoint, enlarged=enlarged)
        if session.document.sequence_result is None:
            view = document.view_of_result(view)
        session.restore(replace(document, view=view), known, None)
        self._seen = session.document.identity
        self._rows_of[self._seen] = table.place, row.key
        self.cursor = row.key
        reason = f", {row.facts.reason}" if row.facts.reason else ""
        session.notices.show(f"{row.name}: {row.verdict}{reason}")
