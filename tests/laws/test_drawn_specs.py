# A fault is planted in a private part.
# pyright: reportPrivateUsage=false
"""Drawn specs mean what plain bit arithmetic says: live, in columns, in the reference, and built again."""

from __future__ import annotations

import pytest
from hypothesis import settings

from tests.laws import bit_arithmetic, drawn_specs, spec_drawing

#: Specs in the short profile.
SHORT = 60


def _holds(seeds: range) -> drawn_specs.Outcome:
    outcome = drawn_specs.run(seeds)
    shown = [f"seed {seed}\n{spec_drawing.draw(seed).source}\n{what}" for seed, what in outcome.failures[:3]]
    assert not shown, "\n\n".join(shown)
    return outcome


@pytest.mark.slow
def test_drawn_specs_mean_what_bit_arithmetic_says() -> None:
    """Whatever the spec: refused by the language, or the same everywhere."""
    outcome = _holds(range(1_000_000, 1_000_000 + SHORT))
    assert outcome.counts["accepted"] > SHORT // 3, outcome.counts


@pytest.mark.long
def test_many_drawn_specs_mean_what_bit_arithmetic_says() -> None:
    """The same over ten times as many specs as the profile has examples (`tests.laws.drawn_specs` takes any number)."""
    _holds(range(2_000_000, 2_000_000 + 10 * settings().max_examples))


def test_drawn_specs_are_of_many_kinds() -> None:
    """Among some hundreds there is every word, and the shapes that generated code got wrong once."""
    texts = "\n".join(spec_drawing.draw(seed).source for seed in range(1, 600))
    words = (
        *("BitLayout(", "Multiplexed(", "Split(", "Tuple(", "SignMagnitude(", "Enumeration(", "Flags("),
        *(
            "Quantity(",
            "Switch(",
            "Array(0",
            "Array(2, BitLayout",
            "Struct()",
            "Const(",
            "GreedyBytes",
            "Float16",
            "unknown=top(",
            "Sum(4, negated",
        ),
        *("math.inf", "math.nan", 'order="msb"', "fd=True", "dialect=", "when=", "Enumeration(Quantity"),
        *("this.length * 2", "Crc(", "Xor(", "Slip()", "end=b", "match="),
        *("Items(tag=", "counts='item'", "size_first=True", "PrefixedArray(", "GreedyRange(", "Rebuild("),
    )
    assert [word for word in words if word not in texts] == []


def test_bit_arithmetic_shares_nothing_with_what_it_judges() -> None:
    """It imports neither aces_bus nor construct nor NumPy."""
    text = bit_arithmetic.__file__
    with open(text, encoding="utf-8") as file:
        imports = [line for line in file if line.startswith(("import", "from"))]
    assert imports == ["from __future__ import annotations\n", "import struct\n", "from typing import Any\n"]


def test_a_wrong_bit_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    """With one weight of the arithmetic wrong, some of the specs differ."""
    good = bit_arithmetic._meant
    monkeypatch.setattr(
        bit_arithmetic, "_meant", lambda pattern, *rest: good(pattern ^ 1 if pattern > 8 else pattern, *rest)
    )
    assert drawn_specs.run(range(1_000_000, 1_000_020)).failures
