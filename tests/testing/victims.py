"""The protocols that faults are planted in: shipped ones, and small ones for what those do not use.

Each is declared anew when called, so that nothing that was generated earlier is used.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Callable

from construct import Byte, Const, GreedyBytes, Int16sl, Int16ul, Struct, this

from aces_bus.protocol import (
    BitLayout,
    Counter,
    Crc,
    Enumeration,
    Fletcher,
    IdField,
    Multiplexed,
    Protocol,
    Quantity,
    Slip,
    Split,
    Sum,
    Xor,
    bits,
)


def shipped(name: str) -> Callable[[], Protocol]:
    """A shipped protocol, declared anew when called."""

    def make() -> Protocol:
        spec = importlib.util.find_spec(f"aces_protocols.{name}.spec")
        assert spec is not None
        assert spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        made = getattr(module, name)
        assert isinstance(made, Protocol)
        return made

    make.__name__ = name
    return make


robotis, minihubo_adc, hubo = map(shipped, ("robotis", "minihubo_adc", "hubo"))


def a_bus() -> Protocol:
    """Frames with a split signed field, a check over the identifier too, scales, a counter, a multiplexer."""
    made = Protocol("victim", link="can")
    node = IdField("node", range(8))
    made.message(
        "Halves",
        id=0x10 + node,
        payload=BitLayout(2, "angle" / Split((8, 4), (0, 8), signed=True), "mode" / bits(4, at=12)),
    )
    made.message(
        "Checked",
        id=0x30 + node,
        check=Crc("CRC8-AUTOSAR", over=slice(1, None), field="crc"),
        payload=BitLayout(3, "crc" / bits(8), "value" / bits(16)),
    )
    made.message("Plain", id=0x40 + node, payload=Struct("value" / Int16ul, "more" / Byte))
    made.message(
        "Scaled",
        id=0x50 + node,
        payload=Struct(
            Const(b"\x07"),
            "volts" / Quantity(Int16sl, unit="V", scale=0.1, range=(-300, 300)),
            "state" / Enumeration(Byte, off=0, on=1),
        ),
    )
    made.message("Counted", id=0x60 + node, payload=Struct("count" / Counter(Byte)))
    made.message(
        "Muxed",
        id=0x70 + node,
        payload=Struct(
            "which" / Byte, "one" / Multiplexed("which", 1, Byte), "two" / Multiplexed("which", 2, Int16ul)
        ),
    )
    made.message("Far", id=0x18FF0000 + node, extended=True, payload=Struct("value" / Byte))
    return made


def two_dialects() -> Protocol:
    """One identifier that two dialects read otherwise."""
    made = Protocol("victim", link="can", dialects={"old": "bytes", "new": "a word"}, dialect="new")
    made.message("Old", id=0x20, dialect="old", payload=Struct("low" / Byte, "high" / Byte))
    made.message("New", id=0x20, dialect="new", payload=Struct("value" / Int16ul))
    return made


def a_line() -> Protocol:
    """A length of two bytes, a check of two, requests with their answers."""
    made = Protocol("victim", link="serial")
    packet = made.framing(
        sync=b"\xaa\x55",
        header=Struct("length" / Int16ul, "kind" / Byte),
        size=this.length + 7,
        max_size=1000,
        check=Fletcher(),
    )
    packet("Level", match={"kind": 1}, payload=Struct("level" / Quantity(Int16ul, scale=0.5), "more" / Byte))
    packet("Name", match={"kind": 2}, payload=Struct("name" / GreedyBytes))
    return made


def a_slip() -> Protocol:
    """Stuffed packets behind an end mark."""
    made = Protocol("victim", link="serial")
    packet = made.framing(end=b"\xc0", stuffing=Slip(), max_size=40, check=Sum())
    packet("Value", payload=Struct("kind" / Byte, "rest" / GreedyBytes))
    return made


def lines_of_text() -> Protocol:
    """Packets with an end mark."""
    made = Protocol("victim", link="serial")
    packet = made.framing(sync=b"$", end=b"\r\n", max_size=40, check=Xor())
    packet("Text", payload=Struct("text" / GreedyBytes))
    return made
