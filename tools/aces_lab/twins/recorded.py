"""A recording that answers: what was said to a real device, and what it said, as a device for tests.

1. A request is matched by the spec: the same message with the same fields has the answers that it had, the k-th time the
   k-th ones, and from the last on always the last. Measured numbers may differ (`Recorded.find`), which is reported.
2. What the recording cannot answer is not answered, and reported. Nothing is made up.
3. What the device sent of its own accord comes once, at the times of the recording.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import msgspec

from aces_bus import Frame, Unknown, as_dict, load_protocol, make_scanner, open_recording
from aces_bus.device import Device, Driver, Robot, Twin
from aces_bus.device.config import Bus, DeviceConfig
from aces_bus.errors import CallerError
from aces_bus.protocol import Protocol, Record, Variant
from aces_bus.recordings.base import CanRecording

#: What comes so long behind a request (s) is no answer to it.
ANSWERED_S = 0.05
#: The delay of an answer where the recording has no times (s).
DELAY_S = 0.0005


class Answer(NamedTuple):
    """An answer of a recording: how long after its request (s), and its frame or bytes."""

    delay_s: float
    packet: Frame | bytes


Key = tuple[Any, ...]


@dataclass
class Recorded:
    """A recorded conversation: the answers of each request, in the order in which it was asked."""

    answers: dict[Key, list[list[Answer]]] = field(default_factory=dict[Key, list[list[Answer]]])
    #: The same by requests without their measured numbers.
    alike: dict[Key, list[list[Answer]]] = field(default_factory=dict[Key, list[list[Answer]]])
    #: What came of its own accord: when (s from the first packet), and what.
    unasked: list[tuple[float, Any]] = field(default_factory=list[tuple[float, Any]])
    #: Packets that the spec does not know.
    unknown: int = 0

    def find(self, record: Record, times: Counter[Key]) -> tuple[list[Answer] | None, bool]:
        """Return the answers of a request, and whether they are those of one with other measured numbers; None: none."""
        for known, key, is_alike in (
            (self.answers, request_key(record), False),
            (self.alike, request_key_without_numbers(record), True),
        ):
            rounds = known.get(key)
            if rounds is not None:
                times[key] += 1
                return rounds[min(times[key], len(rounds)) - 1], is_alike
        return None, False


def request_key(record: Record) -> Key:
    """Return what a request is known by: its message and all its fields."""
    return (type(record).__name__, repr(as_dict(record)))


def request_key_without_numbers(record: Record) -> Key:
    """Return what a request is known by without its measured numbers."""
    fields = {name: value for name, value in as_dict(record).items() if not isinstance(value, float)}
    return (type(record).__name__, "alike", repr(fields))


def read_recorded(path: str | Path, variant: Variant) -> Recorded:
    """Read a conversation from a recording. Raises `CallerError` where nothing was asked in it."""
    found = Recorded()
    scanners = {
        is_answer: make_scanner(
            [variant], direction="from device" if is_answer else "to device", include_unknown=True
        )
        for is_answer in (False, True)
    }
    asked: list[Answer] | None = None
    asked_at = first = 0.0
    is_first = True
    spontaneous: set[str] = set()
    for when, is_answer, packet in _packets(path, scanners):
        first, is_first = (when if is_first else first), False
        for record in scanners[is_answer].feed([packet] if isinstance(packet, Frame) else packet):
            if isinstance(record, Unknown):
                found.unknown += 1
                continue
            whole = packet if isinstance(packet, Frame) else record.meta.raw
            name = type(record).__name__
            if not is_answer:
                asked, asked_at = [], when
                scanners[True].sent(whole)
                found.answers.setdefault(request_key(record), []).append(asked)
                found.alike.setdefault(request_key_without_numbers(record), []).append(asked)
                continue
            if asked is None or when - asked_at > ANSWERED_S:
                spontaneous.add(name)
            if asked is None or name in spontaneous:
                found.unasked.append((when - first, whole))
            else:
                asked.append(Answer((when - asked_at) or DELAY_S, whole))
    if not found.answers:
        raise CallerError(f"{path}: nothing in it was asked of a device that speaks {variant.name}")
    return found


def _packets(path: str | Path, scanners: dict[bool, Any]) -> Iterator[tuple[float, bool, Any]]:
    """Yield the packets of a recording: when (s), whether a device sent it, and what; CAN frames are told by the spec."""
    with open_recording(str(path)) as recording:
        if isinstance(recording, CanRecording):
            frames: Iterable[Frame] = recording
            for frame in frames:
                plain = msgspec.structs.replace(frame, channel=None)
                told = scanners[False].variants
                asks = make_scanner(list(told), direction="to device").feed([plain])
                yield frame.timestamp or 0.0, not asks, plain
        else:
            for chunk in recording:
                if chunk.direction is None:
                    raise CallerError(
                        f"{path}: says not which way bytes went; an .slog does (aces sniff --record)"
                    )
                yield chunk.time or 0.0, chunk.direction == "from device", chunk.data


class RecordedTwin(Twin):
    """Answers as a recording; `report()` says what it was asked that the recording does not have."""

    recorded: ClassVar[Recorded]

    def setup(self) -> None:
        """Begin the recording anew."""
        self._times: Counter[Key] = Counter()
        #: What was asked and is not in the recording, and what was answered as a request with other numbers.
        self.unanswered: Counter[str] = Counter()
        self.alike: Counter[str] = Counter()
        for seconds, packet in self.recorded.unasked:
            self.clock.call_in(round(seconds * 1e9), partial(self.send_raw, packet))

    def received(self, record: Record, instant: int) -> None:
        """Answer a request as it was answered."""
        found, is_alike = self.recorded.find(record, self._times)
        if found is None:
            self.unanswered[str(record)] += 1
            return
        if is_alike:
            self.alike[str(record)] += 1
        for answer in found:
            self.replies += 1
            self.clock.post(instant + round(answer.delay_s * 1e9), partial(self.twins.send, answer.packet))

    def report(self) -> str:
        """Return what the recording could not answer, and what it answered by a request with other numbers."""
        lines = [f"not in the recording, {count} times: {text}" for text, count in self.unanswered.items()]
        lines += [
            f"as recorded with other numbers, {count} times: {text}" for text, count in self.alike.items()
        ]
        return "\n".join(lines)


def recorded_robot(path: str | Path, protocol: str | Protocol, **bus: Any) -> tuple[Robot, Driver]:
    """Return a robot of one device that answers as a recording, and its driver. `bus` are keys of a bus in a robot's file.

    Raises `CallerError` as `read_recorded`, `UnknownNameError` for a protocol or dialect that there is not.
    """
    spoken = load_protocol(protocol) if isinstance(protocol, str) else protocol
    recorded = read_recorded(path, spoken.variant(bus.get("dialect")))
    device = type("RecordedDevice", (Device,), {"protocol": spoken})
    made = type("RecordedTwin", (RecordedTwin,), {"protocol": spoken, "recorded": recorded})
    robot = Robot(
        name="recorded",
        buses={"recorded": Bus(name="recorded", link=spoken.link, protocol=spoken.name, **bus)},
        devices={"RECORDED": DeviceConfig(name="RECORDED", driver="recorded", bus="recorded")},
        joints={},
        sensors={},
    )
    return robot, Driver("recorded", device, made, example="")


__all__ = ["Recorded", "RecordedTwin", "read_recorded", "recorded_robot"]
