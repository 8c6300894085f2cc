"""How a VESC's packets travel: in pieces on CAN, as they are on a serial line. All in which the two drivers differ."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from aces_bus.errors import CallerError
from aces_bus.protocol import Record
from aces_bus.protocol.record import FieldValue
from aces_protocols.vesc.buffers import Buffers
from aces_protocols.vesc_uart.packets import PacketReader, packet_of

#: What answers a packet, by its message.
ANSWERED_BY = {"GetSelected": ("Selected",), "GetFirmware": ("Firmware",)}
#: What carries an answer on CAN, and what comes by itself.
PIECES = ("ShortAnswer", "LongAnswer")
STATUS = ("Status", "Status4", "Status5")


class CanWire:
    """Packets to one controller on CAN; the controller's answers go to a host number of its own."""

    #: All messages that give values.
    gives = (*PIECES, *STATUS)
    #: How often a stop is sent again before it is asked whether it was obeyed: a frame is not lost.
    stops = 0

    def __init__(self, name: str, credentials: dict[str, int], host: int | None) -> None:
        number = credentials["id"]
        usual = number ^ 0x80 if number not in (0x7F, 0xFF) else 0xFE
        self.host_number = usual if host is None else host
        if self.host_number == number:
            raise CallerError(f"{name}: the setting host is its own number {number}; give a free one")
        # Pieces of answers have no sender; that they go to this number makes them this device's.
        credentials["receiver"] = self.host_number
        self._buffers = Buffers(self.host_number)
        self._reader = PacketReader("from device")

    def request(self, packet: str, fields: Mapping[str, Any]) -> tuple[str, dict[str, Any]]:
        """Return the message that carries a packet, and its fields."""
        return "ShortRequest", {"host": self.host_number, "mode": 0, "packet": packet_of(packet, **fields)}

    def answers(self, packet: str) -> tuple[str, ...]:
        """Return the messages of which one ends the answer to a packet."""
        return PIECES

    def taken(self, record: Record) -> tuple[Any, bool]:
        """Return the answer that a record ends, None where it ends none; and whether one ends that is not whole."""
        packet = self._buffers.take(record)
        answer = None if packet is None else self._reader.read(packet)
        return answer, packet is None and type(record).__name__ in PIECES


class SerialWire:
    """Packets to the one controller at a serial line."""

    gives = tuple(name for names in ANSWERED_BY.values() for name in names)
    #: As of `CanWire`: longer than a disturbance usually is.
    stops = 4

    def request(self, packet: str, fields: Mapping[str, FieldValue]) -> tuple[str, dict[str, FieldValue]]:
        """Return the packet itself."""
        return packet, dict(fields)

    def answers(self, packet: str) -> tuple[str, ...]:
        """Return the message that answers a packet."""
        return ANSWERED_BY[packet]

    def taken(self, record: Record) -> tuple[Any, bool]:
        """Return the record itself."""
        return record, False
