"""moteus: sub-frames by name, in records, columns and conditions."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from aces_bus import Frame, decode
from aces_bus.errors import FieldError
from aces_protocols.moteus.spec import moteus
from aces_protocols.moteus.subframes import register_values


def reply(data: str) -> Any:
    """The record of an answer of device 1."""
    (record,) = moteus.scanner().feed([Frame(0x100, bytes.fromhex(data), is_fd=True)])
    return record


def sent(*items: tuple[str, Any]) -> bytes:
    """The data of a command of these sub-frames."""
    return bytes(moteus.encode("Command", id=1, subframes=[{"kind": k, "data": d} for k, d in items]).data)


def test_values_have_names_and_units_in_every_type() -> None:
    """NaN is the most negative integer of what is measured; plain numbers have none."""
    record = reply("210180 25010080 290100000080 2d010000c07f 217080 5050")
    assert [one.kind for one in record.subframes] == [
        *("reply_i8", "reply_i16", "reply_i32", "reply_f32", "reply_i8", "nop")
    ]
    assert all(math.isnan(one.data.position) for one in record.subframes[:4])
    assert record.subframes[4].data.millisecond_counter == -128


@pytest.mark.parametrize(
    ("data", "reasons"),
    [
        ("21000a 2101", [None, "malformed: cut off"]),
        ("21000a 99 0102", [None, "unknown"]),
        ("21000a 21800001", [None, "malformed: it would be sent as other bytes"]),
        ("2d010100a07f 50", ["malformed: it would be sent as other bytes", None]),
        ("10ff7f01", ["malformed: 16383 registers are more than a frame can have"]),
    ],
)
def test_bytes_that_are_no_sub_frames_cost_themselves(data: str, reasons: list[str | None]) -> None:
    """What stands before and, where that can be known, behind them is read; all is built again as it was."""
    record = reply(data)
    assert [one.reason for one in record.subframes] == reasons
    items = [{"kind": one.kind, "data": plain(one.data), "reason": one.reason} for one in record.subframes]
    assert moteus.encode("Reply", id=1, subframes=items).data == bytes.fromhex(data)


def plain(data: Any) -> Any:
    """The data of a sub-frame as they are given to `encode`."""
    names = getattr(data, "__struct_fields__", None)
    return data if names is None else {name: getattr(data, name) for name in names}


def test_a_count_that_needs_no_byte_of_its_own_stays_there() -> None:
    """A host may write it so; built again, it is the same."""
    record = reply("24 01 02 8813 505050")
    assert (record.subframes[0].kind, register_values(record.subframes)) == (
        "reply_i16_long",
        {"velocity": 1.25},
    )


def test_frames_are_filled_up() -> None:
    """To a length that CAN FD has, with 0x50."""
    assert sent(("write_i8", {"mode": "position"}), ("write_f32", {"command_position": 0.5})).hex() == (
        "01000a0d200000003f505050"
    )


@pytest.mark.parametrize(
    ("items", "message"),
    [
        (
            [("write_i8", {"command_position_max_torque": 500.0})],
            "500 N·m does not fit into i8, which ends at 63.5",
        ),
        ([("write_i16", {"mode": math.nan})], "not a whole number"),
        ([("write_i8", {"mode": "psoition"})], "it is one of stopped, fault"),
        ([("write_f32", {"position": 1.0, "torque": 1.0})], "torque does not follow position"),
        ([("write_f32", {"positoin": 1.0})], "there is no register 'positoin'"),
        ([("write_f64", {"position": 1.0})], "there is no sub-frame 'write_f64'"),
        ([("read_i8", {"mode": 1})], None),
        ([("write_f32", {f"r{n:03x}": 0.0 for n in range(0x200, 0x210)})], "66 bytes|a frame has 64"),
    ],
)
def test_what_cannot_be_sent_is_refused(items: list[tuple[str, Any]], message: str | None) -> None:
    """By register and value, never saturated."""
    with pytest.raises(FieldError, match=message):
        sent(*items)


def test_registers_are_columns() -> None:
    """The first value of each register in a frame, absent where there is none; modes by name."""
    frames = [
        moteus.encode(
            "Reply",
            id=1,
            subframes=[
                {"kind": "reply_i8", "data": {"mode": "position" if n else "stopped"}},
                {"kind": "reply_f32", "data": {"position": 0.25 * n}},
                *([{"kind": "reply_i16", "data": {"voltage": 24.0}}] if n == 2 else []),
            ],
        )
        for n in range(3)
    ]
    table = decode(frames, moteus)["Reply"]
    assert table["subframes.position"].values.dtype == np.float64
    assert table["subframes.position"].values.tolist() == [0.0, 0.25, 0.5]
    assert table["subframes.mode"].to_list() == ["stopped", "position", "position"]
    assert table["subframes.voltage"].to_list() == [None, None, 24.0]
    units = {column.name: column.unit for column in table.kinds}
    assert (units["subframes.position"], units["subframes.torque"]) == ("turn", "N·m")
