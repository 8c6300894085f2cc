"""Log messages of control units: flags say which fields the header has; a counter; the length of the whole."""

from __future__ import annotations

from construct import Byte, GreedyBytes, Int16ub, Int32ub, Struct, this

from aces_bus.protocol import Counter, Present, Protocol, Quantity, Text

trace = Protocol("trace", link="serial", baud=115_200, source="AUTOSAR DLT")
entry = trace.framing(
    sync=b"DLS\x01",
    header=Struct("flags" / Byte, "counter" / Counter(Byte), "length" / Int16ub),
    size=this.length + 4,
    max_size=256,
    gap=0.1,
)
entry(
    "Entry",
    direction="from device",
    payload=Struct(
        "unit" / Present("flags", 2, Text(4)),
        "session" / Present("flags", 3, Int32ub),
        "time" / Present("flags", 4, Quantity(Int32ub, unit="s", scale=1e-4)),
        "kind" / Byte,
        "arguments" / Byte,
        "application" / Text(4),
        "context" / Text(4),
        "text" / GreedyBytes,
    ),
)
