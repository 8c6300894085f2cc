"""ISO-TP (ISO 15765-2): packets of up to 4095 bytes in CAN frames, as diagnostics use it.

Facts: the frame types, their fields and limits are those of ISO 15765-2 as python-can-isotp 2 carries them out
(`isotp/protocol.py`, `isotp/address.py`).
Choice: only what is received is judged; a receiver's flow control is counted and is not a part of a packet.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal

from ...errors import SpecError
from ...frames import EXTENDED
from .handshake import Steering
from .pattern import IdPattern, as_pattern
from .place import caller
from .transport import FrameKind, FrameNumber, Transport

_TYPE = FrameNumber(0, 0xF0)


def _kinds(address: int) -> tuple[FrameKind, ...]:
    most = 7 - address
    return (
        FrameKind("next", "consecutive frame", ((_TYPE, 2),), number=FrameNumber(0, 0x0F)),
        FrameKind(
            "single",
            "long single frame",
            ((FrameNumber(0), 0),),
            2,
            size=FrameNumber(1),
            least=most + 1,
            over=8 - address,
        ),
        FrameKind("single", "single frame", ((_TYPE, 0),), size=FrameNumber(0, 0x0F), least=1, most=most),
        FrameKind(
            "first",
            "long first frame",
            ((FrameNumber(0, size=2), 0x1000),),
            6,
            size=FrameNumber(2, size=4),
            least=4096,
        ),
        FrameKind(
            "first",
            "first frame",
            ((_TYPE, 1),),
            2,
            size=FrameNumber(0, 0x0FFF, size=2),
            least=most + 1,
            most=4095,
        ),
        FrameKind("control", "flow control", ((_TYPE, 3),)),
    )


@dataclass(frozen=True)
class IsoTp(Transport):
    """ISO-TP. Messages name their identifiers (`id=`), or the transport names both, and a message its direction:

        uds = IsoTp(to_device=0x7E0 + Ecu, from_device=0x7E8 + Ecu)
        p.message("ReadData", transport=uds, direction="to device", payload=…)

    Give both where long messages are sent: flow control comes back with the other identifier. `addressing`: with "extended"
    and "mixed" the first byte of each frame is an address (of the target; an extension), and so is the first byte of each
    packet. With "extended", flow control needs both addresses: `device_address` begins what is sent to the device,
    `tester_address` what it sends; numbers, or captures such as identifiers have. `fd`: CAN FD, frames of up to 64 bytes.
    `pad`: fill frames up to 8 bytes with this one.

    Numbers of consecutive frames begin at 1, and behind 15 comes 0. `timeout_s` is N_Cr, 1 s (ISO 15765-2).
    """

    title: ClassVar[str] = "ISO-TP"

    to_device: Any = None
    from_device: Any = None
    extended: bool = False
    addressing: Literal["normal", "extended", "mixed"] = "normal"
    device_address: Any = None
    tester_address: Any = None
    address: int = field(default=0, init=False, repr=False)
    kinds: tuple[FrameKind, ...] = field(default=(), init=False, repr=False)
    modulo: int = field(default=16, init=False, repr=False)
    first_number: int = field(default=1, init=False, repr=False)
    any_order: bool = field(default=False, init=False, repr=False)

    def __post_init__(self) -> None:
        if self.addressing not in ("normal", "extended", "mixed"):
            raise SpecError(
                f"{caller()}: addressing of ISO-TP is normal, extended or mixed, not {self.addressing!r}"
            )
        object.__setattr__(self, "address", 0 if self.addressing == "normal" else 1)
        object.__setattr__(self, "kinds", _kinds(self.address))
        for name in ("to_device", "from_device", "device_address", "tester_address"):
            given = getattr(self, name)
            if given is not None:
                object.__setattr__(self, name, as_pattern(given, name))
                if name.endswith("address") and (
                    self.addressing != "extended" or getattr(self, name).bits > 0xFF
                ):
                    raise SpecError(f"{caller()}: {name} is a byte, of extended addressing")
        super().__post_init__()

    @property
    def patterns(self) -> tuple[tuple[IdPattern, bool], ...]:
        return tuple((way, self.extended) for way in (self.to_device, self.from_device) if way is not None)

    def answered_by(self, key: int, address: bytes = b"") -> tuple[int, bytes] | None:
        """Return the key and the address of frames that go the other way; None where the transport does not say both."""
        ways = (self.to_device, self.device_address), (self.from_device, self.tester_address)
        for (way, its), (other, others) in (ways, ways[::-1]):
            captures = way.match(key & 0x1FFF_FFFF) if way is not None else None
            inside = self._within(its, address)
            if captures is None or inside is None or other is None:
                continue
            known = {**captures, **inside}
            needed = (*other.captures, *(others.captures if others is not None else ()))
            if not {c.name for c in needed} <= set(known):
                continue
            if self.addressing == "extended":
                if others is None:
                    continue
                address = bytes((others.number(known),))
            return (key & EXTENDED) | int(other.number(known)), address
        return None

    def _within(self, pattern: IdPattern | None, address: bytes) -> dict[str, int] | None:
        """Return what the address of a frame captures; None where it is another's."""
        if self.addressing != "extended" or pattern is None:
            return {}
        return pattern.match(address[0]) if address else None

    def addressed(self, key: int, data: bytes) -> dict[str, int] | None:
        """Return what the address byte of a frame captures, where that is declared; None where it is not for this way."""
        ways = (self.to_device, self.device_address), (self.from_device, self.tester_address)
        for way, its in ways:
            if way is not None and way.match(key & 0x1FFF_FFFF) is not None:
                return self._within(its, data[: self.address])
        return {}

    def go_ahead(self, key: int, data: bytes, start: int = 1, frames: int = 0) -> tuple[int, bytes] | None:
        """Return a flow control: go on, with all of it, at full speed. None if its identifier or address is
        not declared.
        """
        address = data[: self.address]
        back = self.answered_by(key, address)
        if back is None or self.part(key, data).role != "first":
            return None
        return back[0], self.padded(back[1] + b"\x30\x00\x00")

    def steering(self, key: int, data: bytes) -> Steering | None:
        """Return what flow control says: status, block size, the least time between frames (ISO 15765-2: up to 127 ms,
        or 100 µs to 900 µs; reserved values mean 127 ms)."""
        body, back = data[self.address :], self.answered_by(key, data[: self.address])
        if back is None or len(body) < 3 or body[0] >> 4 != 3:
            return None
        status, block, least = body[0] & 0x0F, body[1], body[2]
        if 0xF1 <= least <= 0xF9:
            gap_ns = (least - 0xF0) * 100_000
        else:
            gap_ns = min(least, 0x7F) * 1_000_000
        go: Literal["on", "wait", "stop"] = "on" if status == 0 else "wait" if status == 1 else "stop"
        return Steering(go, back[0], block, gap_ns, opening=((0, back[1]),))

    def identifier(self, direction: str | None) -> IdPattern | None:
        """Return the identifier of packets in a direction, where the transport names it."""
        found: IdPattern | None = {"to device": self.to_device, "from device": self.from_device}.get(
            direction or ""
        )
        return found


__all__ = ["IsoTp"]
