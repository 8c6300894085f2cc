"""Makes a scene that breaks a law small: first fewer frames or bytes, then shorter packets, then simpler values.

1. Whatever is tried is a whole scene, and kept only when the same law fails on it. The result fails, always.
2. The number of trials is bounded; what is best by then is the answer.
3. A packet is cut as a packet: bytes are taken out of its contents, and its length and check are made to fit again.

Deleting bytes blindly (delta debugging) cannot shorten a packet with a check; rebuilding alone cannot show that half a
header is enough. The passes take turns until none helps.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import construct as c
from msgspec import structs

from ..errors import AcesError
from ..frames import Frame
from ..protocol.declare.framing import Framing, Verdict
from ..protocol.declare.message import Message
from .bench import Bench
from .packets import DrawnPacket
from .scenes import Scene, rechecked

T = TypeVar("T")
Cuts = tuple[int, ...]
#: A scene of so many frames or bytes may fail only because it is long: one that is cut may then fail, too, and be short.
LONG = 256
#: Fewer are not taken out of the middle of such a scene.
COARSE = 32
Fails = Callable[[Scene, Cuts], bool]


@dataclass
class Calls:
    """How many trials may still be made, and how many were; long scenes count as several."""

    most: int
    made: int = 0

    @property
    def are_left(self) -> bool:
        return self.made < self.most


def shrunk(bench: Bench, scene: Scene, cuts: Cuts, fails: Fails, calls: Calls) -> tuple[Scene, Cuts]:
    """Return the smallest scene and cuts found on which `fails` still says so. `scene` must fail."""
    best = _Best(scene, cuts, fails, calls)
    if scene.packets:
        best.offer(replace(scene, packets=()), cuts)
    if best.scene.packets:
        _packets(best)
    _without_events(best)
    passes = _of_frames if bench.is_can else _of_bytes
    while calls.are_left:
        before = best.weight
        passes(bench, best)
        _without_events(best)
        if best.weight >= before:
            break
    return best.scene, best.cuts


class _Best:
    """The smallest so far."""

    def __init__(self, scene: Scene, cuts: Cuts, fails: Fails, calls: Calls) -> None:
        self.scene, self.cuts = scene, cuts
        self._fails, self.calls = fails, calls
        self.weight = _weight(scene, cuts)

    def offer(self, scene: Scene, cuts: Cuts | None = None, *, equal: bool = False) -> bool:
        """Take a scene when it is smaller and fails."""
        cuts = self.cuts if cuts is None else cuts
        weight = _weight(scene, cuts)
        if not (weight < self.weight or (equal and weight == self.weight)) or not self.calls.are_left:
            return False
        self.calls.made += 1 + len(scene) // 256
        if not self._fails(scene, cuts):
            return False
        self.scene, self.cuts, self.weight = scene, cuts, weight
        return True


def _weight(scene: Scene, cuts: Cuts) -> tuple[int, ...]:
    """Return the weight of a scene; smaller is better: frames or bytes, events, cuts, then values."""
    events = len(scene.idle_at) + sum(1 + len(packet_bytes(packet)) for _, packet in scene.sent_at)
    packets = sum(1 + len(p.image) for p in scene.packets)
    if isinstance(scene.traffic, bytes):
        nonzero, total = len(scene.traffic) - scene.traffic.count(0), sum(scene.traffic)
        return len(scene.traffic) + packets, events, len(cuts), nonzero, total
    data = [packet_bytes(frame) for frame in scene.traffic]
    sizes = sum(map(len, data))
    marks = sum(
        (f.timestamp is not None) + (f.channel is not None) + (f.is_rx is not None) + (f.dlc is not None)
        for f in scene.traffic
    )
    total = sum(map(sum, data)) + sum(f.arbitration_id for f in scene.traffic)
    nonzero = sum(len(d) - d.count(0) for d in data)
    values = sum(len(p.image) - p.image.count(0) for p in scene.packets)
    return len(data) + packets, events, len(cuts), sizes, marks, nonzero, total, values


def packet_bytes(packet: Any) -> bytes:
    """Return the bytes of a packet or a frame."""
    return packet if isinstance(packet, bytes) else bytes(packet.data)


# ---------------------------------------------------------------------- events, and parts taken out


def _without_events(best: _Best) -> None:
    best.offer(replace(best.scene, idle_at=(), sent_at=()), ())
    for cuts in ((), _inside(best)):
        best.offer(best.scene, cuts)
    best.offer(replace(best.scene, idle_at=()))
    best.offer(replace(best.scene, sent_at=()))
    for index in reversed(range(len(best.cuts))):
        best.offer(best.scene, _but(best.cuts, index))
    for index in reversed(range(len(best.scene.idle_at))):
        best.offer(replace(best.scene, idle_at=_but(best.scene.idle_at, index)))
    for index in reversed(range(len(best.scene.sent_at))):
        best.offer(replace(best.scene, sent_at=_but(best.scene.sent_at, index)))


def _but(items: tuple[T, ...], index: int, *others: T) -> tuple[T, ...]:
    """Return items without one, or with others in its place."""
    return (*items[:index], *others, *items[index + 1 :])


def _inside(best: _Best) -> Cuts:
    """Return cuts that cut something, each once."""
    return tuple(sorted({cut for cut in best.cuts if 0 < cut < len(best.scene)}))


def without(scene: Scene, cuts: Cuts, start: int, stop: int) -> tuple[Scene, Cuts]:
    """Return a scene without the frames or bytes `start`…`stop`; what follows moves up."""

    def moved(offset: int) -> int:
        return offset if offset <= start else max(start, offset - (stop - start))

    return (
        replace(
            scene,
            traffic=scene.traffic[:start] + scene.traffic[stop:],
            idle_at=tuple(dict.fromkeys(moved(o) for o in scene.idle_at)),
            sent_at=tuple((moved(o), packet) for o, packet in scene.sent_at),
        ),
        tuple(moved(cut) for cut in cuts),
    )


def _delete(best: _Best) -> None:
    """Leave out ever smaller runs (delta debugging); of what stays long, large runs and its end only."""
    size = max(1, len(best.scene) // 2)
    while best.calls.are_left:
        start = max(0, len(best.scene) - size)
        while best.calls.are_left:
            scene, cuts = without(best.scene, best.cuts, start, min(len(best.scene), start + size))
            if not best.offer(scene, cuts) and not cuts and len(best.scene) > LONG:
                best.offer(scene, (len(scene) // 2,))
            if start <= 0:
                break
            start = max(0, min(start, len(best.scene)) - size)
        if size == 1:
            return
        size //= 2
        if size < COARSE and len(best.scene) > LONG:
            break
    while size and best.calls.are_left:
        scene, cuts = without(best.scene, best.cuts, max(0, len(best.scene) - size), len(best.scene))
        if not best.offer(scene, cuts):
            size //= 2


# ---------------------------------------------------------------------- bytes


def _of_bytes(bench: Bench, best: _Best) -> None:
    _delete(best)
    _zeroed(best)
    _repacked(bench, best)
    _events_repacked(bench, best)
    for at in reversed(range(len(best.scene))):
        any(best.offer(replace(best.scene, traffic=traffic)) for traffic in _lowered(best.scene.traffic, at))


def _lowered(data: bytes, at: int) -> list[bytes]:
    """Return data with a smaller byte at a place."""
    return [
        data[:at] + bytes([value]) + data[at + 1 :] for value in (0, 1, data[at] >> 1) if value < data[at]
    ]


def _zeroed(best: _Best) -> None:
    """Replace runs of bytes by zeros, ever shorter runs: data that must be long may still say little."""
    size = len(best.scene) // 2
    while size > 1 and best.calls.are_left:
        for start in range(0, len(best.scene), size):
            traffic = best.scene.traffic
            if any(traffic[start : start + size]):
                zeros = bytes(len(traffic[start : start + size]))
                best.offer(replace(best.scene, traffic=traffic[:start] + zeros + traffic[start + size :]))
        size //= 2


def _repacked(bench: Bench, best: _Best) -> None:
    """Replace packets by ones with less in them, each until nothing helps."""
    start = 0
    while start < len(best.scene) and best.calls.are_left:
        if not any(
            _replaced(best, start, *less) for less in smaller_packets(bench, best.scene.traffic, start)
        ):
            start += 1


def _replaced(best: _Best, start: int, size: int, smaller: bytes) -> bool:
    """Offer the scene with other bytes in the place of a packet."""
    scene, cuts = best.scene, best.cuts
    if len(smaller) < size:
        scene, cuts = without(scene, cuts, start + len(smaller), start + size)
    traffic = scene.traffic[:start] + smaller + scene.traffic[start + len(smaller) :]
    return best.offer(replace(scene, traffic=traffic), cuts)


def _events_repacked(bench: Bench, best: _Best) -> None:
    """Replace packets that we sent by smaller ones."""
    for index in range(len(best.scene.sent_at)):
        while any(
            best.offer(_with_sent(best.scene, index, smaller))
            for _, smaller in smaller_packets(bench, best.scene.sent_at[index][1], 0)
        ):
            pass


def _with_sent(scene: Scene, index: int, packet: Any) -> Scene:
    return replace(scene, sent_at=_but(scene.sent_at, index, (scene.sent_at[index][0], packet)))


def smaller_packets(bench: Bench, traffic: bytes, start: int) -> Iterator[tuple[int, bytes]]:
    """Yield the size of each framing's whole packet at `start`, with packets that have less in them."""
    for (_, framing, messages), extras in zip(bench.framings, bench.extras, strict=True):
        judged = framing.judge(traffic, start, silent=True, extras=extras)
        if judged.verdict is Verdict.WHOLE:
            packet = traffic[start : start + judged.size]
            message = next((m for m in messages if bench.reads(m, packet)), messages[0])
            for smaller in lesser(framing, message, packet):
                yield judged.size, smaller


def lesser(framing: Framing, message: Message, packet: bytes) -> Iterator[bytes]:
    """Yield packets of a framing that have less in them than `packet`: fewer bytes, then smaller ones."""
    try:
        logical = framing.logical(packet)
    except ValueError:
        return
    end = len(logical) - framing.check_size - len(framing.end)
    head, body = logical[len(framing.sync) : framing.head_end], logical[framing.head_end : end]
    seen = {packet}

    def framed(head: bytes, body: bytes) -> Iterator[bytes]:
        try:
            made = message.struct.framed(framing, head, body)
        except (AcesError, c.ConstructError, LookupError, ValueError):
            return
        if made not in seen:
            seen.add(made)
            yield made

    size = len(body)
    while size:
        for start in range(0, len(body), size):
            yield from framed(head, body[:start] + body[start + size :])
        size //= 2
    for at in range(len(body)):
        for less in _lowered(body, at):
            yield from framed(head, less)
    for at in range(len(head)):
        for less in _lowered(head, at):
            yield from framed(less, body)


# ---------------------------------------------------------------------- frames


def _of_frames(bench: Bench, best: _Best) -> None:
    _delete(best)
    for index in range(len(best.scene)):
        for frame in simpler_frames(bench, best.scene.traffic[index]):
            _offer_frame(best, index, frame)
        for at in reversed(range(len(best.scene.traffic[index].data))):
            frame = best.scene.traffic[index]
            if at < len(frame.data):
                any(
                    _offer_frame(best, index, made)
                    for data in _lowered(frame.data, at)
                    for made in _with_data(bench, frame, data)
                )
    for index in range(len(best.scene.sent_at)):
        for frame in simpler_frames(bench, best.scene.sent_at[index][1]):
            best.offer(_with_sent(best.scene, index, frame))


def _offer_frame(best: _Best, index: int, frame: Frame) -> bool:
    return best.offer(replace(best.scene, traffic=_but(best.scene.traffic, index, frame)))


def _with_data(bench: Bench, frame: Frame, data: bytes) -> Iterator[Frame]:
    """Yield the frame with other data: with the check that goes with them, and as they are."""
    for message in bench.by_name.values():
        if message.check is not None and message.identifier.match(frame.arbitration_id) is not None:
            if message.lengths is not None and len(data) in message.lengths:
                yield structs.replace(frame, data=rechecked(message, frame.arbitration_id, data))
    yield structs.replace(frame, data=data)


def simpler_frames(bench: Bench, frame: Frame) -> Iterator[Frame]:
    """Yield the frame with less about it: no time, no channel, no data, a smaller identifier."""
    plain = {"timestamp": None, "channel": None, "is_rx": None}
    yield structs.replace(frame, **plain)
    for name in plain:
        yield structs.replace(frame, **{name: None})
    if frame.data:
        for size in (0, 1, len(frame.data) // 2, len(frame.data) - 1):
            if size < len(frame.data) and (size <= 8 or not frame.is_fd):
                yield structs.replace(frame, data=frame.data[:size])
        yield from _with_data(bench, frame, bytes(len(frame.data)))
    for message in bench.by_name.values():
        captures = message.identifier.match(frame.arbitration_id)
        if captures:
            least = {
                capture.name: capture.values[0] if isinstance(capture.values, range) else min(capture.values)
                for capture in message.identifier.captures
            }
            yield structs.replace(frame, arbitration_id=message.identifier.number(least))


# ---------------------------------------------------------------------- values of packets


def _packets(best: _Best) -> None:
    """Yield, for laws about packets as they were drawn, one packet, alone, with the simplest values."""
    for packet in best.scene.packets:
        if best.offer(Scene(_traffic_of(best.scene, packet), packets=(packet,)), ()):
            break
    if len(best.scene.packets) != 1:
        return
    while best.calls.are_left and any(map(best.offer, _simpler_packets(best.scene))):
        pass


def _simpler_packets(scene: Scene) -> Iterator[Scene]:
    """Yield the scene's only packet, with simpler values."""
    (packet,) = scene.packets
    for values in simpler_values(packet.values):
        try:
            image = bytes(packet.message.struct.build(values, raw=True))
        except Exception:  # what cannot be built is not simpler
            continue
        made = replace(packet, values=values, image=image)
        yield Scene(_traffic_of(scene, made), packets=(made,))


def _traffic_of(scene: Scene, packet: DrawnPacket) -> Any:
    return packet.image if isinstance(scene.traffic, bytes) else tuple(packet.as_sent)


def simpler_values(values: Any) -> Iterator[Any]:
    """Yield values with one of them made simpler."""
    if isinstance(values, Mapping):
        for name, value in values.items():
            for simpler in simpler_values(value):
                made = c.Container(values)
                made[name] = simpler
                yield made
    elif isinstance(values, (list, tuple)):
        for index in range(len(values)):
            yield c.ListContainer([*values[:index], *values[index + 1 :]])
        for index, value in enumerate(values):
            for simpler in simpler_values(value):
                yield c.ListContainer([*values[:index], simpler, *values[index + 1 :]])
    elif isinstance(values, bool) or values is None:
        return
    elif isinstance(values, int):
        for simpler in (0, 1, values // 2):
            if abs(simpler) < abs(values):
                yield type(values)(simpler)
    elif isinstance(values, float):
        if values != 0.0:
            yield 0.0
    elif isinstance(values, (bytes, str)) and values:
        yield values[:0]
        yield values[: len(values) // 2]


__all__ = ["Calls", "lesser", "packet_bytes", "shrunk", "simpler_frames", "smaller_packets", "without"]
