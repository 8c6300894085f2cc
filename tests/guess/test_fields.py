"""Fields found in payloads of which nothing is known but the bytes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from aces_bus.protocol import Crc
from aces_lab.guess import FieldGuess, fields_of
from aces_lab.guess.boundaries import merged_pieces
from aces_lab.guess.fields import SAMPLE, ByteOrder, Rows, positions_of

STEPS = 1500


def wave(span: float, period: float, seed: int = 0) -> Any:
    """A quantity that swings around 0, with a little noise."""
    noise = np.random.default_rng(seed).normal(0, max(0.6, span / 200), STEPS)
    return np.round(span * np.sin(np.arange(STEPS) / period + seed) + noise).astype(np.int64)


def payloads(size: int, *fields: tuple[int, int, ByteOrder, Any]) -> Any:
    """Rows of bytes with numbers at (lowest bit, length, byte order)."""
    bits = np.zeros((STEPS, 8 * size), np.uint8)
    for start, length, order, values in fields:
        for number, at in enumerate(positions_of(start, length, order)):
            bits[:, at] = np.asarray(values, np.int64) >> number & 1
    return np.packbits(bits, axis=1, bitorder="little")


def found(rows: Any) -> dict[int, FieldGuess]:
    """What is not a constant, by its lowest bit; every bit is in one guess."""
    guesses = fields_of(rows)
    assert sorted(bit for one in guesses for bit in one.positions) == list(range(8 * rows.shape[1]))
    assert all(0 <= one.confidence <= 1 and one.evidence for one in guesses)
    return {one.start: one for one in guesses if one.kind != "constant"}


@pytest.mark.parametrize("order", ["little", "big"])
@pytest.mark.parametrize("is_signed", [True, False])
def test_a_number_of_two_bytes_has_its_order_and_sign(order: ByteOrder, is_signed: bool) -> None:
    """Its neighbours, which move too, stay by themselves."""
    start = 16 if order == "little" else 24
    values = wave(9000, 40) + (0 if is_signed else 20000)
    rows = payloads(
        8,
        (start, 16, order, values),
        (0, 8, order, wave(60, 90, 1) + 128),
        (40, 8, order, wave(50, 25, 2) + 120),
    )
    number = found(rows)[start]
    assert (number.length, number.order, number.kind, number.signed) == (16, order, "number", is_signed)
    assert len(found(rows)) == 3


def test_a_number_of_twelve_bits_beside_one_of_four() -> None:
    """A border inside a byte is found where nothing carries over it."""
    rows = payloads(4, (0, 12, "little", wave(1500, 30) + 2000), (12, 4, "little", wave(6, 50, 3) + 8))
    assert {(one.start, one.length) for one in found(rows).values()} == {(0, 12), (12, 4)}


@pytest.mark.parametrize(("width", "modulus"), [(4, 16), (8, 256), (4, 15)])
def test_a_counter_says_where_it_begins_anew(width: int, modulus: int) -> None:
    """And is one although some messages were lost."""
    kept = np.random.default_rng(1).random(2 * STEPS) < 0.97
    values = (np.arange(2 * STEPS) % modulus)[kept][:STEPS]
    guess = found(payloads(8, (8, width, "little", values), (32, 16, "little", wave(3000, 40))))[8]
    assert (guess.kind, guess.length, guess.value, guess.modulus) == ("counter", width, 1, modulus)


def test_a_check_is_of_the_bytes_beside_it() -> None:
    """The counter that moves it stays a counter."""
    rows = payloads(8, (0, 8, "little", np.arange(STEPS) % 256), (16, 16, "little", wave(9000, 40)))
    check = Crc("CRC8-SAE-J1850")
    rows[:, 7] = [check.compute(row[:7].tobytes()) for row in rows]
    guesses = found(rows)
    assert {one.start: one.kind for one in guesses.values()} == {0: "counter", 16: "number", 56: "check"}
    assert guesses[56].check is not None
    assert "CRC8-SAE-J1850" in guesses[56].check.declared


@pytest.mark.parametrize("order", ["<", ">"])
def test_floats_are_floats(order: str) -> None:
    """In both byte orders, beside a number that is none."""
    rows = payloads(8, (32, 16, "little", wave(9000, 40)))
    rows[:, :4] = (np.sin(np.arange(STEPS) / 40) * 3.3).astype(f"{order}f4").view(np.uint8).reshape(-1, 4)
    (guess,) = [one for one in found(rows).values() if one.kind == "float"]
    assert (guess.first_byte, guess.length, guess.order) == (0, 32, "little" if order == "<" else "big")


def test_text_flags_and_enumerations() -> None:
    """Each by what its values do."""
    moved = np.random.default_rng(5).random(STEPS) < 0.02
    state = np.array([0, 5, 3, 6])[np.cumsum(moved) % 4]
    rows = payloads(8, (0, 3, "little", state), (7, 1, "little", np.arange(STEPS) // 300 % 2))
    for row in range(STEPS):
        rows[row, 3:8] = np.frombuffer(b"STOP " if row % 700 < 300 else b"DRIVE", np.uint8)
    kinds = {one.start: one.kind for one in found(rows).values()}
    assert kinds == {0: "enumeration", 7: "flag", 24: "text"}


def test_an_enumeration_has_the_values_of_all_rows() -> None:
    """Also one that no sample has; with many of them it is none."""
    count = 5 * SAMPLE
    rows = np.zeros((count, 2), np.uint8)
    rows[:, 0] = np.arange(count) // 200 % 2
    between = SAMPLE  # between two runs of the sample
    rows[between, 0] = 3
    (one,) = [one for one in fields_of(rows) if one.kind == "enumeration"]
    assert (one.start, one.length, one.values) == (0, 2, (0, 1, 3))
    rows[:, 0] = rows[:, 0] * 0x11
    rows[between : between + 12, 0] = np.arange(2, 14) * 0x11
    assert "enumeration" not in {one.kind for one in fields_of(rows)}


def test_what_never_changes_is_a_constant_of_this_recording() -> None:
    """With as much confidence as there are messages."""
    few, many = (fields_of(np.full((count, 3), 0x5A, np.uint8)) for count in (2, 200))
    assert [one.kind for one in few + many] == ["constant"] * 2
    assert few[0].confidence < 0.5 < many[0].confidence
    assert many[0].evidence == "always 5A 5A 5A in 200 messages"


def test_few_messages_say_which_bytes_change_and_no_more() -> None:
    """Below eight steps no bit is judged."""
    rows = np.zeros((5, 4), np.uint8)
    rows[:, 2] = [0, 1, 3, 9, 8]
    (guess,) = [one for one in fields_of(rows) if one.kind != "constant"]
    assert (guess.start, guess.length, guess.kind, guess.confidence) == (16, 8, "number", 0.2)


@pytest.mark.parametrize(
    "rows", [np.zeros((0, 8), np.uint8), np.zeros((3, 0), np.uint8), np.zeros((1, 1), np.uint8)]
)
def test_nothing_is_no_reason_to_fail(rows: Any) -> None:
    """No rows, no bytes, one row."""
    assert all(one.kind == "constant" for one in fields_of(rows))


@pytest.mark.parametrize("size", [1, 8, 64])
def test_noise_is_not_made_into_anything_sure(size: int) -> None:
    """No counter, check, float or text is seen in random bytes."""
    rows = np.random.default_rng(size).integers(0, 256, (STEPS, size), np.uint8)
    assert {one.kind for one in fields_of(rows)} <= {"number", "enumeration", "flag"}


@pytest.mark.parametrize("is_cyclic", [True, False])
def test_a_multiplexer_is_what_makes_the_rest_smooth(is_cyclic: bool) -> None:
    """Its pages have fields of their own, and one that is always there is there always."""
    page = np.arange(STEPS) % 3 if is_cyclic else np.random.default_rng(2).integers(0, 3, STEPS)
    rows = payloads(8, (0, 8, "little", page), (48, 16, "big", wave(9000, 700)))
    long, short = wave(9000, 90, 1) + 20000, wave(40, 90, 2) + 100
    pages = [
        payloads(8, (16, 16, "little", long)),
        payloads(8, (16, 8, "little", short), (24, 8, "little", short[::-1])),
        payloads(8, (24, 16, "big", long[::-1])),
    ]
    for number, content in enumerate(pages):
        rows[page == number, 2:4] = content[page == number, 2:4]
    guesses = [one for one in fields_of(rows) if one.kind != "constant"]
    (selector,) = [one for one in guesses if one.kind == "multiplexer"]
    assert (selector.start, selector.length, selector.values) == (0, 8, (0, 1, 2))
    selected = {(one.when, one.start, one.length, one.order) for one in guesses if one.start in (16, 24)}
    assert selected == {
        ((0,), 16, 16, "little"),
        ((1,), 16, 8, "little"),
        ((1,), 24, 8, "little"),
        ((2,), 24, 16, "big"),
    }


def test_a_bit_that_changes_in_every_second_message_is_hardly_sure_to_be_a_flag() -> None:
    """It may be the lowest bit of a number; one that changes seldom, or each time, is a flag."""
    drawn = np.random.default_rng(2)
    bits = [drawn.integers(0, 2, 400), np.arange(400) // 60 & 1, np.arange(400) & 1]
    sure = []
    for bit in bits:
        (flag,) = [one for one in fields_of((bit[:, None] * 0x10).astype(np.uint8)) if one.kind == "flag"]
        sure.append(flag.confidence)
    assert sure == [0.5, 0.9, 0.9]


@pytest.mark.parametrize("low", [1, 4, 7])
def test_pieces_of_a_byte_that_change_together_are_one(low: int) -> None:
    """However short they are: of seven bits and one, too."""
    rows = np.array([[0x00], [0xFF]] * 20, np.uint8)
    pieces: list[tuple[list[int], Any]] = [(list(range(low)), "little"), (list(range(low, 8)), "little")]
    merged = merged_pieces(Rows(rows), pieces, np.ones(8, bool))
    assert merged == [(list(range(8)), "little")]


def test_the_first_byte_is_an_opcode_where_others_hang_on_it() -> None:
    """As RMD-X has it: in some messages bytes stay 0 that are numbers in others; a rare opcode does no harm."""
    rows = np.zeros((400, 8), np.uint8)
    speed, angle = wave(300, 40)[:400], wave(30000, 40)[:400]
    for number, row in enumerate(rows):
        code = 0x9A if number % 97 == 5 else (0xA1, 0x9C, 0x92)[number % 3]
        row[0] = code
        if code == 0x92:
            row[4:] = list(int(angle[number]).to_bytes(4, "little", signed=True))
        elif code != 0x9A:
            row[2:4] = list(int(speed[number]).to_bytes(2, "little", signed=True))
            row[4:6] = list(int(-speed[number]).to_bytes(2, "little", signed=True))
    guesses = fields_of(rows)
    assert [one.values for one in guesses if one.kind == "multiplexer"] == [(0x92, 0x9C, 0xA1)]
    assert guesses[0].kind == "multiplexer"
    at = {one.when for one in guesses if one.start == 32 and one.kind == "number"}
    assert at == {(0x92,), (0x9C,), (0xA1,)}
