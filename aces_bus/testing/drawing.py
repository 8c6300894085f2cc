"""Draws a scene that breaks a law: what came over the wire, what was expected of it, and what the scanner made of it.

    0000  FF FF 01 02 06│F7
    said  a──────────────┤    a  0…6 Reset id=1
    gave  b┤c··········──┤    b  0…1 malformed: checksum …

1. A drawing never fails: what raises while it is made is what it shows.
2. Long runs of zeros are left out, with their length.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any

from ..protocol.record import FieldValue
from .bench import Bench
from .scenes import Scene, Way, Wire
from .shrinking import packet_bytes
from .trial import ScannedItem, as_items, items_by, play

#: Bytes in a row.
ROW = 16
#: Characters of a line in the legend.
WIDTH = 110
KEYS = "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ"


def scene_drawing(wire: Wire, direction: Way, scene: Scene, cuts: Iterable[int] = ()) -> str:
    """Return the scene as text, some lines of at most 110 characters."""
    bench = Bench(wire, direction)
    cuts = tuple(sorted(cuts))
    lanes = [
        ("law", _asked(lambda: items_by(bench.reference(), scene))),
        ("gave", _asked(lambda: as_items(play(bench.scanner(), scene), bench.is_can))),
    ]
    if cuts:
        cut_up = _asked(lambda: as_items(play(bench.scanner(), scene, cuts), bench.is_can))
        lanes.append(("cut", cut_up))
    # What says the same as another is not drawn twice.
    kept: list[Lane] = []
    same: list[str] = []
    for name, items in lanes:
        twin = next((k for k, other in kept if other == items), None)
        if twin is None:
            kept.append((name, items))
        else:
            same.append(f"{name:>4}  {TITLES[name]}: the same as {twin!r}")
    lines = [*(_frames(scene, kept) if bench.is_can else _bytes(scene, cuts, kept)), *same]
    for offset, packet in scene.sent_at:
        lines.append(f"      we sent, before {offset}: {image_text(packet)}")
    if not bench.is_can:
        lines += _signs(scene, cuts)
    return "\n".join(lines)


Lane = tuple[str, "Sequence[ScannedItem] | str"]
TITLES = {
    "law": "what the reference says",
    "gave": "what the scanner gives",
    "cut": "what it gives when the input comes in pieces",
}


def _asked(ask: Callable[[], Sequence[ScannedItem]]) -> Sequence[ScannedItem] | str:
    try:
        return ask()
    except Exception as error:  # shown in the drawing
        return f"raises {type(error).__name__}: {error}"


def _signs(scene: Scene, cuts: Sequence[int]) -> list[str]:
    lines: list[str] = []
    if any(0 < cut < len(scene) for cut in cuts):
        lines.append("      │ a chunk ends here")
    if scene.idle_at:
        lines.append("      ¦ the line falls silent here")
    return lines


# ---------------------------------------------------------------------- bytes


def _bytes(scene: Scene, cuts: Sequence[int], lanes: Sequence[Lane]) -> list[str]:
    keyed = [(name, _keyed(items)) for name, items in lanes]
    marks = dict.fromkeys(cuts, "│")
    marks.update(dict.fromkeys(scene.idle_at, "¦"))
    lines: list[str] = []
    left_out = 0
    for start in range(0, len(scene), ROW):
        row = scene.traffic[start : start + ROW]
        is_plain = not any(row) and 0 < start < len(scene) - ROW
        if is_plain and not any(start <= offset < start + ROW for offset in marks):
            left_out += len(row)
            continue
        if left_out:
            lines.append(f"      … {left_out} bytes 00 …")
            left_out = 0
        text = "".join(f"{byte:02X}{marks.get(start + i + 1, ' ')}" for i, byte in enumerate(row))
        lines.append(f"{start:04X} {marks.get(start, ' ')}{text}".rstrip())
        for name, (_, items) in keyed:
            if items:
                lines.append(f"{name:>4}  {_lane(items, start, start + len(row))}".rstrip())
    for name, (problem, items) in keyed:
        lines.append(f"{name:>4}  {TITLES[name]}:" + (f" {problem}" if problem else ""))
        lines += _legend(items)
    return lines


def _keyed(items: Sequence[ScannedItem] | str) -> tuple[str, list[tuple[str, ScannedItem]]]:
    if isinstance(items, str):
        return items, []
    return "", [(KEYS[i % len(KEYS)], item) for i, item in enumerate(items)]


def _lane(items: Sequence[tuple[str, ScannedItem]], start: int, stop: int) -> str:
    """Draw a lane under a row of bytes: each item from its key to its end; what is lost is dotted."""
    out = [" "] * (3 * (stop - start))
    for key, item in items:
        first, last = max(item.offset, start), min(item.offset + item.size, stop)
        if first >= last:
            continue
        left, right = 3 * (first - start), 3 * (last - start) - 1
        out[left:right] = ("─" if item.message else "·") * (right - left)
        if item.offset >= start:
            out[left] = key
        if item.offset + item.size <= stop:
            out[right - 1] = "┤"
    return "".join(out)


def _legend(items: Sequence[tuple[str, ScannedItem]]) -> list[str]:
    return [
        _clipped(f"      {key}  {item.offset}…{item.offset + item.size}  {said(item)}") for key, item in items
    ]


def said(item: ScannedItem) -> str:
    """Return a thing on the wire in words."""
    if not item.message:
        return item.reason
    fields = " ".join(f"{name}={_value(value)}" for name, value in item.fields.items())
    return f"{item.message} {fields}".rstrip()


def _value(value: FieldValue) -> str:
    return value.hex() or "''" if isinstance(value, bytes) else str(value).replace(" ", "")


def _clipped(line: str) -> str:
    return line if len(line) <= WIDTH else line[: WIDTH - 1] + "…"


# ---------------------------------------------------------------------- frames


def _frames(scene: Scene, lanes: Sequence[Lane]) -> list[str]:
    lines: list[str] = []
    for number, frame in enumerate(scene.traffic):
        about = [] if frame.timestamp is None else [f"at {frame.timestamp} s"]
        about += [] if frame.channel is None else [f"on {frame.channel}"]
        lines.append(f"{number:4}  {image_text(frame)}  {', '.join(about)}".rstrip())
        for name, items in lanes:
            if not isinstance(items, str):
                item = items[number] if number < len(items) else None
                text = said(item) if item is not None else "nothing"
                lines.append(_clipped(f"{name:>4}    {text}"))
    for name, items in lanes:
        problem = f": {items}" if isinstance(items, str) else ""
        more = f" ({len(items)} of {len(scene)})" if not problem and len(items) != len(scene) else ""
        lines.append(f"{name:>4}  {TITLES[name]}{more}{problem}")
    return lines


def image_text(packet: Any) -> str:
    """Return a frame as candump writes it, or a packet's bytes."""
    if isinstance(packet, bytes):
        return packet.hex(" ").upper()
    if packet.is_error_frame:
        return f"{packet.arbitration_id | 0x2000_0000:08X}#{packet_bytes(packet).hex().upper()} (error frame)"
    identifier = f"{packet.arbitration_id:08X}" if packet.is_extended_id else f"{packet.arbitration_id:03X}"
    if packet.is_remote_frame:
        return f"{identifier}#R{packet.dlc if packet.dlc is not None else ''}"
    return f"{identifier}#{'#0' if packet.is_fd else ''}{packet_bytes(packet).hex().upper()}"


__all__ = ["image_text", "said", "scene_drawing"]
