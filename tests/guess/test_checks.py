"""Checks found in rows of bytes of which nothing is known."""

from __future__ import annotations

from typing import Any

import anycrc
import numpy as np
import pytest

from aces_bus.protocol import Check, Crc, Fletcher, Sum, Xor
from aces_lab.guess import fields_of
from aces_lab.guess.checks import checks_of, checks_of_packets

IDENTIFIER = b"\0\0\x02\x23"


def rows_of(size: int = 8, count: int = 200, seed: int = 1) -> Any:
    """A counter, a number that moves smoothly, a mode, and constants."""
    drawn = np.random.default_rng(seed)
    rows = np.zeros((count, size), np.uint8)
    rows[:, 1] = np.arange(count) & 15
    walk = 2000 + np.cumsum(drawn.integers(-3, 4, count))
    rows[:, 2], rows[:, 3] = walk >> 8, walk & 0xFF
    rows[:, 4] = drawn.integers(0, 3, count)
    return rows


def sealed(rows: Any, check: Check, at: int, lead: bytes = b"", trail: bytes = b"") -> Any:
    """The rows with a check at byte `at`, over `lead`, the other bytes and `trail`."""
    for row in rows:
        rest = np.delete(row, range(at, at + check.size)).tobytes()
        row[at : at + check.size] = np.frombuffer(check.encode(lead + rest + trail), np.uint8)
    return rows


@pytest.mark.slow
def test_every_crc_of_the_catalogue_is_found_by_its_name() -> None:
    """Of 8, 16, 24 and 32 bits, in whatever byte order."""
    names = [name for name, model in anycrc.models.items() if model.width in (8, 16, 24, 32)]
    wrong: list[str] = []
    for number, name in enumerate(names):
        check = Crc(name, order="big" if number % 2 else "little")
        found = checks_of(sealed(rows_of(10), check, 10 - check.size))
        if [(one.offset, one.check.describe) for one in found] != [(10 - check.size, name)]:
            wrong.append(name)
        elif check.size > 1 and found[0].check.order != check.order:
            wrong.append(f"{name} {check.order}")
    assert not wrong
    assert len(names) > 60


@pytest.mark.parametrize(
    ("check", "declared"),
    [
        (Sum(), "Sum()"),
        (Sum(inverted=True), "InvertedSum()"),
        (Sum(negated=True), "Sum(negated=True)"),
        (Xor(), "Xor()"),
        (Fletcher(), "Fletcher()"),
    ],
)
@pytest.mark.parametrize("lead", [b"", IDENTIFIER[-2:]])
def test_sums_are_told_apart_with_and_without_the_identifier(
    check: Check, declared: str, lead: bytes
) -> None:
    """A check that covers the identifier says so; one that does not is the shorter explanation."""
    rows = sealed(rows_of(), check, 8 - check.size, lead)
    (found,) = checks_of(rows, IDENTIFIER)
    assert found.offset == 8 - check.size
    over = f"over=[IdBytes(2), slice(0, {found.offset})]"
    if lead:
        declared = declared[:-1] + ("" if declared.endswith("()") else ", ") + over + ")"
    assert found.declared == declared
    assert found.confidence > 0.99
    assert found.agreeing == found.rows


def test_a_check_at_the_front_covers_what_is_behind_it() -> None:
    """As AUTOSAR's profiles 1 and 2 have it, the second with a data id that is not sent."""
    (found,) = checks_of(sealed(rows_of(), Crc("CRC8-SAE-J1850"), 0))
    assert (found.offset, found.declared) == (0, 'Crc("CRC8-SAE-J1850")')
    (found,) = checks_of(sealed(rows_of(), Crc("CRC8-SAE-J1850"), 0, trail=b"\x5a"))
    assert found.declared == """Crc("CRC8-SAE-J1850", over=[slice(1, 8), b'Z'])"""


def test_unknown_constants_of_a_crc_are_declared_as_what_they_come_to() -> None:
    """Bytes in front that are not sent cannot be known; the polynomial and what is left can."""
    rows = sealed(rows_of(), Crc("CRC8-AUTOSAR"), 7, lead=b"\x5a\x77\x01")
    (found,) = checks_of(rows, b"\0\0\0\1")
    assert "poly=0x2f" in found.declared
    for row in rows:
        assert found.check.compute(row[:7].tobytes()) == row[7]


def test_a_check_over_the_identifier_is_found_over_many_identifiers() -> None:
    """Rows of several identifiers leave one explanation."""
    rows, identifiers = rows_of(), np.arange(200) % 7 + 0x1F0
    for row, identifier in zip(rows, identifiers, strict=True):
        row[7] = Crc("CRC8-AUTOSAR").compute(int(identifier).to_bytes(2, "big") + row[:7].tobytes())
    prefix = np.stack([identifiers >> 8, identifiers & 0xFF], axis=1).astype(np.uint8)
    (found,) = checks_of(rows, prefix)
    assert found.declared == 'Crc("CRC8-AUTOSAR", over=[IdBytes(2), slice(0, 7)])'


def test_what_is_no_check_is_not_called_one() -> None:
    """Smooth numbers, counters, mirrored and constant bytes, noise."""
    assert checks_of(rows_of()) == []
    mirrored = rows_of()
    mirrored[:, 7] = ~mirrored[:, 3]
    assert checks_of(mirrored) == []
    counting = np.zeros((200, 8), np.uint8)
    counting[:, 6] = counting[:, 7] = np.arange(200) & 0xFF
    assert checks_of(counting) == []
    drawn = np.random.default_rng(3)
    assert checks_of(drawn.integers(0, 256, (300, 8)).astype(np.uint8), IDENTIFIER) == []
    assert checks_of(np.zeros((300, 8), np.uint8)) == []
    assert checks_of(np.zeros((300, 0), np.uint8)) == []


def test_too_few_rows_are_no_evidence() -> None:
    """Three rows fit some sum or other."""
    assert checks_of(sealed(rows_of(count=3), Xor(), 7)) == []


@pytest.mark.parametrize(
    ("check", "declared"),
    [
        (Fletcher(), "Fletcher(over=slice(2, -3))"),
        (Sum(2, order="big"), 'Sum(2, order="big", over=slice(2, -3))'),
        (Crc("CRC16-MODBUS"), 'Crc("CRC16-MODBUS", order="little", over=slice(2, -3))'),
        (Crc("CRC32-ISO-HDLC"), 'Crc("CRC32-ISO-HDLC", order="little", over=slice(2, -5))'),
    ],
)
def test_packets_of_many_lengths_share_a_check(check: Check, declared: str) -> None:
    """At the same place from the end, in front of a closing byte, though hardly two packets have one length."""
    drawn = np.random.default_rng(5)
    packets: list[bytes] = []
    for number in range(60):
        body = (
            bytes([number % 5, 3]) + drawn.integers(0, 256, drawn.integers(3, 40)).astype(np.uint8).tobytes()
        )
        packets.append(b"\xb5\x62" + body + check.encode(body) + b"\x03")
    (found,) = checks_of_packets(packets)
    assert (found.offset, found.declared) == (-1 - check.size, declared)


def test_a_broken_row_in_twenty_is_no_hindrance() -> None:
    """The share that agrees is said."""
    rows = sealed(rows_of(), Crc("CRC8-SAE-J1850"), 7)
    rows[::40, 7] ^= 0x55
    (found,) = checks_of(rows)
    assert 0.95 < found.confidence < 1
    assert found.agreeing == found.rows - 5


@pytest.mark.parametrize("counts", [15, 16])
@pytest.mark.parametrize(("name", "is_behind"), [("CRC8-AUTOSAR", True), ("CRC8-SAE-J1850", False)])
def test_ids_that_a_counter_chooses_are_solved(name: str, is_behind: bool, counts: int) -> None:
    """AUTOSAR's profile 2 has the id of each count behind the data, profile 1 in front; it is not sent."""
    ids = np.random.default_rng(5).integers(0, 256, 16).tolist()
    rows, crc = rows_of(count=300), Crc(name)
    rows[:, 1] = np.arange(300) % counts
    for row in rows:
        data, chosen = row[1:].tobytes(), bytes([ids[row[1]]])
        row[0] = crc.compute(data + chosen if is_behind else chosen + data)
    [found] = [field for field in fields_of(rows) if field.kind == "check"]
    assert (found.start, found.length, found.values) == (0, 8, tuple(ids[:counts]))
    where = "behind" if is_behind else "in front of"
    assert found.evidence.startswith(
        f"{name} of bytes 1 to 7, and {where} them an id that the counter in byte 1"
    )
    assert found.check is not None
    part = f'DataIds("counter_1_0", bytes.fromhex("{bytes(ids[:counts]).hex(" ").upper()}"))'
    over = f"slice(1, 8), {part}" if is_behind else f"{part}, slice(1, 8)"
    assert found.check.declare("crc") == f"""Crc("{name}", over=[{over}], field='crc')"""


def test_a_plain_check_and_noise_have_no_ids() -> None:
    """A check that checks_of finds is as it was; random bytes beside a counter are no check."""
    plain = sealed(rows_of(), Crc("CRC8-AUTOSAR"), 0)
    [found] = [field for field in fields_of(plain) if field.kind == "check"]
    assert found.check is not None
    noise = rows_of(count=400)
    noise[:, 0] = np.random.default_rng(2).integers(0, 256, 400)
    assert [field for field in fields_of(noise) if field.kind == "check"] == []
