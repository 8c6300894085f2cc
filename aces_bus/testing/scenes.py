"""What happens on a wire, drawn: valid packets, damage, garbage, requests of ours, silence.

1. A scene is data: the traffic, where the line fell silent, what we sent in between. Laws play it, cut as they like.
2. Valid first, then broken: most of a scene can be read, so that what is broken is where it matters.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any, Literal

from msgspec.structs import replace

from ..errors import AcesError
from ..frames import FD_LENGTHS, Frame
from ..protocol.declare.framing import Framing
from ..protocol.declare.message import Direction, Message
from ..protocol.declare.protocol import Variant
from ..protocol.live.stream import WORTH
from .packets import DrawnPacket, draw_packet, image_frame
from .source import ChoiceSource, spread

Way = Direction | Literal["both"] | None
#: One variant, or several on one wire.
Wire = Variant | Sequence[Variant]


@dataclass(frozen=True)
class Scene:
    """A wire's history. `traffic` is bytes (streams) or frames (CAN); offsets count bytes or frames.

    `idle_at`: the line fell silent when so many had come. `sent_at`: we sent this packet or frame then (at the same
    place, after the silence). `packets` are the valid ones that it was made of.
    """

    traffic: Any
    idle_at: tuple[int, ...] = ()
    sent_at: tuple[tuple[int, Any], ...] = ()
    packets: tuple[DrawnPacket, ...] = field(default=(), repr=False)

    def __len__(self) -> int:
        return len(self.traffic)


def wire_variants(wire: Wire) -> tuple[Variant, ...]:
    """Return the variants of a wire, in order."""
    return (wire,) if isinstance(wire, Variant) else tuple(wire)


@dataclass(frozen=True)
class Cast:
    """Who may speak on a wire: messages that the scanner looks for, and requests that we may send."""

    messages: tuple[tuple[Variant, Message], ...]
    framings: tuple[Framing, ...]
    can_send: bool

    @staticmethod
    def of(wire: Wire, direction: Way) -> Cast:
        """Return who may speak on a wire in a direction."""
        return _cast(wire_variants(wire), direction)


@lru_cache(maxsize=1024)
def _cast(variants: tuple[Variant, ...], direction: Way) -> Cast:
    messages = tuple((v, m) for v in variants for m in v.messages_for(direction))
    framings = dict.fromkeys(m.framing for _, m in messages if m.framing is not None)
    return Cast(messages, tuple(framings), direction != "to device")


# ---------------------------------------------------------------------- streams


def draw_stream(wire: Wire, direction: Way, source: ChoiceSource, *, size: int = 400) -> Scene:
    """Return a byte stream of about `size` bytes: packets of any message, whole and damaged, and what only looks like
    them.
    """
    who = Cast.of(wire, direction)
    data = bytearray()
    idle_at: list[int] = []
    sent_at: list[tuple[int, Any]] = []
    packets: list[DrawnPacket] = []
    while len(data) < size and not source.is_dry:
        how, part = source.integer(0, 31), source.branch()
        if how == 0 and part.is_dry:
            continue  # zeros are nothing, so that shrinking drops a part wherever it is
        if how == 31:
            idle_at.append(len(data))
            continue
        if how >= 26:
            data += Damage.garbage(who, part)
            continue
        packet = _pick(who, part)
        if packet.request is not None and part.integer(0, 7):
            _ask(packet.request, who, direction, data, sent_at, part)
        piece = packet.image
        if how < 17:
            packets.append(packet)
        elif how < 24:
            piece = Damage.packet(packet, how - 17, part)
        elif how == 24:
            at = part.integer(0, len(piece))
            piece = piece[:at] + _pick(who, part).image + piece[at:]
        else:
            piece = piece * part.integer(2, 3)
        data += piece
        if packet.message.framing is not None and packet.message.framing.is_silent and part.integer(0, 15):
            idle_at.append(len(data))
    return Scene(bytes(data), tuple(dict.fromkeys(idle_at)), tuple(sent_at), tuple(packets))


def _pick(who: Cast, source: ChoiceSource) -> DrawnPacket:
    variant, message = source.choice(who.messages)
    return draw_packet(message, source, variant)


def _ask(
    request: DrawnPacket,
    who: Cast,
    direction: Way,
    data: bytearray,
    sent_at: list[tuple[int, Any]],
    source: ChoiceSource,
) -> None:
    """Put a request before its reply: on the wire where the scanner receives it, else as a transmission of ours."""
    if direction == "both" and source.integer(0, 3):
        data += request.image
    elif who.can_send:
        sent_at.append((len(data), request.image))


class Damage:
    """Packets and frames made wrong, in a number of ways each."""

    #: In how many ways a packet is damaged.
    OF_PACKET = 7
    #: In how many ways a frame is damaged.
    OF_FRAME = 10

    @staticmethod
    def packet(packet: DrawnPacket, how: int, source: ChoiceSource) -> bytes:
        """Return a stream's packet with something wrong: other contents, cut, bits flipped, a false header before it."""
        piece = packet.image
        if how == 0:
            return _rewrapped(packet, source)
        if how == 1:
            return piece[: source.integer(0, len(piece) - 1)]
        if how == 2:
            return piece[source.integer(1, len(piece)) :]
        if how < 5:
            return _flipped(piece, source)
        if how == 5:
            return _header(packet, source) + piece
        return _overwritten(packet, source)

    @staticmethod
    def garbage(who: Cast, source: ChoiceSource) -> bytes:
        """Draw bytes of no packet: random, or made of what the framings look for."""
        size = source.integer(1, 24)
        how = source.integer(0, 3)
        framing = source.choice(who.framings)
        marks = framing.sync or framing.end
        if how == 0 or not marks:
            return source.bytes(size)
        if how == 1:
            return (marks * size)[:size]
        if how == 2:
            pieces = [
                marks[: source.integer(0, len(marks))],
                source.bytes(1),
                framing.end,
                b"\xff",
                framing.short_end or b"\x00",
            ]
            return b"".join(source.choice(pieces) for _ in range(size))
        byte = bytes([source.integer(0, 255)])
        if framing.not_inside and byte not in framing.not_inside + framing.end:
            return framing.sync + byte * framing.max_size  # chance alone hardly ever leaves out an end
        return byte * size

    @staticmethod
    def frame(frame: Frame, message: Message, how: int, source: ChoiceSource) -> Frame:
        """Return a frame with something wrong: shorter, longer, bits flipped, another identifier or kind."""
        data = frame.data
        if message.check is not None and source.integer(0, 1) and len(data) in (message.lengths or ()):
            return replace(frame, data=rechecked(message, frame.arbitration_id, _flipped(data, source)))
        if how in (0, 1):
            shorter = _legal(source.integer(0, max(0, len(data) - 1)), fd=frame.is_fd)
            return replace(frame, data=data[:shorter]) if data else frame
        if how in (2, 3):
            longer = _legal(source.integer(len(data), 64 if frame.is_fd else 8), fd=frame.is_fd)
            return (
                frame
                if frame.is_remote_frame
                else replace(frame, data=(data + source.bytes(longer))[:longer])
            )
        if how in (4, 5):
            return replace(frame, data=_flipped(data, source)) if data else frame
        if how == 6:
            limit = 0x1FFF_FFFF if frame.is_extended_id else 0x7FF
            return replace(
                frame,
                arbitration_id=(frame.arbitration_id ^ 1 << source.integer(0, limit.bit_length() - 1))
                & limit,
            )
        if how == 7:
            return replace(
                frame,
                data=b"",
                is_remote_frame=True,
                is_fd=False,
                dlc=source.choice((None, source.integer(0, 8))),
            )
        if how == 8:
            return replace(frame, is_remote_frame=False, is_fd=not frame.is_fd, data=data[:8], dlc=None)
        if frame.is_extended_id:
            return replace(frame, is_extended_id=False, arbitration_id=frame.arbitration_id & 0x7FF)
        return replace(frame, is_extended_id=True)


def _flipped(piece: bytes, source: ChoiceSource) -> bytes:
    out = bytearray(piece)
    for _ in range(source.integer(1, 3)):
        bit = source.integer(0, 8 * len(out) - 1)
        out[bit // 8] ^= 1 << bit % 8
    return bytes(out)


def _header(packet: DrawnPacket, source: ChoiceSource) -> bytes:
    """Return the first bytes of a packet once more, with a length that promises much or little."""
    framing = packet.message.framing
    assert framing is not None
    head = bytearray(packet.image[: max(1, framing.head_end)])
    if framing.affine is not None and source.integer(0, 1):
        length = framing.affine.length
        most = (1 << 8 * length.size) - 1
        number = source.choice(
            (
                most,
                0,
                1,
                min(most, len(packet.image)),
                min(most, 2 * len(packet.image)),
                source.integer(0, most),
            )
        )
        head[length.offset : length.offset + length.size] = length.bytes(number)
    return bytes(head) * source.integer(1, 4)


def _overwritten(packet: DrawnPacket, source: ChoiceSource) -> bytes:
    """Return a packet with another byte in its head, in its check or anywhere."""
    framing = packet.message.framing
    out = bytearray(packet.image)
    last = len(out) - 1
    edge = max(1, framing.head_end) if framing is not None else 1
    at = source.choice((source.integer(0, last), min(last, source.integer(0, edge)), last, max(0, last - 1)))
    out[at] = source.choice((0x00, 0xFF, source.integer(0, 255)))
    return bytes(out)


def _rewrapped(packet: DrawnPacket, source: ChoiceSource) -> bytes:
    """Draw other contents in the same framing, with right length and check."""
    message = packet.message
    framing = message.framing
    assert framing is not None
    logical = framing.logical(packet.image)
    end = len(logical) - framing.check_size - len(framing.end)
    head, body = logical[len(framing.sync) : framing.head_end], logical[framing.head_end : end]
    if head and source.integer(0, 3) == 0:
        head = _flipped(head, source)
    how = source.integer(0, 3)
    if how == 0 and body:
        body = _flipped(body, source)
    elif how == 1:
        body = body[: source.integer(0, len(body))]
    elif how == 2:
        body += source.bytes(source.integer(1, 4))
    else:
        body = source.bytes(source.integer(0, len(body) + 4))
    try:
        made = message.struct.framed(framing, head, body)
        if framing.short_end and source.integer(0, 1):
            made = made[: -len(framing.end)] + framing.short_end
        return made
    except AcesError:  # too long, or its end mark inside
        return packet.image


def adversary(wire: Wire, direction: Way, source: ChoiceSource, *, size: int = 3000) -> bytes:
    """Draw headers that all promise a long packet: what costs a scanner most."""
    framing = source.choice(Cast.of(wire, direction).framings)
    unit = bytearray(framing.sync)
    for head in framing.heads:
        unit += source.choice((b"\x01", framing.sync[:1] or b"\0", b"\xfe", source.bytes(1))) * head.size
    if framing.affine is not None:
        length = framing.affine.length
        most = min(
            (1 << 8 * length.size) - 1, (framing.max_size - framing.affine.constant) // framing.affine.factor
        )
        number = source.choice((most, most - 1, max(0, most // 2), source.integer(0, most)))
        unit[length.offset : length.offset + length.size] = length.bytes(number)
    if not unit:
        unit += source.bytes(3)
    if source.integer(0, 3) == 0:
        unit += source.bytes(source.integer(1, 5))
    return (bytes(unit) * (size // len(unit) + 1))[:size]


# ---------------------------------------------------------------------- frames


def draw_frames(wire: Wire, direction: Way, source: ChoiceSource, *, size: int = 24) -> Scene:
    """Draw about `size` CAN frames: valid, nearly valid, foreign, remote, FD, extended, error frames.

    Packets of several frames are under way at the same time; frames of them are lost, come twice or in another order.
    """
    who = Cast.of(wire, direction)
    frames: list[Frame] = []
    under_way: list[list[Frame]] = []
    sent_at: list[tuple[int, Any]] = []
    packets: list[DrawnPacket] = []
    time: float | None = 0.0 if source.integer(0, 3) else None
    while len(frames) < size and not source.is_dry:
        how, part = source.integer(0, 31), source.branch()
        if how == 0 and part.is_dry:
            continue  # zeros are nothing, so that shrinking drops a part wherever it is
        channel = part.choice((None, None, None, "can0", "can1"))
        if time is not None:
            time = round(time + part.choice((0.0, 0.001, 0.001, 0.02, 0.7)), 6)
        about: dict[str, Any] = {
            "timestamp": time if part.integer(0, 15) else None,
            "channel": channel,
            "is_rx": part.choice((None, True, False)),
        }
        if under_way and part.integer(0, 3):
            mine = part.choice(under_way)
            frames.append(replace(mine.pop(0), timestamp=time))
            under_way = [left for left in under_way if left]
            continue
        if how >= 30:
            frames.append(_foreign(part, about))
            continue
        if how == 29:
            frames.append(
                Frame(
                    part.integer(0, 0x1FFF_FFFF), part.bytes(part.integer(0, 8)), is_error_frame=True, **about
                )
            )
            continue
        packet = _pick(who, part)
        if packet.request is not None and part.integer(0, 7):
            asked = packet.request.carried(**about)
            if direction in (None, "both") and part.integer(0, 3):
                frames += asked
            elif who.can_send:
                sent_at += [(len(frames), request) for request in asked]
        if packet.message.transport is not None:
            carried = packet.carried(part.integer(0, 3), **about)
            if how < 20:
                packets.append(packet)
            else:
                carried = _jumbled(carried, packet.message, how - 20, part)
                if carried and part.integer(0, 3) == 3:
                    carried = _jumbled(carried, packet.message, part.integer(0, 11), part)
            if carried:
                under_way.append(carried)
            continue
        frame = image_frame(packet.image, **about)
        if how < 20:
            packets.append(packet)
        else:
            frame = Damage.frame(frame, packet.message, how - 20, part)
        frames.append(frame)
    for left in under_way:
        # Some packets are whole; of others the scene has only the beginning.
        frames += [
            replace(frame, timestamp=time) for frame in left[: source.integer(0, min(40, 2 * len(left)))]
        ]
    return Scene(tuple(frames), (), tuple(sent_at), tuple(packets))


def _jumbled(frames: list[Frame], message: Message, how: int, source: ChoiceSource) -> list[Frame]:
    """Return the frames of a packet with something wrong: lost, twice, in another order, damaged, steered."""
    out = list(frames)
    at = source.integer(0, len(out) - 1)
    if how in (0, 1):
        del out[at : at + source.integer(1, 2)]
    elif how in (2, 3):
        out.insert(source.integer(at, len(out)), out[at])
    elif how in (4, 5):
        out.insert(source.integer(0, len(out) - 1), out.pop(at))
    elif how == 6:
        assert message.transport is not None
        steering = [kind for kind in message.transport.kinds if kind.role == "control"]
        data = bytearray(8)
        for bits, value in source.choice(steering).match if steering else ():
            bits.put(data, value)
        out.insert(at, replace(out[at], data=bytes(data)))
    elif how == 7:
        out = out[:at] + frames
    else:
        out[at] = Damage.frame(out[at], message, source.integer(0, 9), source)
    return out


def rechecked(message: Message, identifier: int, data: bytes) -> bytes:
    """Return frame data with the check that goes with them."""
    check = message.check
    assert check is not None
    start, size, order = message.check_span
    wanted = check.compute(message.covered(data, identifier))
    return data[:start] + wanted.to_bytes(size, order) + data[start + size :]


def _legal(size: int, *, fd: bool) -> int:
    return max(n for n in FD_LENGTHS if n <= size) if fd else min(size, 8)


def _foreign(source: ChoiceSource, about: dict[str, Any]) -> Frame:
    extended, fd = not source.integer(0, 3), not source.integer(0, 3)
    identifier = source.integer(0, 0x1FFF_FFFF if extended else 0x7FF)
    size = source.choice(FD_LENGTHS) if fd else source.integer(0, 8)
    return Frame(identifier, source.bytes(size), is_extended_id=extended, is_fd=fd, **about)


# ---------------------------------------------------------------------- either


def draw_scene(wire: Wire, direction: Way, source: ChoiceSource, *, size: int = 400) -> Scene:
    """Draw a scene for the link of the wire; `size` in bytes, or in frames of 16 bytes."""
    if wire_variants(wire)[0].link == "can":
        return draw_frames(wire, direction, source, size=max(1, size // 16))
    # Long chunks take another path through the scanner: some scenes must be longer than that.
    if source.integer(0, 7) == 7:
        return draw_stream(wire, direction, spread(source.integer(1, 1 << 24), 2048), size=2 * WORTH)
    return draw_stream(wire, direction, source, size=size)


def draw_cuts(scene: Scene, source: ChoiceSource) -> tuple[int, ...]:
    """Return where to cut a scene: offsets, in order, perhaps repeated (an empty chunk)."""
    size = len(scene)
    how = source.integer(0, 3)
    if how == 0:
        return tuple(range(1, size))
    if how == 1:
        step = source.integer(1, 9)
        return tuple(range(step, size, step))
    count = source.integer(0, 12)
    return tuple(sorted(source.integer(0, size) for _ in range(count)))


__all__ = [
    "Cast",
    "Damage",
    "Scene",
    "Way",
    "Wire",
    "adversary",
    "draw_cuts",
    "draw_frames",
    "draw_scene",
    "draw_stream",
    "rechecked",
    "wire_variants",
]
