"""The table of a batch or a population; a click on a row shows the result of this row."""

import numpy as np
import polyscope.imgui as imgui

from abfm.errors import brief
from abfm.outcome import Outcome
from abfm.types import FloatArray
from abfm.wording import counted
from abfm_viewer.computing.background import Memo
from abfm_viewer.document.comparison import ComparisonKind
from abfm_viewer.document.keyboard import hint
from abfm_viewer.document.result_table import COLUMNS, Name, ResultRow, ResultTable, as_text
from abfm_viewer.panels import row_comparison
from abfm_viewer.panels.context import Context
from abfm_viewer.panels.explanations import draw_help
from abfm_viewer.session.result_tables import Tables
from abfm_viewer.widgets.containers import is_mouse_in, menu_button, menu_item, window
from abfm_viewer.widgets.toolkit import Pushed, TextTone, Ui, close_by_escape
from abfm_viewer.widgets.widget_record import Rect

_COMPARISON_TIPS: dict[ComparisonKind, str] = {
    "difference": "The subject's values minus the mean of the others.",
    "mean": "Mean of the subjects, without outliers.",
    "deviation": "Standard deviation over the subjects, without outliers.",
    "areas": "Standard deviation of log2 J over the subjects, without outliers.",
}
_FLAGS = (
    imgui.ImGuiTableFlags_Resizable
    | imgui.ImGuiTableFlags_ScrollY
    | imgui.ImGuiTableFlags_BordersInnerV
    | imgui.ImGuiTableFlags_BordersOuter
    | imgui.ImGuiTableFlags_NoSavedSettings
    | imgui.ImGuiTableFlags_SizingStretchProp
)
_WEIGHTS: dict[Name, float] = {"name": 2.0, "reason": 4.0}
# lengths at a scale of 1
_TEXT_WIDTH_MIN: dict[Name, float] = {"name": 110, "reason": 180}
_ARROW_WIDTH = 14
_COMPARE_WIDTH = 110
_WIDEST_NUMBER = "100.00%"
_SPARE_COLUMNS: tuple[Name, ...] = (
    "folded",
    "log2_area",
    "verified_residual",
    "residual",
    "reason",
)
"""Columns that are hidden in a narrow table, in this order; the tooltip of a row shows them."""
_HINT = "in names and reasons"
_REFRESH_TIP = "Read the folder now. It is also checked every two seconds."
_COMPARE_TIP = (
    "Show the selected rows side by side, with pictures if a batch has drawn them. Ctrl+click "
    "and Shift+click select several rows."
)
_CLOSE_TIP = "Close the table. The surfaces stay the same."
_MARGIN_ROWS = 3  # number of rows drawn above and below the visible rows
_ENDS = Memo[FloatArray]()
# height in pixels at a scale of 1, and its maximum share of the height of surfaces and table
_HEIGHT = 236
_HEIGHT_SHARE = 0.4
_HEIGHT_MIN = 130


def height(available: float, scale: float) -> float:
    """Return the height of the table, which shares ``available`` pixels with the surfaces."""
    share = _HEIGHT_SHARE * available
    return max(min(_HEIGHT * scale, share), min(_HEIGHT_MIN * scale, available / 2))


def draw(context: Context, rect: Rect) -> None:
    ui, tables = context.ui, context.files.tables
    if imgui.IsMouseClicked(0) and context.ui.record.enabled:
        tables.has_keys = is_mouse_in(rect)
    with window(ui, "result table", rect), ui.group("table"):
        _draw_line(context, tables)
        draw_help(context, "quality columns")
        rows = tables.selection
        tables.is_comparing = tables.is_comparing and len(rows) > 1
        if tables.table is not None and tables.is_comparing:
            row_comparison.draw(context, rows, imgui.GetContentRegionAvail())
        elif tables.table is not None:
            _draw_rows(context, tables)


def shown_columns(context: Context, table: ResultTable) -> tuple[Name, ...]:
    """Return the columns that the user chose for this kind of table, by default all of them."""
    chosen = context.preferences.now.columns.get(table.noun, table.columns)
    return tuple(name for name in table.columns if name == "name" or name in chosen)


def _menu(context: Context, tables: Tables, cell: str = "") -> None:
    """Draw the entries of the menu of the table; ``cell`` is the text of the cell below it."""
    ui, table = context.ui, tables.table
    assert table is not None
    columns = shown_columns(context, table)
    if cell and menu_item(ui, "Copy cell"):
        imgui.SetClipboardText(cell)
    if menu_item(ui, "Copy rows", hint("copy rows"), enabled=bool(tables.selection)):
        copy_rows(context)
    if menu_item(ui, "Copy table"):
        imgui.SetClipboardText(as_text(columns, tables.rows))
    imgui.Separator()
    for name in table.columns[1:]:
        if menu_item(ui, COLUMNS[name].head, checked=name in columns):
            chosen = tuple(each for each in table.columns if each in {*columns} ^ {name})
            stored = context.preferences.now.columns
            context.preferences.change(columns={**stored, table.noun: chosen})


def copy_rows(context: Context) -> None:
    """Copy the selected rows as text to the clipboard."""
    tables = context.files.tables
    if tables.table is not None and tables.selection:
        columns = shown_columns(context, tables.table)
        imgui.SetClipboardText(as_text(columns, tables.selection))


def _draw_line(context: Context, tables: Tables) -> None:
    ui, table = context.ui, tables.table
    assert table is not None
    compare = "Back to rows" if tables.is_comparing else "Compare rows"
    buttons = (compare, "Refresh", "Close table")
    taken = sum(ui.text_width(label) + ui.px(26) for label in buttons) + ui.px(40)
    search = ui.text_width(_HINT) + 2 * imgui.GetStyle().FramePadding[0] + ui.px(2)
    taken += search + ui.text_width("search") + ui.px(16)
    if table.has_comparisons:
        taken += ui.px(_COMPARE_WIDTH) + ui.text_width("compareRegistration") + ui.px(50)
    ui.align()
    room = float(imgui.GetContentRegionAvail()[0]) - taken
    kind: TextTone = "failure" if tables.error or tables.unshown_row else "ink"
    text = tables.error or tables.summary
    if ui.text_width(text) <= room:
        ui.line(text, kind, room=room)
        ui.same_line()
    else:
        ui.note(text, kind)
    tables.search = ui.live_text("search", tables.search, _HINT, width=search)
    if table.has_comparisons:
        ui.same_line_if_fits("compare", is_button=True)
        tip = "Quantity shown between the subject and the mean of the others."
        what = ui.combo(
            "compare", tables.comparison_kind, _COMPARISON_TIPS, tip, width=ui.px(_COMPARE_WIDTH)
        )
        if what != tables.comparison_kind:
            tables.compare(what)
        row = tables.chosen
        tip = "Show the selected subject on its surface, with the flow that registers it."
        ui.same_line_if_fits("Registration", is_button=True)
        enabled = row is not None and row.path is not None
        if ui.button("Registration", tip, enabled=enabled) and row is not None:
            tables.open_result(row)
    ui.same_line_if_fits(compare, is_button=True)
    is_several = len(tables.selection) > 1
    if ui.button(f"{compare}##Compare rows", _COMPARE_TIP, enabled=is_several):
        tables.is_comparing = not tables.is_comparing
    ui.same_line_if_fits("", width=imgui.GetFrameHeight())
    with menu_button(ui, "table options", "Choose columns, or copy rows.", True) as is_open:
        if is_open:
            _menu(context, tables)
    ends = (
        ("Refresh", _REFRESH_TIP, tables.refresh),
        ("Close table", _CLOSE_TIP, tables.close_table),
    )
    for label, tip, act in ends:
        ui.same_line_if_fits(label, is_button=True)
        if ui.button(label, tip):
            act()


def _draw_rows(context: Context, tables: Tables) -> None:
    ui, table, rows = context.ui, tables.table, tables.rows
    assert table is not None
    left, top = imgui.GetCursorScreenPos()
    width, high = imgui.GetContentRegionAvail()
    columns = _fitting(ui, shown_columns(context, table), width)
    # without matching rows, draw only the headings, and the message below them
    has_no_match = not rows and bool(tables.search.strip())
    border, room = 2.0, 0.0 if has_no_match else high
    # as high as the headings and the complete rows that fit
    size = 0.0, _row_height() * max((room - border) // _row_height(), 1.0) + border
    if not imgui.BeginTable(f"rows of {columns}", len(columns), _FLAGS, size):
        return
    try:
        with ui.record.within("rows", (left, top, left + width, top + high)):
            width = _draw_heads(ui, tables, columns)
            is_menu = imgui.IsMouseClicked(1) and imgui.IsWindowHovered() and ui.record.enabled
            tables.menu_cell = "" if is_menu else tables.menu_cell
            _draw_cells(ui, tables, columns, (rows, _ends(rows, width)))
            if is_menu:
                imgui.OpenPopup("cell")
        if imgui.BeginPopup("cell"):
            with ui.record.within("cell", ui.record.areas[0]):
                _menu(context, tables, tables.menu_cell)
            close_by_escape()
            imgui.EndPopup()
    finally:
        imgui.EndTable()
    if has_no_match:
        all_rows = counted(len(table.rows), table.noun)
        message = f"no match for {brief(tables.search.strip())} among {all_rows}"
        ui.line(message, "ink", room=width)


def _row_height() -> float:
    return float(imgui.GetTextLineHeight()) + 2 * float(imgui.GetStyle().CellPadding[1])


def _fitting(ui: Ui, columns: tuple[Name, ...], width: float) -> tuple[Name, ...]:
    """Return the columns that fit into a width in pixels; less important columns are omitted."""
    style = imgui.GetStyle()
    padding = 2 * style.CellPadding[0] + 1
    for column in (None, *_SPARE_COLUMNS):
        columns = tuple(each for each in columns if each != column)
        widths = [
            ui.px(_TEXT_WIDTH_MIN[each]) if each in _TEXT_WIDTH_MIN else _width(ui, each)
            for each in columns
        ]
        if sum(widths) + padding * len(widths) + style.ScrollbarSize <= width:
            break
    return columns


def _width(ui: Ui, column: Name) -> float:
    texts = tuple(Outcome) if column == "verdict" else (_WIDEST_NUMBER,)
    head = ui.text_width(COLUMNS[column].head) + ui.px(_ARROW_WIDTH)
    return max(head, *map(ui.text_width, texts))


def _ends(rows: tuple[ResultRow, ...], width: float) -> FloatArray:
    """Return the position of the lower end of each row, (n,), in pixels.

    The reasons in the rows wrap at ``width`` pixels, or are hidden if it is 0.
    """
    line, padding = float(imgui.GetTextLineHeight()), _row_height() - imgui.GetTextLineHeight()

    def make() -> FloatArray:
        reasons = (row.facts.reason if width else "" for row in rows)
        heights = [float(imgui.CalcTextSize(each, False, width)[1]) for each in reasons]
        return np.cumsum([max(height, line) + padding for height in heights])

    return _ENDS.get((rows, round(width), line, padding), make)


def _draw_heads(ui: Ui, tables: Tables, columns: tuple[Name, ...]) -> float:
    """Draw the headings; return the width in pixels of the column of reasons, 0 if it is hidden."""
    width = 0.0
    for column in columns:
        if column in _WEIGHTS:
            flags, size = imgui.ImGuiTableColumnFlags_WidthStretch, _WEIGHTS[column]
        else:
            flags = imgui.ImGuiTableColumnFlags_WidthFixed
            size = _width(ui, column)
        imgui.TableSetupColumn(COLUMNS[column].head, flags, size)
    imgui.TableSetupScrollFreeze(0, 1)
    imgui.TableNextRow(imgui.ImGuiTableRowFlags_Headers)
    for place, column in enumerate(columns):
        head, tip, _ = COLUMNS[column]
        imgui.TableSetColumnIndex(place)
        if column == "reason":
            width = float(imgui.GetContentRegionAvail()[0])
        with Pushed({imgui.ImGuiCol_Text: ui.colors.muted}):
            imgui.TableHeader(head)
        clicked = imgui.IsItemClicked(0) and ui.record.enabled
        is_sorted = column == tables.column
        text = ("falls" if tables.falls else "rises") if is_sorted else ""
        ui.record_item(head, "item", text=text, tip=tip)
        ui.tip(tip)
        if is_sorted:
            ui.sort_arrow(tables.falls)
        if clicked:
            tables.sort(column)
    return width


Rows = tuple[tuple[ResultRow, ...], FloatArray]
"""Rows, and the positions of their lower ends, (n,), in pixels below the headings."""


def _draw_cells(ui: Ui, tables: Tables, columns: tuple[Name, ...], placed: Rows) -> None:
    """Draw the visible rows, and leave empty space in place of the other rows."""
    rows, ends = placed
    visible = imgui.GetWindowHeight() - _row_height()  # height below the headings
    if tables.scrolls:
        _scroll(tables, placed, visible)
    top = imgui.GetScrollY()
    first = max(int(np.searchsorted(ends, top)) - _MARGIN_ROWS, 0)
    last = min(int(np.searchsorted(ends, top + visible)) + _MARGIN_ROWS + 1, len(rows))
    starts = np.concatenate([[0.0], ends])
    if first:
        imgui.TableNextRow(imgui.ImGuiTableRowFlags_None, starts[first])
    for number in range(first, last):
        high = float(starts[number + 1] - starts[number])
        imgui.TableNextRow(imgui.ImGuiTableRowFlags_None, high)
        _draw_row(ui, tables, columns, (rows[number], high))
    if last < len(rows):
        imgui.TableNextRow(imgui.ImGuiTableRowFlags_None, starts[-1] - starts[last])


def _scroll(tables: Tables, placed: Rows, visible: float) -> None:
    tables.scrolls = False
    rows, ends = placed
    keys = [row.key for row in rows]
    if tables.cursor not in keys:
        return
    number, now = keys.index(tables.cursor), imgui.GetScrollY()
    top = float(ends[number - 1]) if number else 0.0
    if not now <= top <= float(ends[number]) <= now + visible:
        imgui.SetScrollY(max(top - visible / 2, 0.0))


def _draw_row(
    ui: Ui, tables: Tables, columns: tuple[Name, ...], placed: tuple[ResultRow, float]
) -> None:
    row, high = placed
    is_chosen, padding = row in tables.selection, _row_height() - imgui.GetTextLineHeight()
    flags, is_hovered = imgui.ImGuiSelectableFlags_SpanAllColumns, False
    for place, column in enumerate(columns):
        imgui.TableSetColumnIndex(place)
        text, room = row.cell_text(column), float(imgui.GetContentRegionAvail()[0])
        left = imgui.GetCursorScreenPos()[0]
        if column == "name":
            shown = ui.fitted(text, room).replace("##", "# #")  # ImGui hides text after ##
            clicked = imgui.Selectable(
                f"{shown}###{row.number}", is_chosen, flags, (0, high - padding)
            )
            state = "chosen" if is_chosen else ""
            hidden = (each for each in _SPARE_COLUMNS[::-1] if each not in columns)
            numbers = [
                f"{COLUMNS[each].head} {value}"
                for each in hidden
                if COLUMNS[each].digits and (value := row.cell_text(each))
            ]
            parts = (
                f"{row.name}: {row.verdict}",
                ", ".join(numbers),
                row.facts.reason,
                *row.facts.warnings,
            )
            tip = "\n\n".join(filter(None, parts))
            ui.record_item(row.name, "choice", text=state, tip=tip)
            ui.tip(tip)
            io, is_hovered = imgui.GetIO(), bool(imgui.IsItemHovered())
            if clicked and ui.record.enabled:
                if io.KeyCtrl or io.KeyShift:
                    tables.select_also(row, is_range=io.KeyShift)
                else:
                    tables.choose(row)
        if is_hovered and imgui.IsMouseClicked(1) and left <= imgui.GetMousePos()[0] < left + room:
            tables.menu_cell = text
        if column == "name":
            continue
        if COLUMNS[column].digits:
            spare = room - ui.text_width(text)
            imgui.SetCursorPosX(imgui.GetCursorPosX() + max(spare, 0.0))
        color = getattr(ui.colors, row.facts.tone) if column == "verdict" else ui.colors.ink
        if column == "reason":
            ui.note(text, "ink")
            continue
        with Pushed({imgui.ImGuiCol_Text: color}):
            imgui.TextUnformatted(ui.fitted(text, room))
