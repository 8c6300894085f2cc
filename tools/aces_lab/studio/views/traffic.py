"""Traffic: a row for each identifier or kind of packet, as `aces sniff --screen` has it, of recordings too.

1. The page gets the rows that are in sight, and no others.
2. A row's bytes have two strips below, a cell for each bit: above how long ago it flipped (the stronger the more recent),
   below in which share of frames.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from nicegui import events, ui

from aces_bus import make_scanner
from aces_bus.errors import AcesError
from aces_bus.frame_table import NO_TIME
from aces_bus.protocol.record_plans import plans_of
from aces_tools.plotting.bits import save_bits
from aces_tools.reading.where import Where
from aces_tools.screen.values import FieldsOfKinds

from ..capture import TrafficRow
from ..images import row_pictures
from ..page import StudioPage, StudioView, escaped
from ..pictures import Array, data_url

#: Height of a row and of the head (px, as in page.css), and rows beyond what is in sight.
ROW_PX, HEAD_PX, MARGIN = 34, 28, 6
#: Bytes of a row that are shown.
SHOWN_BYTES = 8
#: Ages from which on a flip is recent, and no longer (s).
RECENT_S, OLD_S = 0.05, 20.0
AGE, RATE = (217, 115, 13), (31, 111, 178)
#: Signs that make a filter a condition of `--where`.
SIGNS = "=<>"
#: Rows of which a picture is drawn.
DRAWN = 24
#: A row in this time (s) at most is asked of the page while it scrolls.
THROTTLE_S = 0.04


class TrafficColumn(NamedTuple):
    """A column of the table: head, what it is sorted by, name of its width in page.css, classes of its cells."""

    head: str
    key: Callable[[TrafficRow], Any] | None
    width: str
    classes: str = ""


@dataclass
class MarkedInstant:
    """What was when an instant was marked: frames and flips of each row."""

    frames: dict[TrafficRow, int] = field(default_factory=dict)
    flips: dict[TrafficRow, Array] = field(default_factory=dict)


class TrafficView(StudioView):
    """The table of traffic."""

    title, order = "Traffic", 1

    def __init__(self, page: StudioPage) -> None:
        super().__init__(page)
        studio = page.studio
        self._fields = FieldsOfKinds(studio.variants)
        can = [variant for variant in studio.variants if variant.link == "can"]
        self._scanner = make_scanner(can, include_unknown=True) if can else None
        self._plans = plans_of(studio.variants)
        self._filter = ""
        self._where: Where | None = None
        self._sort, self._is_falling = "", False
        self._top, self._height = 0.0, 800.0
        self._mark: MarkedInstant | None = None
        self._frozen: list[str] | None = None
        self._shown: list[TrafficRow] = []

    def build(self) -> None:
        """Make filter, buttons and table."""
        with ui.row().classes("studio-bar"):
            entry = ui.input(
                placeholder="filter: 2A0, a name, or speed>3 and mode=torque", on_change=self._filtered
            )
            entry.props("dense outlined clearable debounce=250").classes("grow").mark("filter")
            self._pause = ui.switch("Pause", on_change=self._paused).mark("pause")
            button = ui.button("Mark an instant", on_click=self._marked).props("dense outline no-caps")
            button.tooltip("count frames and flips from now on, in a column of their own")
            self._said = ui.label().classes("unit wide")
        self._table = ui.html("", sanitize=False, tag="div").classes("traffic").props("tabindex=0")
        self._table.on("scroll", self._scrolled, throttle=THROTTLE_S, js_handler=_SCROLLED)
        self._table.on("click", self._clicked, js_handler=_CLICKED)

    # ------------------------------------------------------------------ what the user does

    def _filtered(self, event: events.ValueChangeEventArguments[str | None]) -> None:
        self._filter = (event.value or "").strip()
        self._where = None
        if any(sign in self._filter for sign in SIGNS):
            try:
                self._where = Where([self._filter], self._plans)
            except AcesError as error:
                self._said.set_text(str(error))
                return
        self.update()

    def _paused(self, event: events.ValueChangeEventArguments[bool | None]) -> None:
        self._frozen = None
        if event.value:
            with self.studio.capture.lock:
                self._shown = self._chosen()
                columns = self._columns
                self._frozen = [self._line(number, row, columns) for number, row in enumerate(self._shown)]
        self.update()

    def _marked(self) -> None:
        capture = self.studio.capture
        with capture.lock:
            self._mark = MarkedInstant(
                {row: row.frames for row in capture.rows}, {row: row.flips.copy() for row in capture.rows}
            )
            self.page.marks_ns.append(time.time_ns() if not capture.is_done else capture.last_ns)
        self._sort, self._is_falling = "Since mark", True
        self.update()

    def _scrolled(self, event: events.GenericEventArguments) -> None:
        self._top, self._height = (float(number) for number in event.args)
        self.update()

    def _clicked(self, event: events.GenericEventArguments) -> None:
        kind, value = event.args
        if kind == "sort" and value:
            self._is_falling = not self._is_falling if value == self._sort else False
            self._sort = value
            self.update()
        elif kind == "row" and int(value) < len(self._shown):
            self.page.choose(self._shown[int(value)])

    # ------------------------------------------------------------------ the table

    @property
    def _columns(self) -> list[TrafficColumn]:
        rows = self.studio.capture.rows
        columns = [
            TrafficColumn("ID", lambda row: (row.identifier.key, row.label), "id", "mono"),
            TrafficColumn("Message", lambda row: self._name(row), "name")
            if self.studio.variants or self.studio.draft is not None
            else None,
            TrafficColumn("Channel", lambda row: str(row.identifier.channel), "channel", "wide")
            if len({row.identifier.channel for row in rows}) > 1
            else None,
            TrafficColumn("Count", lambda row: row.frames, "count", "n"),
            TrafficColumn("Period ms", lambda row: (row.pace_ms or (np.inf,))[0], "pace", "n"),
            TrafficColumn("Jitter ms", lambda row: (row.pace_ms or (0, np.inf))[1], "pace", "n wide"),
            TrafficColumn("Since mark", self._since, "since", "n") if self._mark is not None else None,
            TrafficColumn("Bytes, age and flips of bits", lambda row: int(row.flips.sum()), "data"),
            TrafficColumn("Fields", None, "rest"),
        ]
        return [column for column in columns if column is not None]

    def _since(self, row: TrafficRow) -> tuple[int, int]:
        """Return bits that flipped since the mark, and frames."""
        if self._mark is None:
            return 0, 0
        before = self._mark.flips.get(row, row.flips[:0])
        flips = int((row.flips[: len(before)] > before).sum() + (row.flips[len(before) :] > 0).sum())
        return flips, row.frames - self._mark.frames.get(row, 0)

    def _chosen(self) -> list[TrafficRow]:
        """Return the rows that the filter lets pass, sorted."""
        rows = self.studio.capture.rows
        if self._where is not None:
            rows = [row for row in rows if (r := self._record(row)) is not None and self._where.holds(r)]
        elif self._filter:
            text = self._filter.lower()
            rows = [row for row in rows if text in f"{row.label} {self._name(row)}".lower()]
        key = next((column.key for column in self._columns if column.head == self._sort), None)
        if key is not None:
            rows.sort(key=key, reverse=self._is_falling)
        return rows

    def _record(self, row: TrafficRow) -> Any:
        """Return the newest frame or packet decoded, None where no protocol decodes it."""
        if row.record is not None or self._scanner is None:
            return row.record
        frame = row.newest()
        found = (
            []
            if frame is None
            else [r for r in self._scanner.feed([frame]) if self._fields[type(r)] is not None]
        )
        return found[-1] if found else None

    def _name(self, row: TrafficRow) -> str:
        record = self._record(row)
        if record is not None:
            return type(record).__name__
        draft = self.studio.draft
        drawn = None if draft is None else draft.messages.get(row.identifier.key)
        return row.name if drawn is None else drawn.name

    def _drawn(self, row: TrafficRow) -> str:
        """Return the values of the fields that were drawn over a row, of its newest frame."""
        draft = self.studio.draft
        drawn = None if draft is None else draft.messages.get(row.identifier.key)
        if drawn is None or not row.kept:
            return ""
        last = row.last
        parts = [
            f'{escaped(field.name)}={field.values(last)[0]:.10g} <span class="unit">{escaped(field.unit)}</span>'
            for field in drawn.fields
        ]
        return "&ensp;".join(parts)

    def update(self) -> None:
        """Show the rows in sight."""
        first = max(0, int((self._top - HEAD_PX) / ROW_PX) - MARGIN)
        last = first + int(self._height / ROW_PX) + 2 * MARGIN
        columns = self._columns
        with self.studio.capture.lock:
            if self._frozen is not None:
                lines = self._frozen[first:last]
            else:
                self._shown = self._chosen()
                some = enumerate(self._shown[first:last], first)
                lines = [self._line(number, row, columns) for number, row in some]
        total = len(self._shown)
        above, below = first * ROW_PX, max(0, total - first - len(lines)) * ROW_PX
        arrow = "▼" if self._is_falling else "▲"
        widths = "".join(
            f'<col class="col-{column.width}{" wide" * ("wide" in column.classes)}">' for column in columns
        )
        heads = "".join(
            f'<th class="{column.classes}" data-sort="{column.head if column.key else ""}">'
            f"{column.head}{f' {arrow}' if column.head == self._sort else ''}</th>"
            for column in columns
        )
        spaces = [f'<tr class="space"><td style="height:{px}px"></td></tr>' for px in (above, below)]
        self._table.set_content(
            f"<table><colgroup>{widths}</colgroup><thead><tr>{heads}</tr></thead>"
            f"<tbody>{spaces[0]}{''.join(lines)}{spaces[1]}</tbody></table>"
        )
        every = len(self.studio.capture.rows)
        if not self._filter or self._where is not None or not any(sign in self._filter for sign in SIGNS):
            self._said.set_text(f"{total} of {every} rows" if total != every else f"{total} rows")

    def _line(self, number: int, row: TrafficRow, columns: Sequence[TrafficColumn]) -> str:
        record = self._record(row)
        pace = row.pace_ms
        cells = {
            "ID": escaped(row.label),
            "Message": escaped(self._name(row)),
            "Channel": escaped(row.identifier.channel or ""),
            "Count": f"{row.frames:,}",
            "Period ms": "" if pace is None else f"{pace[0]:.4g}",
            "Jitter ms": "" if pace is None else f"{pace[1]:.3g}",
            "Bytes, age and flips of bits": self._bytes(row),
            "Fields": self._drawn(row) if record is None else self._values(record),
        }
        if self._mark is not None:
            flips, frames = self._since(row)
            cells["Since mark"] = f"{flips} bits, {frames:,} ×" if frames else ""
        tds = "".join(f'<td class="{column.classes}">{cells[column.head]}</td>' for column in columns)
        return f'<tr data-row="{number}">{tds}</tr>'

    def _values(self, record: Any) -> str:
        known = self._fields[type(record)]
        if known is None:
            return ""
        parts = [
            f"{escaped(token.name)}={escaped(token.text)}"
            + (f' <span class="unit">{escaped(token.unit)}</span>' if token.unit else "")
            for token in known.tokens(record)
        ]
        return "&ensp;".join(parts)

    def _bytes(self, row: TrafficRow) -> str:
        data = row.data
        some = data[:SHOWN_BYTES]
        digits = "".join(f"<b>{byte:02X}</b>" for byte in some)
        more = f' <span class="unit">+{len(data) - len(some)}</span>' if len(data) > len(some) else ""
        if not some:
            return ""
        shade = f'<i style="background-image:url({self._shade(row, len(some))})"></i>'
        return f'<span class="bytes">{digits}{shade}</span>{more}'

    def _shade(self, row: TrafficRow, size: int) -> str:
        """Return the picture below the bytes: a column a bit as it is written, age above and flip rate below."""
        order = (np.arange(size)[:, None] * 8 + np.arange(7, -1, -1)).ravel()
        order = order[order < len(row.flips)]
        capture = self.studio.capture
        now = time.time_ns() if capture.is_live and not capture.is_done else row.last_ns
        age_s = (now - row.flipped_ns[order]) / 1e9
        recent = 1 - np.log(np.maximum(age_s, RECENT_S) / RECENT_S) / np.log(OLD_S / RECENT_S)
        recent = np.where(row.flipped_ns[order] == NO_TIME, 0, recent.clip(0, 1))
        rate = np.sqrt(row.flips[order] / max(1, row.frames - 1)).clip(0, 1)
        pixels = np.zeros((2, len(order), 4), np.uint8)
        for line, (colour, strength) in enumerate(((AGE, recent), (RATE, rate))):
            pixels[line, :, :3] = colour
            pixels[line, :, 3] = (255 * strength).astype(np.uint8)
        return data_url(pixels)

    # ------------------------------------------------------------------ what can be taken away

    def words(self) -> Sequence[str]:
        """Return the command line of decoded lines, or of the live screen."""
        studio = self.studio
        named = [word for name in studio.protocols for word in ("-p", name)]
        where = ["--where", self._filter] if self._where is not None else []
        if studio.bus:
            return ["aces", "sniff", studio.bus, *named, *(where or ["--screen"])]
        return ["aces", "decode", *studio.recordings, *named, *where]

    def save_picture(self, path: str) -> None:
        """Draw the bits of the rows that are shown, up to `DRAWN`."""
        with self.studio.capture.lock:
            save_bits(row_pictures(self._shown[:DRAWN]), path)

    def table(self) -> Mapping[str, Sequence[object]]:
        """Return the rows that are shown."""
        with self.studio.capture.lock:
            rows = [(row, row.pace_ms or (None, None), self._record(row)) for row in self._shown]
            return {
                "id": [row.label for row, _, _ in rows],
                "channel": [row.identifier.channel for row, _, _ in rows],
                "message": [row.name if found is None else type(found).__name__ for row, _, found in rows],
                "frames": [row.frames for row, _, _ in rows],
                "period_ms": [pace[0] for _, pace, _ in rows],
                "jitter_ms": [pace[1] for _, pace, _ in rows],
                "data": [row.data.hex() for row, _, _ in rows],
            }


VIEW = TrafficView
_SCROLLED = "(event) => emit([event.target.scrollTop, event.target.clientHeight])"
_CLICKED = """(event) => {
  const head = event.target.closest('[data-sort]'), row = event.target.closest('[data-row]')
  if (head) emit(['sort', head.dataset.sort])
  else if (row) emit(['row', row.dataset.row])
}"""
