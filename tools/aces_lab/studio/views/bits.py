"""Bits: one message, its bits over time, and fields that are drawn over them.

1. The picture is that of `aces plot --bits`, of the stretch of time that is looked at.
2. Fields are drawn on the grid with the mouse, or typed; their curve follows at once. Nothing is written before *Save*.
3. Guesses are those of `aces spec guess`, with their evidence. Without that room of the lab the view says so.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, Literal

import numpy as np
from nicegui import events, run, ui

from aces_bus.errors import AcesError
from aces_bus.frame_table import NO_TIME
from aces_tools.plotting.bit_image import BitImages
from aces_tools.plotting.bits import flip_rates, save_bits
from aces_tools.plotting.series import broken, longest_period

from ..capture import Columns, TrafficRow
from ..draft import DrawnMessage
from ..fields import DrawnField, as_written, dragged, in_order
from ..images import add_columns, row_pictures
from ..page import StudioPage, StudioView, escaped
from ..pictures import Array, data_url, thinned

#: Pixels of the picture and of the curve, at most.
PIXELS, HEIGHT_PX = 700, 400
#: Bytes of a message that are drawn.
MOST_BYTES = 64
#: Frames from which fields are guessed.
GUESSED = 200_000
COLOURS = ("#1f77b4", "#d9730d", "#2a9d5c", "#b04ac0", "#c8a415", "#d6456b", "#4b9aa8", "#8a6a4f")
#: No flip, and a flip in each frame; by the square root.
LOW, HIGH = (120, 130, 140, 26), (31, 111, 178, 255)
#: A step of the zoom, and the least stretch of time (s).
ZOOM, LEAST_S = 0.5, 1e-4


class BitsView(StudioView):
    """A message bit by bit."""

    title, order = "Bits", 2

    def __init__(self, page: StudioPage) -> None:
        super().__init__(page)
        self._row: TrafficRow | None = None
        self._choices: dict[int, str] = {}
        self._span: tuple[float, float] | None = None
        self._guesses: list[tuple[DrawnField, str, float]] = []
        self._guessed: TrafficRow | None = None
        self._field = DrawnField("field", 0, 0)
        self._anchor: int | None = None
        self._is_taking = False
        self._seen: tuple[object, ...] = ()

    # ------------------------------------------------------------------ elements

    def build(self) -> None:
        """Make the grid, the picture, the form, the curve, the fields and the draft."""
        with ui.row().classes("studio-bar"):
            self._select = ui.select({}, label="message", on_change=self._selected).props(
                "dense outlined options-dense"
            )
            self._select.classes("bits-select")
            for label, factor in (("Zoom in", ZOOM), ("Zoom out", 1 / ZOOM), ("All", 0.0)):
                button = ui.button(label, on_click=partial(self._zoom, 0.5, factor))
                button.props("dense outline no-caps size=sm")
            self._said = ui.label().classes("unit wide")
        with ui.element("div").classes("bits"):
            with ui.element("div").classes("bits-left"):
                self._grid = ui.html("", sanitize=False).classes("bits-grid")
                for kind in ("mousedown", "mouseover"):
                    self._grid.on(kind, self._dragged, js_handler=_DRAGGED)
                self._form()
            with ui.element("div").classes("bits-right"):
                self._picture = ui.html("", sanitize=False).classes("bits-picture")
                self._picture.on("wheel", self._wheeled, throttle=0.05, js_handler=_WHEELED)
                self._picture.on("dblclick", lambda: self._zoom(0.5, 0.0))
                self._chart = ui.echart(_chart_options()).classes("bits-chart")
        self._list = ui.html("", sanitize=False).classes("bits-list")
        self._list.on("click", self._listed, js_handler=_LISTED)
        self._draft()

    def _form(self) -> None:
        with ui.element("div").classes("bits-form"):
            number: dict[str, Any] = {"format": "%.12g", "on_change": self._typed}
            self._name = ui.input("name", value="field", on_change=self._typed).mark("name")
            self._start = ui.number("first bit", value=0, min=0, **number).tooltip(
                "of the lowest bit: 8 × byte + bit"
            )
            self._length = ui.number("bits", value=0, min=0, max=64, **number)
            self._order = ui.toggle(["little", "big"], value="little", on_change=self._ordered)
            self._signed = ui.checkbox("signed", on_change=self._typed)
            self._scale = ui.number("scale", value=1, **number)
            self._offset = ui.number("offset", value=0, **number)
            self._unit = ui.input("unit", on_change=self._typed).mark("unit")
            for element in (self._name, self._start, self._length, self._scale, self._offset, self._unit):
                element.props("dense outlined")
            self._order.props("dense no-caps size=sm")
            if self.studio.draft is not None:
                ui.button("Add field", on_click=self._add).props("dense no-caps unelevated").mark("add")

    def _draft(self) -> None:
        draft = self.studio.draft
        if draft is None:
            ui.label("To keep what is drawn, start the studio with -o draft.py.").classes("unit")
            return
        with ui.row().classes("studio-bar"):
            self._message = (
                ui.input("message", on_change=self._named).props("dense outlined").classes("bits-message")
            )
            ui.button("Save and check", on_click=self._save).props("dense no-caps unelevated")
            ui.button("Examples", on_click=lambda: self._ask(draft.examples)).props(
                "dense no-caps outline"
            ).tooltip("worked examples for the saved spec, out of the recording")
            self._read = ui.button("", on_click=self._reload).props("dense no-caps outline color=orange")
            self._state = ui.label().classes("unit")
        with ui.element("div").classes("bits-texts"):
            self._source = ui.label().classes("bits-text")
            self._answer = ui.label().classes("bits-text")

    # ------------------------------------------------------------------ which message

    def show(self, row: TrafficRow) -> None:
        """Look at a row."""
        self._row, self._span, self._guesses, self._seen = row, None, [], ()
        self._select.set_value(self.studio.capture.rows.index(row))
        self._take(DrawnField(self._free_name(), 0, 0))
        if self.studio.draft is not None:
            self._message.set_value(self._drawn().name)
        self.update()

    def _selected(self, event: events.ValueChangeEventArguments[int | None]) -> None:
        rows = self.studio.capture.rows
        if event.value is not None and self._row is not rows[event.value]:
            self.show(rows[event.value])

    def _size(self) -> int:
        return 0 if self._row is None else min(MOST_BYTES, len(self._row.flips) // 8)

    def _drawn(self) -> DrawnMessage:
        """Return the message of the row as it is drawn."""
        row, draft = self._row, self.studio.draft
        if draft is None or row is None or row.identifier.key < 0:
            return DrawnMessage("", -1, self._size())
        return draft.message(row.identifier.key, self._size())

    def _free_name(self) -> str:
        taken = {field.name for field in self._drawn().fields}
        return next(name for n in range(1, 1000) if (name := f"field_{n}") not in taken)

    async def _guess(self, row: TrafficRow) -> None:
        try:
            from aces_lab.guess import fields_of
        except ImportError:
            self._said.set_text("no guesses: the lab's room guess is not installed")
            return
        with self.studio.capture.lock:
            columns = row.columns()
        size = int(columns.lengths.min(initial=255))
        times = None if (columns.times[:1] == NO_TIME).any() else columns.times[:GUESSED]
        found = await run.io_bound(fields_of, columns.data[:GUESSED, :size], times)
        if self._row is row:
            self._guesses = [
                (
                    DrawnField(
                        f"{guess.kind}_{guess.first_byte}",
                        guess.start,
                        guess.length,
                        guess.order,
                        guess.signed,
                    ),
                    f"{guess.kind}: {guess.evidence}",
                    guess.confidence,
                )
                for guess in found or ()
                if guess.kind != "constant" and guess.length <= 64
            ]
            self._seen = ()

    # ------------------------------------------------------------------ the field that is drawn

    def _dragged(self, event: events.GenericEventArguments) -> None:
        bit, is_first = event.args
        if is_first:
            self._anchor = bit
        if self._anchor is None:
            return
        start, length = dragged(self._anchor, bit, self._field.order)
        self._take(replace(self._field, start=start, length=min(64, length)))
        self.update()

    def _take(self, field: DrawnField) -> None:
        """Put a field into the form."""
        pairs: list[tuple[Any, Any]] = [
            (self._name, field.name),
            (self._start, field.start),
            (self._length, field.length),
            (self._order, field.order),
            (self._signed, field.signed),
            (self._scale, field.scale),
            (self._offset, field.offset),
            (self._unit, field.unit),
        ]
        self._is_taking = True  # each element that is set tells `_typed` of it
        for element, value in pairs:
            element.set_value(value)
        self._field, self._is_taking = field, False

    def _typed(self) -> None:
        numbers = (self._start.value, self._length.value, self._scale.value, self._offset.value)
        if None in numbers or self._is_taking:
            return
        start, length, scale, offset = (float(number or 0) for number in numbers)
        self._field = DrawnField(
            self._name.value or "",
            int(start),
            int(length),
            self._field.order,
            bool(self._signed.value),
            scale,
            offset,
            self._unit.value or "",
        )
        self.update()

    def _ordered(self, event: events.ValueChangeEventArguments[Literal["little", "big"]]) -> None:
        if event.value != self._field.order and not self._is_taking:
            self._take(in_order(self._field, event.value))
            self.update()

    def _add(self) -> None:
        draft, message = self.studio.draft, self._drawn()
        if draft is None or message.key < 0:
            self.page.say("fields are drawn on messages of CAN")
            return
        try:
            draft.draw(replace(message, name=self._message.value or message.name).with_field(self._field))
        except AcesError as error:
            self.page.say(str(error))
            return
        self._take(DrawnField(self._free_name(), 0, 0, self._field.order))
        self.update()

    def _named(self, event: events.ValueChangeEventArguments[str | None]) -> None:
        draft, message = self.studio.draft, self._drawn()
        if draft is not None and message.fields and event.value and event.value != message.name:
            try:
                draft.draw(replace(message, name=event.value))
            except AcesError as error:
                self.page.say(str(error))

    def _listed(self, event: events.GenericEventArguments) -> None:
        kind, text = event.args
        number, message = int(text), self._drawn()
        if kind == "take" and number < len(self._guesses):
            self._take(replace(self._guesses[number][0], name=self._field.name))
        elif kind == "edit" and number < len(message.fields):
            self._take(message.fields[number])
        elif kind == "remove" and number < len(message.fields) and self.studio.draft is not None:
            try:
                self.studio.draft.draw(message.without(message.fields[number].name))
            except AcesError as error:
                self.page.say(str(error))
        self.update()

    # ------------------------------------------------------------------ the draft

    async def _save(self) -> None:
        draft = self.studio.draft
        if draft is None:
            return
        try:
            if not draft.is_saved:
                draft.save()
        except AcesError as error:
            self.page.say(str(error))
            return
        await self._ask(draft.check)

    async def _ask(self, what: Callable[[], Awaitable[str]]) -> None:
        """Show what another process says of the saved file."""
        self._answer.set_text("…")
        self._answer.set_text(await what())

    async def _reload(self) -> None:
        if self.studio.draft is not None:
            self._answer.set_text(await self.studio.draft.read() or "read")
            self._message.set_value(self._drawn().name)
            self._seen = ()

    # ------------------------------------------------------------------ what is seen

    def _zoom(self, at: float, factor: float) -> None:
        """Look at another stretch of time: `factor` of this one, around the share `at` of it; 0: all of it."""
        if self._row is None:
            return
        low, high = self._bounds(self._columns())
        middle, width = low + at * (high - low), (high - low) * factor
        self._span = (middle - at * width, middle + (1 - at) * width) if width > LEAST_S else None
        self.update()

    def _wheeled(self, event: events.GenericEventArguments) -> None:
        at, step = event.args
        self._zoom(float(at), ZOOM if step < 0 else 1 / ZOOM)

    def _columns(self) -> Columns:
        assert self._row is not None
        with self.studio.capture.lock:
            return self._row.columns()

    def _bounds(self, columns: Columns) -> tuple[float, float]:
        places = columns.places_s
        first, last = float(places[0]), float(places[-1])
        if self._span is None:
            return first, last
        low, high = max(first, self._span[0]), min(last, self._span[1])
        return (low, high) if low < high else (first, last)

    def update(self) -> None:
        """Show the message as it is now."""
        rows, draft = self.studio.capture.rows, self.studio.draft
        if len(rows) != len(self._choices):
            several = len({row.identifier.channel for row in rows}) > 1
            self._choices = {
                number: f"{row.identifier.channel} {row.label}" if several else row.label
                for number, row in enumerate(rows)
            }
            self._select.set_options(self._choices)
        if self._row is None:
            if rows:
                self.show(max(rows, key=lambda row: (len(row.flips) > 0, row.frames)))
            return
        row = self._row
        if self._guessed is not row and (self.studio.capture.is_done or row.frames > GUESSED // 100):
            self._guessed = row
            ui.timer(0.01, lambda: self._guess(row), once=True)
        drawn = self._drawn()
        seen = (row, row.frames, self._span, self._field, drawn, len(self._guesses), draft and draft.is_saved)
        if draft is not None:
            self._show_draft()
        if seen == self._seen or not self._size():
            return
        self._seen = seen
        columns = self._columns()
        low, high = self._bounds(columns)
        part = columns.between(low, np.nextafter(high, np.inf))
        self._show_grid(row, drawn)
        self._show_picture(row, part, drawn, (low, high))
        self._show_curve(part, float(columns.places_s[0]))
        self._show_list(drawn)

    def _colours(self, drawn: DrawnMessage) -> dict[int, str]:
        """Return the colour of each bit that belongs to a field."""
        return {
            at: COLOURS[number % len(COLOURS)]
            for number, field in enumerate(drawn.fields)
            for at in field.positions
        }

    def _show_grid(self, row: TrafficRow, drawn: DrawnMessage) -> None:
        colours, data = self._colours(drawn), row.data
        guessed = {at for field, _, _ in self._guesses for at in field.positions}
        chosen = set(self._field.positions) if self._field.length else set()
        lowest = self._field.start
        rates = np.sqrt(row.flips / max(1, row.frames - 1)).clip(0, 1).tolist()
        lines = ["<tr><th></th>" + "".join(f"<th>{bit}</th>" for bit in range(7, -1, -1)) + "<th></th></tr>"]
        for byte in range(self._size()):
            cells = []
            for at in range(8 * byte + 7, 8 * byte - 1, -1):
                value = data[byte] >> at % 8 & 1 if byte < len(data) else ""
                style = f"background:rgba({HIGH[0]},{HIGH[1]},{HIGH[2]},{0.75 * rates[at]:.2f});"
                if at in colours:
                    style += f"box-shadow:inset 0 -4px {colours[at]};"
                elif at in guessed:
                    style += "border-bottom-style:dashed;"
                kind = "on low" if at in chosen and at == lowest else "on" if at in chosen else ""
                cells.append(f'<td data-bit="{at}" class="{kind}" style="{style}">{value}</td>')
            digits = f"{data[byte]:02X}" if byte < len(data) else ""
            lines.append(f"<tr><th>{byte}</th>{''.join(cells)}<th class='mono'>{digits}</th></tr>")
        self._grid.set_content(f"<table>{''.join(lines)}</table>")

    def _show_picture(
        self, row: TrafficRow, part: Columns, drawn: DrawnMessage, span: tuple[float, float]
    ) -> None:
        images = BitImages()
        add_columns(images, row, part, 0)
        image = next(iter(images.images.values()), None)
        if image is None or not image.length:
            self._picture.set_content("")
            return
        _, _, rates = flip_rates(images, image, PIXELS)
        strength = np.sqrt(np.nan_to_num(rates))[:, :, None]
        pixels = (np.array(LOW) * (1 - strength) + np.array(HIGH) * strength).astype(np.uint8)
        pixels[np.isnan(rates)] = 0
        line_px = max(2, min(5, HEIGHT_PX // len(pixels)))
        height = line_px * len(pixels)
        strip = np.zeros((len(pixels), 1, 4), np.uint8)
        colours = self._colours(drawn)
        for at, colour in colours.items():
            if at < len(pixels):
                strip[as_written(at), 0] = (*bytes.fromhex(colour[1:]), 255)
        first = float(part.places_s[0]) if self._span is None else span[0]
        marks = [
            f'<i style="left:{100 * share:.2f}%"></i>'
            for mark in self.page.marks_ns
            if 0 <= (share := (mark / 1e9 - span[0]) / max(1e-9, span[1] - span[0])) <= 1
        ]
        start = float(self._columns().places_s[0])
        self._picture.set_content(
            f'<div class="bits-lanes" style="height:{height}px"><img src="{data_url(strip)}" class="strip">'
            f'<div><img src="{data_url(pixels)}"><s style="background-size:100% {8 * line_px}px"></s>'
            f"{''.join(marks)}</div></div>"
            f'<div class="bits-axis"><span>{first - start:.6g} s</span>'
            f"<span>{escaped(row.label)}: bits from the top: byte 0 bit 7 …; the darker the more often it flips</span>"
            f"<span>{span[1] - start:.6g} s</span></div>"
        )

    def _show_curve(self, part: Columns, start: float) -> None:
        field = self._field
        points: list[list[float | None]] = []
        if field.length and self._is_inside(field):
            x: Array = part.places_s - start
            y = field.values(part)
            if len(x) > 2:
                x, y = broken(*thinned(x, y, PIXELS), max(longest_period(x), (x[-1] - x[0]) / PIXELS * 3))
            points = [
                [round(float(a), 6), None if np.isnan(b) else float(b)] for a, b in zip(x, y, strict=True)
            ]
        options = self._chart.options
        options["series"][0]["data"] = points
        options["yAxis"]["name"] = (
            f"{field.name}{f' in {field.unit}' if field.unit else ''}" if points else ""
        )
        options["title"]["show"] = not points
        self._chart.update()

    def _is_inside(self, field: DrawnField) -> bool:
        return min(field.positions) >= 0 and max(field.positions) < 8 * self._size()

    def _show_list(self, drawn: DrawnMessage) -> None:
        colours, lines = self._colours(drawn), list[str]()
        for number, field in enumerate(drawn.fields):
            chip = f'<u style="background:{colours[field.positions[0]]}"></u>{escaped(field.name)}'
            scale = f"× {field.scale:.12g} + {field.offset:.12g} {escaped(field.unit)}"
            lines.append(_row_of(number, chip, field, scale, "edit", "remove"))
        for number, (field, evidence, confidence) in enumerate(self._guesses):
            lines.append(_row_of(number, f"guess, {confidence:.0%}", field, escaped(evidence), "take"))
        self._list.set_content(f"<table>{''.join(lines)}</table>" if lines else "")

    def _show_draft(self) -> None:
        draft = self.studio.draft
        if draft is None:
            return
        is_outside = draft.is_unread or draft.is_changed_outside
        self._read.set_visibility(is_outside)
        self._read.set_text(f"Run {draft.path.name} and read it")
        state = "read it before drawing" if draft.is_unread else "changed outside" if is_outside else ""
        self._state.set_text(f"{draft.path.name}: {state or draft.state}")
        self._source.set_text(draft.diff() or "nothing to save")

    # ------------------------------------------------------------------ what can be taken away

    def words(self) -> Sequence[str]:
        """Return the command line that draws the bits."""
        studio, row = self.studio, self._row
        if row is None or row.identifier.key < 0:
            return [
                "aces",
                "decode",
                *studio.recordings,
                *(w for name in studio.protocols for w in ("-p", name)),
            ]
        if studio.bus:
            digits = row.identifier.digits
            return [
                "aces",
                "sniff",
                studio.bus,
                "--filter",
                f"{digits}:{'1FFFFFFF' if len(digits) > 3 else '7FF'}",
            ]
        return ["aces", "plot", *studio.recordings, "--bits", row.identifier.digits]

    def save_picture(self, path: str) -> None:
        """Draw the bits of the message."""
        with self.studio.capture.lock:
            save_bits(row_pictures([self._row] if self._row is not None else []), path)

    def table(self) -> Mapping[str, Sequence[object]]:
        """Return frames and values of the drawn fields, of the stretch that is looked at."""
        if self._row is None:
            return {}
        columns = self._columns()
        low, high = self._bounds(columns)
        part = columns.between(low, np.nextafter(high, np.inf))
        lengths = part.lengths.tolist()
        data = [bytes(row[:length]).hex() for row, length in zip(part.data, lengths, strict=True)]
        fields = {field.name: field.values(part).tolist() for field in self._drawn().fields}
        return {"time": part.places_s.tolist(), "data": data, **fields}


def _row_of(number: int, name: str, field: DrawnField, text: str, *deeds: str) -> str:
    """Return a row of the list of fields and guesses; `name` and `text` are HTML."""
    links = "".join(f'<a data-do="{deed}" data-number="{number}">{deed}</a>' for deed in deeds)
    place = f"{field.place}{', signed' if field.signed else ''}"
    return f"<tr><td>{name}</td><td>{place}</td><td>{text}</td><td>{links}</td></tr>"


def _chart_options() -> dict[str, Any]:
    """Return the options of a curve without points (Apache ECharts)."""
    soft = {"lineStyle": {"color": "#8a949e"}}
    label = {"color": "#8a949e"}
    return {
        "animation": False,
        "title": {
            "text": "draw over bits with the mouse: their curve is here",
            "left": "center",
            "top": "middle",
            "textStyle": {"color": "#8a949e", "fontSize": 13, "fontWeight": "normal"},
        },
        "grid": {"left": 64, "right": 14, "top": 26, "bottom": 24},
        "tooltip": {"trigger": "axis", "renderMode": "richText"},
        "xAxis": {
            "type": "value",
            "scale": True,
            "axisLine": soft,
            "axisLabel": label,
            "splitLine": {"show": False},
        },
        "yAxis": {
            "type": "value",
            "scale": True,
            "axisLine": soft,
            "axisLabel": label,
            "nameTextStyle": {"color": "#8a949e", "align": "left"},
            "splitLine": {"lineStyle": {"color": "#8a949e44"}},
        },
        "series": [
            {"type": "line", "data": [], "showSymbol": False, "lineStyle": {"width": 1.4, "color": "#d9730d"}}
        ],
    }


VIEW = BitsView
_DRAGGED = """(event) => {
  const cell = event.target.closest('[data-bit]')
  if (!cell || event.buttons !== 1) return
  event.preventDefault()
  emit([+cell.dataset.bit, event.type === 'mousedown'])
}"""
_WHEELED = """(event) => {
  event.preventDefault()
  const box = event.currentTarget.getBoundingClientRect()
  emit([Math.min(1, Math.max(0, (event.clientX - box.left) / box.width)), event.deltaY])
}"""
_LISTED = """(event) => {
  const link = event.target.closest('[data-do]')
  if (link) emit([link.dataset.do, link.dataset.number])
}"""
