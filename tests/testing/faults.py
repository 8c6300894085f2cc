# Faults are planted in private parts.
# pyright: reportPrivateUsage=false
"""Faults of scanners, each one line of somebody's bad day. To add one: a function that plants it, and its line in `FAULTS`.

1. A fault is planted before its protocol is declared, in what is generated or in what runs; never in construct, in the
   reference or in a spec, which the laws take for the truth.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import msgspec
import numpy as np
import pytest

from aces_bus.protocol import Protocol
from aces_bus.protocol.columns import rows
from aces_bus.protocol.counts import ScanCounts
from aces_bus.protocol.generate import load
from aces_bus.protocol.live import can, find, stream
from aces_bus.protocol.live import decide as decider
from aces_bus.protocol.live.candidates import Segments
from aces_bus.protocol.live.context import Context
from aces_bus.protocol.live.stream import StreamScanner
from tests.testing.victims import (
    a_bus,
    a_line,
    a_slip,
    hubo,
    lines_of_text,
    minihubo_adc,
    robotis,
    two_dialects,
)

Patch = pytest.MonkeyPatch


@dataclass(frozen=True)
class Fault:
    """What is planted, in which protocol, the laws of which one must find it, and how small it must become.

    `most` is how many frames, or bytes that are not zero, the counter-example may have.
    """

    plant: Callable[[Patch], None]
    protocol: Callable[[], Protocol]
    laws: tuple[int, ...]
    most: int

    def __str__(self) -> str:
        return f"{self.plant.__name__}-{self.protocol.__name__}"


def printed(patch: Patch, module: Any, name: str, old: str, new: str) -> None:
    """Change the text of what is generated; the text must be there."""
    good = getattr(module, name)

    def bad(*args: Any, **more: Any) -> str:
        text: str = good(*args, **more)
        assert old in text or module is not stream, f"the printed text has changed: no {old!r} in\n{text}"
        return text.replace(old, new)

    patch.setattr(module, name, bad)


# ---------------------------------------------------------------------- lengths, checks, stuffing


def a_length_is_one_too_long(patch: Patch) -> None:
    printed(patch, stream, "print_stream", "j = i + ", "j = 1 + i + ")


def a_length_is_read_big_endian(patch: Patch) -> None:
    printed(patch, stream, "print_stream", '4], "little")', '4], "big")')


def the_longest_packet_is_refused(patch: Patch) -> None:
    printed(patch, stream, "print_stream", "<= size <= 1000", "<= size <= 16")


def a_sum_begins_one_byte_late(patch: Patch) -> None:
    printed(patch, stream, "print_stream", "~sum(buffer[i + 2:j - 1])", "~sum(buffer[i + 3:j - 1])")


def half_a_check_is_compared(patch: Patch) -> None:
    printed(
        patch, stream, "print_stream", "== (buffer[j - 2] | buffer[j - 1] << 8)", "% 256 == buffer[j - 2]"
    )


def a_stride_takes_bad_checks(patch: Patch) -> None:
    patch.setattr(find.PacketFinder, "_checked", lambda self, data, check, starts, ends: starts >= 0)


def checks_of_frames_are_not_looked_at(patch: Patch) -> None:
    patch.setattr(load, "_holds", lambda message: lambda data, key: True)


def an_escape_is_left_in(patch: Patch) -> None:
    good = Segments.unstuff

    patch.setattr(Segments, "unstuff", lambda self, packet: good(self, packet).replace(b"\xdb", b"\xc0"))


def an_end_mark_is_looked_for_too_late(patch: Patch) -> None:
    printed(patch, stream, "print_stream", "i + 1, i + 40", "i + 3, i + 40")


# ---------------------------------------------------------------------- chunks, resynchronisation, silence, the end


def a_byte_is_lost_between_chunks(patch: Patch) -> None:
    good = StreamScanner.advance

    def advance(self: StreamScanner, data: bytes, *args: Any, **more: Any) -> Any:
        if data and len(self.buffer) == 3:
            self.buffer = self.buffer[:-1]
        return good(self, data, *args, **more)

    patch.setattr(StreamScanner, "advance", advance)


def a_false_header_costs_two_bytes(patch: Patch) -> None:
    printed(
        patch,
        stream,
        "print_stream",
        "lose(base + i, 1, bad)\n            i += 1\n",
        "k = min(2, end - i)\n            lose(base + i, k, bad)\n            i += k\n",
    )


def nothing_is_found_after_a_false_header(patch: Patch) -> None:
    printed(
        patch,
        stream,
        "print_stream",
        "lose(base + i, 1, bad)\n            i += 1\n",
        "lose(base + i, end - i, bad)\n            i = end\n",
    )


def silence_does_not_end_a_packet(patch: Patch) -> None:
    patch.setattr(StreamScanner, "idle", lambda self, time=None: [])


def what_is_held_is_lost_at_the_end(patch: Patch) -> None:
    good = StreamScanner.close

    def close(self: StreamScanner) -> Any:
        self.buffer = b""
        return good(self)

    patch.setattr(StreamScanner, "close", close)


# ---------------------------------------------------------------------- values


def a_split_field_loses_its_sign(patch: Patch) -> None:
    printed(patch, load, "print_decoder", "^ 2048) - 2048", "^ 2048) ^ 2048")
    printed(patch, load, "print_decoder", "^ 0x800) - 0x800", "^ 0x800) ^ 0x800")


def a_captured_number_is_shifted(patch: Patch) -> None:
    good = load.print_decoder
    patch.setattr(load, "print_decoder", lambda *args, **more: good(*args, **more).replace("0x40", "0x3f"))


def columns_read_the_other_byte_order(patch: Patch) -> None:
    good = rows._is_little
    patch.setattr(rows, "_is_little", lambda scalar: not good(scalar))


def columns_scale_in_single_precision(patch: Patch) -> None:
    good = rows._scaled

    def scaled(value: Any, step: Any, dtype: Any) -> Any:
        out = good(value, step, dtype)
        return out.astype(np.float32).astype(out.dtype) if out.dtype == np.float64 else out

    patch.setattr(rows, "_scaled", scaled)


# ---------------------------------------------------------------------- context, dialects, flags, counts


class Answered(Context):
    """Requests are never used up."""

    def of(self, candidates: Any, channel: Any, time: float | None) -> Any:
        found = super().of(candidates, channel, time)
        for entries in self._seen.values():
            for entry in entries:
                entry.consumed = False
        return found


class Forgetful(Context):
    """Only the last request is remembered, whoever it was to."""

    def note(self, name: str, channel: Any, time: float | None, values: Any) -> None:
        self._seen.clear()
        super().note(name, channel, time, values)


def a_request_is_answered_twice(patch: Patch) -> None:
    patch.setattr(decider, "Context", Answered)


def only_the_last_request_is_remembered(patch: Patch) -> None:
    patch.setattr(decider, "Context", Forgetful)


def dialects_are_mixed(patch: Patch) -> None:
    good = decider.Decider.__init__

    def init(self: Any, variant: Any, direction: Any, *, raw: bool) -> None:
        good(self, variant.protocol.variant(), direction, raw=raw)

    patch.setattr(decider.Decider, "__init__", init)


def _frames_are(patch: Patch, **changed: Any) -> None:
    good = can.CanScanner._make_feed

    def make(self: can.CanScanner) -> Any:
        feed = good(self)

        def spoilt(frame: Any) -> Any:
            if not all(getattr(frame, name) for name in changed) or frame.is_error_frame:
                return frame
            return msgspec.structs.replace(frame, arbitration_id=frame.arbitration_id & 0x7FF, **changed)

        return lambda frames: feed([spoilt(frame) for frame in frames])

    patch.setattr(can.CanScanner, "_make_feed", make)


def remote_frames_are_taken_for_data(patch: Patch) -> None:
    _frames_are(patch, is_remote_frame=False)


def extended_identifiers_are_cut_off(patch: Patch) -> None:
    _frames_are(patch, is_extended_id=False)


def the_last_frame_of_a_batch_is_lost(patch: Patch) -> None:
    good = can.CanScanner._make_feed

    def make(self: can.CanScanner) -> Any:
        feed = good(self)
        return lambda frames: feed(frames) if len(frames) < 3 else feed(frames[:-1])

    patch.setattr(can.CanScanner, "_make_feed", make)


def a_counter_wraps_one_late(patch: Patch) -> None:
    good = decider._counting

    def counting(decode: Any, message: Any, owner: Any) -> Any:
        late = {name: modulo + 1 for name, modulo in message.counters.items()}

        class Late:
            name, identifier, counters = message.name, message.identifier, late

        return good(decode, Late, owner)  # type: ignore[arg-type]

    patch.setattr(decider, "_counting", counting)


def a_filter_eats_a_record(patch: Patch) -> None:
    good = StreamScanner.advance

    def advance(self: StreamScanner, *args: Any, **more: Any) -> Any:
        found = good(self, *args, **more)
        return found if self.include_unknown or len(found) < 2 else found[:-1]

    patch.setattr(StreamScanner, "advance", advance)


def long_losses_are_counted_short(patch: Patch) -> None:
    good = ScanCounts.lose
    patch.setattr(ScanCounts, "lose", lambda self, size, reason: good(self, size - (size > 3), reason))


#: The table: a line a fault and a protocol.
FAULTS = (
    Fault(a_length_is_one_too_long, robotis, (2,), 8),
    Fault(a_length_is_one_too_long, minihubo_adc, (2,), 8),
    Fault(a_length_is_read_big_endian, a_line, (2,), 8),
    Fault(the_longest_packet_is_refused, a_line, (2, 4), 8),
    Fault(a_sum_begins_one_byte_late, robotis, (2, 4), 6),
    Fault(half_a_check_is_compared, a_line, (5,), 8),
    Fault(a_stride_takes_bad_checks, robotis, (5,), 12),
    Fault(checks_of_frames_are_not_looked_at, a_bus, (2, 5), 1),
    Fault(an_escape_is_left_in, a_slip, (2,), 8),
    Fault(an_end_mark_is_looked_for_too_late, lines_of_text, (2, 4), 6),
    Fault(a_byte_is_lost_between_chunks, robotis, (3,), 6),
    Fault(a_byte_is_lost_between_chunks, minihubo_adc, (3,), 6),
    Fault(a_false_header_costs_two_bytes, robotis, (2, 4), 6),
    Fault(nothing_is_found_after_a_false_header, robotis, (2, 4), 8),
    Fault(silence_does_not_end_a_packet, robotis, (2, 4), 8),
    Fault(what_is_held_is_lost_at_the_end, robotis, (6,), 2),
    Fault(a_split_field_loses_its_sign, a_bus, (2,), 1),
    Fault(a_captured_number_is_shifted, a_bus, (2,), 1),
    Fault(columns_read_the_other_byte_order, minihubo_adc, (2,), 6),
    Fault(columns_read_the_other_byte_order, hubo, (2,), 1),
    Fault(columns_scale_in_single_precision, a_bus, (2,), 3),
    Fault(a_request_is_answered_twice, robotis, (2,), 18),
    Fault(only_the_last_request_is_remembered, robotis, (2,), 18),
    Fault(dialects_are_mixed, two_dialects, (2,), 1),
    Fault(remote_frames_are_taken_for_data, a_bus, (2, 5), 1),
    Fault(extended_identifiers_are_cut_off, a_bus, (2, 4), 1),
    Fault(the_last_frame_of_a_batch_is_lost, hubo, (6,), 3),
    Fault(a_counter_wraps_one_late, a_bus, (2,), 3),
    Fault(a_filter_eats_a_record, robotis, (6,), 12),
    Fault(long_losses_are_counted_short, robotis, (6,), 6),
)
