"""Faults planted in scanners: the fuzzer finds each, and shows it in a handful of bytes.

A fault is planted with `monkeypatch` before its protocol is declared anew, so that nothing generated earlier is used. To add
one: write a function that plants it, and its line in `FAULTS`.
"""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import pytest
from construct import Byte, Int16ul, Struct

from aces_bus.protocol import BitLayout, Capture, Crc, Protocol, Split, StreamScanner, bits
from aces_bus.protocol.codegen import load
from aces_bus.protocol.scan import can, find, rows, stream
from aces_bus.protocol.scan.counts import Counts
from aces_bus.testing._bench import Bench
from aces_bus.testing.fuzz import Failure, Fuzzer, judged
from aces_bus.testing.laws import LAWS, Trial

Patch = pytest.MonkeyPatch


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


def a_bus() -> Protocol:
    """A split signed field, a check over the identifier too."""
    made = Protocol("victim", link="can")
    node = Capture("node", range(8))
    made.message(
        "Halves",
        id=0x10 + node,
        payload=BitLayout(3, "angle" / Split((16, 4), (0, 8), signed=True), "mode" / bits(4, at=8)),
    )
    made.message(
        "Checked",
        id=0x30 + node,
        check=Crc("CRC8-AUTOSAR", over=slice(1, None), field="crc"),
        payload=BitLayout(3, "crc" / bits(8), "value" / bits(16)),
    )
    made.message("Plain", id=0x40 + node, payload=Struct("value" / Int16ul, "more" / Byte))
    return made


# ---------------------------------------------------------------------- the faults


def printed(patch: Patch, module: Any, name: str, old: str, new: str) -> None:
    """Change the text of what is generated; the text must be there."""
    good = getattr(module, name)

    def bad(*args: Any, **more: Any) -> str:
        text: str = good(*args, **more)
        assert old in text or module is not stream, f"the printed text has changed: no {old!r} in\n{text}"
        return text.replace(old, new)

    patch.setattr(module, name, bad)


@pytest.fixture(autouse=True)
def nothing_is_remembered() -> Iterator[None]:
    """What was generated before a fault was planted, or under one, is not used again."""
    forget()
    yield
    forget()


def forget() -> None:
    for name, module in list(sys.modules.items()):
        if name.startswith("aces_bus"):
            for value in list(vars(module).values()):
                if hasattr(value, "cache_clear"):
                    value.cache_clear()


def a_length_is_one_too_long(patch: Patch) -> None:
    printed(patch, stream, "print_stream", "j = i + ", "j = 1 + i + ")


def a_sum_begins_one_byte_late(patch: Patch) -> None:
    printed(patch, stream, "print_stream", "~sum(buffer[i + 2:j - 1])", "~sum(buffer[i + 3:j - 1])")


def a_byte_is_lost_between_chunks(patch: Patch) -> None:
    good = StreamScanner._advance

    def advance(self: StreamScanner, data: bytes, *args: Any, **more: Any) -> Any:
        if data and len(self._buffer) == 3:
            self._buffer = self._buffer[:-1]
        return good(self, data, *args, **more)

    patch.setattr(StreamScanner, "_advance", advance)


def a_false_header_costs_two_bytes(patch: Patch) -> None:
    printed(
        patch,
        stream,
        "print_stream",
        "lose(base + i, 1, bad)\n            i += 1\n",
        "k = min(2, end - i)\n            lose(base + i, k, bad)\n            i += k\n",
    )


def a_stride_takes_bad_checks(patch: Patch) -> None:
    patch.setattr(find.Finder, "_checked", lambda self, data, check, starts, ends: starts >= 0)


def a_split_field_loses_its_sign(patch: Patch) -> None:
    printed(patch, load, "print_decoder", "^ 2048) - 2048", "^ 2048) ^ 2048")
    printed(patch, load, "print_decoder", "^ 0x800) - 0x800", "^ 0x800) ^ 0x800")


def columns_read_the_other_byte_order(patch: Patch) -> None:
    good = rows._is_little
    patch.setattr(rows, "_is_little", lambda scalar: not good(scalar))


def checks_of_frames_are_not_looked_at(patch: Patch) -> None:
    patch.setattr(load, "_holds", lambda message: lambda data, key: True)


def the_last_frame_of_a_batch_is_lost(patch: Patch) -> None:
    good = can.CanScanner._make_feed

    def make(self: can.CanScanner) -> Any:
        feed = good(self)
        return lambda frames: feed(frames) if len(frames) < 3 else feed(frames[:-1])

    patch.setattr(can.CanScanner, "_make_feed", make)


def long_losses_are_counted_short(patch: Patch) -> None:
    good = Counts.lose
    patch.setattr(Counts, "lose", lambda self, size, reason: good(self, size - (size > 3), reason))


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


robotis, minihubo_adc, hubo = map(shipped, ("robotis", "minihubo_adc", "hubo"))

#: The table: a line a fault.
FAULTS = (
    Fault(a_length_is_one_too_long, robotis, (2,), 8),
    Fault(a_length_is_one_too_long, minihubo_adc, (2,), 8),
    Fault(a_sum_begins_one_byte_late, robotis, (2, 4), 6),
    Fault(a_byte_is_lost_between_chunks, robotis, (3,), 6),
    Fault(a_byte_is_lost_between_chunks, minihubo_adc, (3,), 6),
    Fault(a_false_header_costs_two_bytes, robotis, (2, 4), 6),
    Fault(a_stride_takes_bad_checks, robotis, (5,), 12),
    Fault(a_split_field_loses_its_sign, a_bus, (2,), 1),
    Fault(columns_read_the_other_byte_order, minihubo_adc, (2,), 6),
    Fault(columns_read_the_other_byte_order, hubo, (2,), 1),
    Fault(checks_of_frames_are_not_looked_at, a_bus, (2, 5), 1),
    Fault(the_last_frame_of_a_batch_is_lost, hubo, (6,), 3),
    Fault(long_losses_are_counted_short, robotis, (6,), 6),
)

#: Examples until which a fault must be found: some seconds.
EXAMPLES = 2000


def hunted(fault: Fault) -> Failure:
    """The failure that a fuzzer finds."""
    chosen = [law for law in LAWS if law.number in fault.laws]
    fuzzer = Fuzzer([fault.protocol()], seed=1, laws=chosen)
    for first in range(0, EXAMPLES, 32):
        if found := fuzzer.run(32, first, most=1):
            return found[0]
    pytest.fail(f"no law of {fault.laws} failed in {EXAMPLES} examples")


@pytest.mark.parametrize("fault", FAULTS, ids=str)
def test_a_planted_fault_is_found_and_small(fault: Fault, monkeypatch: Patch) -> None:
    """A law that is meant fails, on a handful of words that still break it when they are played again."""
    fault.plant(monkeypatch)
    failure = hunted(fault)
    words = failure.scene.words
    assert (len(words) - words.count(0) if isinstance(words, bytes) else len(words)) <= fault.most
    again = Trial(Bench(failure.wire, failure.direction), failure.scene, failure.cuts)
    assert judged(failure.law, again) == failure.text
    # The numbers in the failure lead back to the example that it began with.
    assert failure.example is not None
    fuzzer = Fuzzer([fault.protocol()], seed=1, laws=[failure.law])
    assert fuzzer.example(failure.example)[1].words == (failure.first or failure.scene).words


def test_without_a_fault_nothing_is_found() -> None:
    """The victim of this file is healthy: what is found above is due to the faults."""
    assert Fuzzer([a_bus()], seed=1).run(64) == []
