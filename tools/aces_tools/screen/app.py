"""The live screen itself: what is received, shown ten times a second.

1. It receives and never sends: it has an inbox and looks at a gate's state; it knows no way to send.
2. One thread: between two pictures the inbox is emptied into the model, in pieces, so that keys are answered in between.
3. Only the lines that are seen are painted.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from typing import Any, ClassVar, Protocol

from rich.segment import Segment
from rich.style import Style
from textual.app import App, ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Container, VerticalScroll
from textual.events import Click, Resize
from textual.geometry import Size
from textual.screen import ModalScreen
from textual.scroll_view import ScrollView
from textual.strip import Strip
from textual.widget import Widget
from textual.widgets import Footer, Input, Static

from .head import Line, Status, detail, head, plain_text
from .model import Model, Place, RepeatedFrame
from .paint import Needs, StyledText, TableColumn, line, styles, title, visible_columns
from .view import View

#: Pictures a second, and of them those in which the details are made anew: each second one.
PICTURES = 10
#: Frames that are counted before keys are looked at again.
PIECE = 2048
#: From this width on, the details stand beside the table.
WIDE = 150
#: How wide rows are is looked at again so often.
MEASURE_NS = 1_000_000_000

#: Backgrounds: of the table, of the lines above it, of the details, of the selected row; and lines between them.
GROUND, BAND, PANE, CURSOR, EDGE = "#11161d", "#1a222d", "#141b24", "#243244", "#4a5568"

HELP = """\
[b]Keys[/b]
  d enter  details: every field, curves, bits, layout;
           J K or shift with the arrows scroll them
  /        filter: words that a row must have (enc can0, board=3),
           or candump's filters (060:7F0, can0,150~7FF); Esc ends it
  s S      sort: identifier, rate, name, last change; reversed
  f space  freeze what is shown; counting goes on
  u        only what no protocol knows
  c        clear: forget what was received, count anew
  h        mark what changes, or not
  q        quit

[b]Columns[/b]
  ← →      from a device, to a device; » sent by this host
  Rate     a second, smoothed
  Period   milliseconds between two ± their standard deviation
  Data     digits that changed are bright, and fade within 3 s
  Grey rows are silent: they missed five of their periods.

[b]Above[/b]
  The bar is the share of the bus's time that frames take, by their
  length in bits and the bit rate (-b). What was lost, on whichever
  way to this screen, is counted in red.

Esc closes this."""


class InboxFeed(Protocol):
    """Where items come from: a gate's inbox."""

    def get(self, timeout: float | None = None) -> list[Any]: ...


class Listening(Protocol):
    """A gate, as far as it is looked at."""

    name: str
    state: Any

    @property
    def counters(self) -> Any: ...
    @property
    def clock(self) -> Any: ...


class Lines(Widget):
    """Lines that are painted as they are."""

    DEFAULT_CSS = "Lines { height: auto; }"

    def __init__(self, name: str, paint: Painter) -> None:
        super().__init__(id=name)
        self._paint = paint
        self._lines: list[Line] = []

    @property
    def text(self) -> str:
        """Its text, without styles."""
        return plain_text(self._lines)

    def show(self, lines: list[Line]) -> None:
        """Show these lines."""
        is_other = len(lines) != len(self._lines)
        self._lines = lines
        self.refresh(layout=is_other)

    def get_content_height(self, container: Size, viewport: Size, width: int) -> int:
        return len(self._lines)

    def render_line(self, y: int) -> Strip:
        return self._paint(self._lines[y] if y < len(self._lines) else [], self.size.width)


class Painter:
    """Spans as what a terminal is given, on one background: `colour`, or in reverse where there are no colours."""

    def __init__(self, colour: str, *, has_colour: bool, is_reverse: bool = False) -> None:
        ground = Style(bgcolor=colour) if has_colour else Style(reverse=is_reverse)
        # Put together once, and not for each piece of each line of each picture.
        self._styles = {name: ground + style for name, style in styles(has_colour=has_colour).items()}
        self.ground = ground

    def __call__(self, spans: Sequence[StyledText], width: int) -> Strip:
        """Return a line of this width."""
        known = self._styles
        segments = [Segment(span.text, known[span.style]) for span in spans]
        return Strip(segments).adjust_cell_length(width, self.ground)


class Table(ScrollView, can_focus=True):
    """The rows. What is selected is a row and not a place: it stays selected where it moves."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("up,k", "move(-1)", "Up", show=False),
        Binding("down,j", "move(1)", "Down", show=False),
        Binding("pageup", "page(-1)", "Page up", show=False),
        Binding("pagedown", "page(1)", "Page down", show=False),
        Binding("home,g", "end(0)", "First", show=False),
        Binding("end,G", "end(-1)", "Last", show=False),
    ]

    def __init__(self, model: Model, view: View, now: Callable[[], int], *, has_colour: bool) -> None:
        super().__init__()
        self._model, self._view, self._now = model, view, now
        self._paint = Painter(GROUND, has_colour=has_colour)
        self._paint_selected = Painter(CURSOR, has_colour=has_colour, is_reverse=True)
        self.rows: list[RepeatedFrame] = []
        self.layout_columns: list[TableColumn] = []
        self.is_marking = True
        self._instant = 0
        self._selected: Place | None = None
        self.row_number = 0

    @property
    def selected(self) -> RepeatedFrame | None:
        """The row under the cursor."""
        return self.rows[self.row_number] if self.rows else None

    def show(self, rows: list[RepeatedFrame], found: list[TableColumn]) -> None:
        """Show these rows, in these columns."""
        self._instant = self._view.instant(self._now())
        self.layout_columns = found
        if rows is not self.rows:
            self.rows = rows
            if self._selected is not None and not (
                self.row_number < len(rows) and rows[self.row_number].place == self._selected
            ):
                at = next((i for i, row in enumerate(rows) if row.place == self._selected), None)
                self.row_number = min(self.row_number, max(0, len(rows) - 1)) if at is None else at
            self.row_number = min(self.row_number, max(0, len(rows) - 1))
            self.virtual_size = Size(self.size.width, len(rows))
        self.refresh()

    def render_line(self, y: int) -> Strip:
        width = self.size.width
        number = y + self.scroll_offset.y
        if number >= len(self.rows):
            return self._paint([], width)
        spans = line(
            self.rows[number], self._model, self.layout_columns, self._instant, is_marking=self.is_marking
        )
        is_selected = number == self.row_number and self._selected is not None
        return (self._paint_selected if is_selected else self._paint)(spans, width)

    def select(self, number: int) -> None:
        """Put the cursor on a row."""
        if not self.rows:
            return
        self.row_number = max(0, min(number, len(self.rows) - 1))
        self._selected = self.rows[self.row_number].place
        top, height = self.scroll_offset.y, max(1, self.size.height)
        if self.row_number < top:
            self.scroll_to(y=self.row_number, animate=False)
        elif self.row_number >= top + height:
            self.scroll_to(y=self.row_number - height + 1, animate=False)
        self.refresh()

    def action_move(self, step: int) -> None:
        self.select(self.row_number + step if self._selected is not None else max(0, step - 1))

    def action_page(self, step: int) -> None:
        self.select(self.row_number + step * max(1, self.size.height - 1))

    def action_end(self, number: int) -> None:
        self.select(number if number >= 0 else len(self.rows) - 1)

    def on_click(self, event: Click) -> None:
        """Select the row that is clicked at."""
        number = event.y + self.scroll_offset.y
        if number < len(self.rows):
            self.select(number)


class Help(ModalScreen[None]):
    """What the keys do."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("escape,question_mark,q,enter", "dismiss", "Close", show=False)
    ]
    CSS = f"""
    Help {{ align: center middle; }}
    #help {{ width: 74; max-width: 100%; height: auto; max-height: 100%; padding: 0 2; background: {BAND};
            border: round {EDGE}; }}
    """

    def compose(self) -> ComposeResult:
        with VerticalScroll(id="help"):
            yield Static(HELP)


class LiveScreen(App[None]):
    """The application. `now` gives the instant that is shown, in ns of the gate's clock."""

    TITLE = "aces sniff"
    ENABLE_COMMAND_PALETTE = False
    CSS = f"""
    Screen {{ background: {GROUND}; color: #c8d0da; layers: base; }}
    #head {{ background: {BAND}; }}
    #titles {{ height: 1; background: {BAND}; }}
    #body {{ layout: vertical; height: 1fr; }}
    Table {{ height: 1fr; background: {GROUND}; scrollbar-size-vertical: 1; overflow-x: hidden;
            scrollbar-background: {GROUND}; scrollbar-color: #323b47; }}
    #list {{ height: 1fr; }}
    #pane {{ display: none; height: 45%; border-top: solid {EDGE}; padding: 0 1; background: {PANE};
            scrollbar-size-vertical: 1; }}
    .detailed #pane {{ display: block; }}
    .wide #body {{ layout: horizontal; }}
    .wide #pane {{ width: 83; height: 100%; border-top: none; border-left: solid {EDGE}; }}
    .wide #list {{ width: 1fr; height: 100%; }}
    #filter {{ display: none; height: 1; border: none; background: {CURSOR}; padding: 0 1; }}
    .filtering #filter {{ display: block; }}
    Footer {{ background: {BAND}; }}
    """
    BINDINGS: ClassVar[list[BindingType]] = [
        # What comes first is what a narrow terminal has room for.
        Binding("d,enter", "details", "Details", key_display="d"),
        Binding("slash", "filter", "Filter", key_display="/"),
        Binding("s", "sort", "Sort"),
        Binding("S", "reverse", "Reverse", show=False),
        Binding("f,space", "freeze", "Freeze", key_display="f"),
        Binding("question_mark", "help", "Help", key_display="?"),
        Binding("q,ctrl+c", "quit", "Quit", key_display="q"),
        Binding("u", "unknown", "Unknown"),
        Binding("c", "clear", "Clear"),
        Binding("h", "highlight", "Marks"),
        Binding("escape", "leave", "Back", show=False),
        Binding("J,shift+down", "scroll_details(1)", "Details down", show=False),
        Binding("K,shift+up", "scroll_details(-1)", "Details up", show=False),
    ]

    def __init__(
        self,
        model: Model,
        gate: Listening,
        inbox: InboxFeed,
        *,
        title: str = "",
        recording: Callable[[], str] | None = None,
        feed: Callable[[Sequence[Any]], None] | None = None,
        idle: Callable[[int], None] | None = None,
        end: Callable[[], bool] | None = None,
        has_colour: bool = True,
    ) -> None:
        super().__init__()
        self.model, self.gate, self.inbox = model, gate, inbox
        self.view = View(model)
        self.said = title
        self._recording = recording
        self._feed: Callable[[Sequence[Any]], None] = feed if feed is not None else model.feed
        self._idle, self._end = idle, end
        self._has_colour = has_colour
        self._started = self._now()
        self._before = (0, 0, 0)
        self._needs: Needs | None = None
        self._needs_of: Any = None
        self._measured = 0
        self._pictures = 0

    def compose(self) -> ComposeResult:
        def lines(name: str, ground: str) -> Lines:
            return Lines(name, Painter(ground, has_colour=self._has_colour))

        yield lines("head", BAND)
        with Container(id="body"):
            with Container(id="list"):
                yield lines("titles", BAND)
                yield Table(self.model, self.view, self._now, has_colour=self._has_colour)
            with VerticalScroll(id="pane", can_focus=False):
                yield lines("detail", PANE)
        yield Input(id="filter", placeholder="words, or 060:7F0", compact=True)
        yield Footer(show_command_palette=False, compact=True)

    def on_mount(self) -> None:
        self.table.focus()
        self.picture()
        self.set_interval(1 / PICTURES, self.turn)

    def _now(self) -> int:
        return int(self.gate.clock.now())

    @property
    def table(self) -> Table:
        """The table of rows."""
        return self.query_one(Table)

    # ------------------------------------------------------------------ one turn

    async def turn(self) -> None:
        """Take in what has come, and show it."""
        await self.take_in()
        self.picture()
        if self._end is not None and self._end():
            self.exit()

    async def take_in(self) -> None:
        """Count all that waits in the inbox."""
        items = self.inbox.get(0)
        for start in range(0, len(items), PIECE):
            self._feed(items[start : start + PIECE])
            if len(items) > PIECE:
                await asyncio.sleep(0)
        if not items and self._idle is not None:
            self._idle(self._now())
        self.model.take_events()

    def picture(self) -> None:
        """Paint the screen."""
        if not self.query("#head"):  # not composed yet
            return
        now = self._now()
        self._pictures += 1
        rows = self.view.rows(now)
        self.query_one("#head", Lines).show(
            head(self.model, self.status(), self.view, len(rows), now, self.size.width)
        )
        if self.view.frozen_ns is None or rows is not self.table.rows or self._needs is None:
            self._rows(rows, now)
        if self.has_class("detailed") and self._pictures % 2 == 0:
            self._details(now)

    def _rows(self, rows: list[RepeatedFrame], now: int) -> None:
        table = self.table
        if self._needs is None or (
            self._needs_of != self.model.generation and now - self._measured >= MEASURE_NS
        ):
            self._needs, self._needs_of = Needs.of(self.model, rows), self.model.generation
            self._measured = now
        width = max(1, table.scrollable_content_region.width or table.size.width or self.size.width)
        found = visible_columns(self._needs, width)
        self.query_one("#titles", Lines).show(
            [title(found, self.view.sort, is_reversed=self.view.is_reversed)]
        )
        table.show(rows, found)

    def _details(self, now: int) -> None:
        pane = self.query_one("#detail", Lines)
        row = self.table.selected
        if row is None:
            pane.show([[StyledText("no row", "dim")]])
            return
        width = max(20, pane.size.width)
        pane.show(detail(row, self.model, self.view.instant(now), width, is_marking=self.table.is_marking))

    def status(self) -> Status:
        """Return what the gate and the scanner say."""
        lost, bad, missed = self._counts()
        return Status(
            self.gate.name,
            self.said,
            str(self.gate.state),
            lost - self._before[0],
            bad - self._before[1],
            missed - self._before[2],
            self.gate.counters.reopened,
            self._recording() if self._recording is not None else "",
            self._started,
        )

    def _counts(self) -> tuple[int, int, int]:
        counters = self.gate.counters
        scanner = self.model.scanner
        return (
            counters.dropped + counters.kernel_dropped,
            counters.bad_input,
            scanner.counts.missed if scanner is not None else 0,
        )

    # ------------------------------------------------------------------ keys

    def _again(self) -> None:
        """Paint again: something about the picture was changed."""
        self._needs = None
        self.picture()

    def action_sort(self) -> None:
        self.view.next_sort()
        self._again()

    def action_reverse(self) -> None:
        self.view.is_reversed = not self.view.is_reversed
        self._again()

    def action_freeze(self) -> None:
        if self.view.frozen_ns is None:
            self.view.freeze(self._now())
        else:
            self.view.thaw()
        self._again()

    def action_clear(self) -> None:
        self.view.thaw()
        self.model.clear()
        self._before = self._counts()
        self._started = self._now()
        self._again()

    def action_highlight(self) -> None:
        self.table.is_marking = not self.table.is_marking
        self._again()

    def action_unknown(self) -> None:
        self.view.unknown_only = not self.view.unknown_only
        self._again()

    def action_details(self) -> None:
        self.toggle_class("detailed")
        if self.has_class("detailed"):
            self.table.select(self.table.row_number)
            self.call_after_refresh(lambda: self._details(self._now()))
        self._again()

    def action_scroll_details(self, step: int) -> None:
        pane = self.query_one("#pane", VerticalScroll)
        pane.scroll_relative(y=step * max(1, pane.size.height // 2), animate=False)

    def action_help(self) -> None:
        self.push_screen(Help())

    def action_filter(self) -> None:
        self.add_class("filtering")
        self.query_one(Input).focus()

    def action_leave(self) -> None:
        """Leave the filter, then the details, at Esc."""
        if self.has_class("filtering") or self.view.text:
            self.query_one(Input).value = ""
            self.view.look_for("")
            self._leave_filter()
        elif self.has_class("detailed"):
            self.remove_class("detailed")
        self._again()

    def _leave_filter(self) -> None:
        self.remove_class("filtering")
        self.table.focus()

    def on_input_changed(self, event: Input.Changed) -> None:
        self.view.look_for(event.value)
        self._again()

    def on_input_submitted(self) -> None:
        self._leave_filter()

    def on_resize(self, event: Resize) -> None:
        self.set_class(event.size.width >= WIDE, "wide")
        self.call_after_refresh(self._again)
