"""CRTD, the log of the Open Vehicle Monitoring System (OVMS).

    169.971289 CXX Info Type:crtd; Path:'/sd/can3.crtd'; Filter:3:0-ffffffff; Vehicle:TSHK;
    1542473901.020305 1R11 213 00 00 00 00 c0 01 00 00          received, 11-bit identifier, bus 1
    1542473901.020970 2T29 18DB33F1 02 01 0c                     sent, 29-bit identifier, bus 2
    19292.299819 CEV vehicle.alert this is a textual vehicle alert

1. Every line is one of: frame, comment (CXX, CVR), another record (`others`, by kind), blank, unreadable.
2. A record states no length: its bytes are all there is, and each must be one. No other text is taken for a number.
3. Times are seconds as written: from 1970, or from the start of the device.

*Facts*: the OVMS developer's guide, "CRTD CAN Log Format" (1.0 to 3.1). Identifiers and bytes are hexadecimal, with or
without zeros in front. Buses count from 1, and from 0 here; a record without one is of bus 1.
"""

from __future__ import annotations

import re

from aces_bus import Frame
from aces_bus.recordings.base import printable_start
from aces_bus.recordings.text.rows import FrameRow, LineCapture, RowText, UnreadableRow

_RECORD = re.compile(
    rb"([0-9]{1,12}\.[0-9]{1,9})\s+([0-9]{0,5})([A-Za-z][0-9A-Za-z]{2})(?:\s+(.*))?", re.DOTALL
)
_KINDS = {
    b"CER": "error records",
    b"CST": "statistics",
    b"CEV": "events",
    b"CMT": "metrics",
    b"CBC": "commands",
    b"CDP": "commands",
    b"CDR": "commands",
    b"CFC": "commands",
    b"CFA": "commands",
}


class CrtdCapture(LineCapture):
    """Frames of a CRTD log."""

    format = "CRTD log"
    _BEGINS = re.compile(rb"[0-9]{1,12}\.[0-9]{1,9}\s+[0-9]{0,5}[RT](?:11|29)\s", re.IGNORECASE)

    def _line(self, text: bytes) -> FrameRow | None:
        found = _RECORD.fullmatch(text)
        if found is None:
            raise UnreadableRow("not a CRTD record")
        stamp, bus, kind, rest = found.groups()
        kind = kind.upper()
        if kind[:1] == b"C":
            if kind in (b"CXX", b"CVR"):
                self._comment()
            else:
                self._other(_KINDS.get(kind, "other records"))
            return None
        if kind not in (b"R11", b"R29", b"T11", b"T29"):
            raise UnreadableRow(f"record type {printable_start(kind)} is not known")
        cells = (rest or b"").split()
        if not cells:
            raise UnreadableRow("no identifier")
        frame = Frame(
            RowText.integer(cells[0], 16, "identifier"),
            RowText.data(cells[1:], len(cells) - 1),
            None,
            RowText.one_less(int(bus or b"1")),
            kind[1:] == b"29",
            is_rx=kind[:1] == b"R",
        )
        return FrameRow(frame, RowText.nanoseconds(stamp))
