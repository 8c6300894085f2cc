"""Live lines for people: candump's time modes, and candump's own lines for what no protocol is named for.

     (1436509052.249713)  can0  123   [4]  DE AD BE EF

1. The lines are candump's, byte by byte, so that what reads candump reads these.
2. A delta is to the line before, as it is shown; the zero of `relative` is the first item received.

*Facts*: candump.c and lib.c of can-utils: times have ten digits before the point (`a`) or three (`d`, `z`); once a
29-bit identifier was shown, 11-bit ones are indented to its width.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from aces_bus import Frame
from aces_bus.plain_text import LOOKALIKES
from aces_bus.recordings.base import Chunk

from .output.text import Paint, Times, no_paint, printable


class CandumpLines:
    """Frames as candump shows them on a screen; bytes of a line in the same manner."""

    def __init__(self, times: Times, *, paint: Paint = no_paint, encoding: str = "utf-8") -> None:
        self._times, self._paint, self._encoding = times, paint, encoding
        self._is_wide = False
        self._width = 0

    def frames(self, frames: Sequence[Frame]) -> bytes:
        """Return one line a frame."""
        return self._joined(frames, self._frame)

    def chunks(self, chunks: Sequence[Chunk], name: str) -> bytes:
        """Return one line a piece of at most 16 bytes."""
        pieces = [
            Chunk(chunk.data[start : start + 16], chunk.time, chunk.direction)
            for chunk in chunks
            for start in range(0, len(chunk.data), 16)
        ]
        return self._joined(pieces, lambda piece: self._chunk(piece, name))

    def _joined(self, items: Sequence[Any], line: Callable[[Any], str]) -> bytes:
        return "".join(f"{line(item)}\n" for item in items).encode(self._encoding, LOOKALIKES)

    def _stamp(self, time: float | None) -> str:
        if time is None:
            return ""
        number = self._times.number(time)
        text = (
            self._times.date(time)
            if number is None
            else f"{number:0{17 if self._times.mode == 'absolute' else 10}.6f}"
        )
        return self._paint("place", f" ({text})")

    def _frame(self, frame: Frame) -> str:
        name = printable(str(frame.channel))
        self._width = max(self._width, len(name))
        wide = frame.is_extended_id or frame.is_error_frame
        self._is_wide = self._is_wide or frame.is_extended_id
        number = frame.arbitration_id | (0x2000_0000 if frame.is_error_frame else 0)
        identifier = f"{number:0{8 if wide else 3}X}".rjust(8 if self._is_wide else 3)
        size = f" [{frame.length:02}]" if frame.is_fd else f"  [{frame.length}]"
        data = "  remote request" if frame.is_remote_frame else f"  {frame.data.hex(' ').upper()}"
        mark = self._paint("errors", "   ERRORFRAME") if frame.is_error_frame else ""
        return (
            f"{self._stamp(frame.timestamp)}  {name:<{self._width}}  {identifier} {size}{data}{mark}".rstrip()
        )

    def _chunk(self, chunk: Chunk, name: str) -> str:
        arrow = {"to device": ">", "from device": "<"}.get(chunk.direction or "", "?")
        return f"{self._stamp(chunk.time)}  {printable(name)} {arrow}  [{len(chunk.data)}]  {chunk.data.hex(' ').upper()}"


def notation(frame: Frame) -> str:
    """Return a frame as cansend takes it: `123#DEADBEEF`, `12345678#`, `123##1AABB` (FD), `123#R8`.

    >>> notation(Frame(0x123, b"\\xde\\xad"))
    '123#DEAD'
    """
    identifier = f"{frame.arbitration_id:0{8 if frame.is_extended_id else 3}X}"
    if frame.is_remote_frame:
        return f"{identifier}#R{frame.length or ''}"
    flags = f"#{frame.bitrate_switch + 2 * frame.error_state_indicator}" if frame.is_fd else ""
    return f"{identifier}#{flags}{frame.data.hex().upper()}"
