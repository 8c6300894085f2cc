"""A small bus, and hands to feed it: what the tests of the live screen share."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from construct import Array, Byte, Int16sl, Int32sl, Struct

from aces_bus import Frame, make_scanner
from aces_bus.hardware.gate import Received
from aces_bus.protocol import IdField, Protocol, Quantity
from aces_tools.screen.model import Model, RepeatedFrame
from aces_tools.screen.paint import Needs, StyledText, visible_columns

MS = 1_000_000
S = 1_000_000_000

arm = Protocol("arm", link="can", bitrate=1_000_000, doc="An arm for tests.", source="no sheet")
Board = IdField("board", range(4))
arm.message(
    "Encoder",
    id=0x060 + Board,
    direction="from device",
    payload=Struct("position" / Array(2, Quantity(Int32sl, unit="count"))),
    doc="Positions of both motors.",
)
Command = arm.family(id=0x001, prefix=Struct("board" / Byte, "opcode" / Byte), direction="to device")
Command("Get", opcode=0x24, payload=Struct("selector" / Byte))

wire = Protocol("wire", link="serial", baud=115_200, doc="A line for tests.", source="no sheet")
packet = wire.framing(sync=b"\xaa", size=5)
packet("Sample", payload=Struct("servo" / Byte, "value" / Quantity(Int16sl, unit="mV"), "number" / Byte))


def scanner(protocol: Protocol = arm, **more: Any) -> Any:
    """A scanner as the screen needs it."""
    return make_scanner([protocol.variant()], include_unknown=True, **more)


def model(**more: Any) -> Model:
    """A model of the arm's bus."""
    return Model(scanner(), name="can0", **{"bitrate": 1_000_000, **more})


def encoder(board: int, first: int = 0, second: int = 0, at_ms: float = 0.0, **more: Any) -> Frame:
    """An encoder's frame, stamped."""
    data = first.to_bytes(4, "little", signed=True) + second.to_bytes(4, "little", signed=True)
    options: dict[str, Any] = {"channel": "can0", **more}
    return Frame(0x060 + board, data, 1000 + at_ms / 1000, **options)


def heard(*frames: Frame, at_ms: float = 0.0) -> list[Received[Frame]]:
    """Frames as a gate gives them, read at one instant."""
    return [Received(frame, round(at_ms * MS)) for frame in frames]


def periodic(made: Model, *, every_ms: float, count: int, board: int = 0, batch: int = 10) -> int:
    """Frames of one board, one after the other; when the last one came (ns)."""
    frames = [Received(encoder(board, n, at_ms=n * every_ms), round(n * every_ms * MS)) for n in range(count)]
    for start in range(0, count, batch):
        made.feed(frames[start : start + batch])
    return frames[-1].host_ns


def only(made: Model) -> RepeatedFrame:
    """The model's one row."""
    (row,) = made.rows.values()
    return row


def text(spans: Iterable[StyledText]) -> str:
    return "".join(span.text for span in spans)


def filled() -> tuple[Model, int]:
    """Three boards at 100, 50 and 10 Hz, and an unknown identifier."""
    made = model()
    for tick in range(200):
        frames = [encoder(0, tick, at_ms=10 * tick)]
        if tick % 2 == 0:
            frames.append(encoder(1, 7, at_ms=10 * tick))
        if tick % 10 == 0:
            frames += [encoder(2, tick // 50, at_ms=10 * tick), Frame(0x7FF, b"\xde\xad", channel="can1")]
        made.feed(heard(*frames, at_ms=10 * tick))
    return made, 1990 * MS


def cols(made: Model, width: int = 100) -> Any:
    return visible_columns(Needs.of(made, made.rows.values()), width)
