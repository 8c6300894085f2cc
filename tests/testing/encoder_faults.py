# Faults are planted in private parts.
# pyright: reportPrivateUsage=false
"""Faults of encoders: what goes out is not what construct would build.

1. They are planted in encoders alone; construct, which judges them, stays whole.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from aces_bus.protocol import encoder
from aces_bus.protocol.generate import encode as print_encode
from tests.testing.faults import Fault, Patch
from tests.testing.victims import a_bus, a_line


def printed(patch: Patch, *changes: tuple[str, str]) -> None:
    """Change the text of printed encoders."""
    good = print_encode.print_encoder

    def bad(*args: Any) -> tuple[str, list[str]]:
        function, lines = good(*args)
        text = "\n".join(lines)
        for old, new in changes:
            text = text.replace(old, new)
        return function, text.split("\n")

    patch.setattr(encoder, "print_encoder", bad)


def bound(patch: Patch, change: Callable[[Any], Any]) -> None:
    """Change the values that printed encoders call by name."""
    good = print_encode._Encoder._bound
    patch.setattr(print_encode._Encoder, "_bound", lambda self, name, value: good(self, name, change(value)))


def a_scale_is_ten_times_too_large(patch: Patch) -> None:
    printed(patch, (" / 0.1", " / 1.0"), (" / 0.5", " / 5.0"))


def what_is_scaled_is_cut_off(patch: Patch) -> None:
    printed(patch, ("round(", "int("))


def a_sign_is_lost(patch: Patch) -> None:
    printed(patch, ('"<Bhb', '"<BHb'), ('"<h', '"<H'), ("round(", "abs(round("), (" / 0.1)", " / 0.1))"))


def numbers_go_out_big_endian(patch: Patch) -> None:
    printed(patch, ('Struct("<', 'Struct(">'))


def a_constant_is_another(patch: Patch) -> None:
    printed(patch, ("b'\\x07'", "b'\\x06'"), ("b'\\x01'", "b'\\x02'"))


def a_name_is_another_number(patch: Patch) -> None:
    bound(patch, lambda value: {**value, "on": 0} if isinstance(value, dict) and "on" in value else value)


def a_part_of_a_split_field_is_dropped(patch: Patch) -> None:
    printed(patch, (" >> 4 & 0xff", " >> 4 & 0x7f"))


def a_multiplexed_field_is_dropped(patch: Patch) -> None:
    good = encoder.Encoder.image

    def image(self: encoder.Encoder, message: Any, fields: dict[str, Any], **more: Any) -> bytes:
        return good(self, message, {**fields, "two": 0} if fields.get("two") else fields, **more)

    patch.setattr(encoder.Encoder, "image", image)


def a_range_is_not_looked_at(patch: Patch) -> None:
    printed(patch, ("if not -300 <= ", "if not -3000 <= "), (" <= 300:", " <= 3000:"))


def a_field_that_is_none_is_ignored(patch: Patch) -> None:
    printed(patch, ("if len(fields) != ", "if len(fields) < "))


def a_captured_number_goes_elsewhere(patch: Patch) -> None:
    printed(patch, ("0x40 + ", "0x41 + "))


ENCODER_FAULTS = (
    Fault(a_scale_is_ten_times_too_large, a_bus, (2,), 1),
    Fault(a_scale_is_ten_times_too_large, a_line, (2,), 8),
    Fault(what_is_scaled_is_cut_off, a_bus, (2,), 1),
    Fault(a_sign_is_lost, a_bus, (2,), 1),
    Fault(numbers_go_out_big_endian, a_bus, (2,), 1),
    Fault(a_constant_is_another, a_bus, (2,), 1),
    Fault(a_name_is_another_number, a_bus, (2,), 1),
    Fault(a_part_of_a_split_field_is_dropped, a_bus, (2,), 1),
    Fault(a_multiplexed_field_is_dropped, a_bus, (2,), 1),
    Fault(a_range_is_not_looked_at, a_bus, (2,), 1),
    Fault(a_field_that_is_none_is_ignored, a_bus, (2,), 1),
    Fault(a_captured_number_goes_elsewhere, a_bus, (2,), 1),
)
