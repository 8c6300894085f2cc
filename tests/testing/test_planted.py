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
from aces_bus.protocol.scan.context import Context
from aces_bus.protocol.scan.counts import Counts
from aces_bus.testing.fuzz import Fuzzer

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


def requests_are_never_used_up(patch: Patch) -> None:
    good = Context.of
    patch.setattr(Context, "of", lambda self, fitting, *more: good(self, fitting[:1], *more))


@dataclass(frozen=True)
class Fault:
    """What is planted, in which protocol, and how many bytes or frames the counter-example may have."""

    plant: Callable[[Patch], None]
    make: Callable[[], Protocol]
    most: int
    #: The laws of which one must find it; empty: any.
    laws: tuple[int, ...] = ()


robotis, minihubo_adc, hubo = map(shipped, ("robotis", "minihubo_adc", "hubo"))

FAULTS = (
    Fault(a_length_is_one_too_long, robotis, 12, (2,)),
    Fault(a_length_is_one_too_long, minihubo_adc, 12, (2,)),
    Fault(a_sum_begins_one_byte_late, robotis, 8, (2,)),
    Fault(a_byte_is_lost_between_chunks, robotis, 10, (3,)),
    Fault(a_byte_is_lost_between_chunks, minihubo_adc, 10, (3,)),
    Fault(a_false_header_costs_two_bytes, robotis, 10, (2, 4)),
    Fault(a_stride_takes_bad_checks, robotis, 800, (2, 5)),
    Fault(a_split_field_loses_its_sign, a_bus, 1, (2,)),
    Fault(columns_read_the_other_byte_order, minihubo_adc, 10, (2,)),
    Fault(columns_read_the_other_byte_order, hubo, 1, (2,)),
    Fault(checks_of_frames_are_not_looked_at, a_bus, 1, (2, 5)),
    Fault(the_last_frame_of_a_batch_is_lost, hubo, 3, (2, 6)),
    Fault(long_losses_are_counted_short, robotis, 5, (6,)),
)

#: Examples until which a fault must be found: some seconds.
EXAMPLES = 2000


@pytest.mark.parametrize(
    "fault", FAULTS, ids=lambda f: f"{f.plant.__name__}-{getattr(f.make, '__qualname__', '')[:7]}"
)
def test_a_planted_fault_is_found_and_small(fault: Fault, monkeypatch: pytest.MonkeyPatch) -> None:
    """One of the laws meant fails, on a scene of a handful of words that still fails when it is played again."""
    fault.plant(monkeypatch)
    fuzzer = Fuzzer([fault.make()], seed=1)
    done = 0
    while done < EXAMPLES and not any(f.law.number in fault.laws for f in fuzzer.failures):
        fuzzer.run(32, done)
        done += 32
    found = [f for f in fuzzer.failures if f.law.number in fault.laws]
    assert found, "no law failed"
    smallest = min(found, key=lambda f: len(f.scene))
    print(
        done,
        [
            (
                f.law.number,
                len(f.scene),
                f.tried,
                f.scene.words if isinstance(f.scene.words, bytes) else f.scene.words,
                f.cuts,
                f.text[:150],
            )
            for f in fuzzer.failures
        ],
    )
    assert len(smallest.scene) <= fault.most
