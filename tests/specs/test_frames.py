"""The CAN specs on worked examples, and what they say that bytes alone do not."""

from __future__ import annotations

from typing import Any

import pytest

from aces_bus import Frame, Unknown, as_dict, make_scanner
from aces_bus.errors import FieldError
from aces_bus.protocol import CanScanner, Crc
from aces_bus.protocol.reference import Reference
from tests.specs.automotive import automotive
from tests.specs.cases import FRAMES, Case
from tests.specs.catalogue import SPECS
from tests.specs.j1939_like import j1939_like
from tests.specs.mit_motor import MODELS, mit_motor

each = pytest.mark.parametrize("case", FRAMES, ids=[case.key for case in FRAMES])


def scanner_of(case: Case, *, raw: bool = False) -> CanScanner:
    """A scanner that has seen what must be seen before."""
    scanner = make_scanner([SPECS[case.spec].variant(case.dialect)], include_unknown=True, raw=raw)
    assert isinstance(scanner, CanScanner)
    for earlier in case.before:
        assert [type(r).__name__ for r in scanner.feed([earlier.frame])] == [earlier.message]
    return scanner


def tolerance(case: Case, name: str) -> float:
    """Ranged numbers are stated as sent, which is up to one count beside what they decode to."""
    if case.spec != "mit_motor" or case.dialect is None:
        return 0
    position, velocity, torque = MODELS[case.dialect]
    steps = {
        "position": 2 * position / 0xFFFF,
        "velocity": 2 * velocity / 0xFFF,
        "torque": 2 * torque / 0xFFF,
    }
    return {**steps, "kp": 500 / 0xFFF, "kd": 5 / 0xFFF}.get(name, 0)


@each
def test_a_frame(case: Case) -> None:
    """One frame gives its record with the stated values."""
    (record,) = scanner_of(case).feed([case.frame])
    assert type(record).__name__ == case.message
    values = as_dict(record)
    for name, wanted in case.fields.items():
        near = tolerance(case, name)
        assert values[name] == (
            pytest.approx(wanted, abs=near) if near and not isinstance(wanted, str) else wanted
        ), name
    assert (record.meta.identifier, record.meta.extended, record.meta.raw) == (
        case.id,
        case.extended,
        case.data,
    )


@each
def test_the_same_frame_comes_back(case: Case) -> None:
    """Encoding a record's fields gives the frame it came from, in units and raw."""
    protocol = SPECS[case.spec]
    variant = protocol.variant(case.dialect)
    (record,) = scanner_of(case).feed([case.frame])
    (raw,) = scanner_of(case, raw=True).feed([case.frame])
    built: list[Any] = [
        protocol.encode(case.message, dialect=case.dialect, **as_dict(record)),
        variant.encoder.build(variant[case.message], as_dict(raw), raw=True),
    ]
    for frame in built:
        assert (frame.arbitration_id, bytes(frame.data)) == (case.id, case.data)
        assert (frame.is_extended_id, frame.is_remote_frame) == (case.extended, case.remote)


@each
def test_with_any_bit_changed_the_reference_agrees(case: Case) -> None:
    """Frames near an example are what the reference says they are, and all are counted."""
    assert case.id is not None
    width = 29 if case.extended else 11
    frames = [
        Frame(case.id ^ 1 << bit, case.data, is_extended_id=case.extended, is_remote_frame=case.remote)
        for bit in range(width)
    ]
    for bit in range(8 * len(case.data)):
        data = (int.from_bytes(case.data, "little") ^ 1 << bit).to_bytes(len(case.data), "little")
        frames.append(Frame(case.id, data, is_extended_id=case.extended))
    frames += [
        Frame(case.id, case.data[:size], is_extended_id=case.extended) for size in range(len(case.data))
    ]
    if case.id <= 0x7FF:
        frames.append(Frame(case.id, case.data, is_extended_id=not case.extended))
    scanner = scanner_of(case)
    reference = Reference([SPECS[case.spec].variant(case.dialect)])
    wanted = reference.frames([*(b.frame for b in case.before), *frames])[len(case.before) :]
    found = scanner.feed(frames)
    assert [None if isinstance(r, Unknown) else type(r).__name__ for r in found] == [
        f.message for f in wanted
    ]
    assert [r.reason if isinstance(r, Unknown) else "" for r in found] == [f.reason for f in wanted]
    assert scanner.counts.balance == 0


# ---------------------------------------------------------------------- MIT motor


@pytest.mark.parametrize("model", MODELS)
def test_a_command_is_sent_within_one_count(model: str) -> None:
    """Whatever the model's ranges, a command comes back within half a count, and the ends of a range exactly."""
    position, velocity, torque = MODELS[model]
    sent: dict[str, Any] = {
        "position": position,
        "velocity": -velocity,
        "kp": 123.4,
        "kd": 5.0,
        "torque": 0.5,
    }
    frame = mit_motor.encode("Command", dialect=model, motor=3, **sent)
    (record,) = mit_motor.scanner(dialect=model).feed([frame])
    assert (record.position, record.velocity) == pytest.approx((position, -velocity), rel=1e-12)
    assert record.kd == pytest.approx(5)
    assert record.kp == pytest.approx(123.4, abs=500 / 0xFFF / 2)
    assert record.torque == pytest.approx(0.5, abs=torque / 0xFFF)


def test_a_command_beyond_its_range_is_refused() -> None:
    """The message names the field, the value, its unit and the range."""
    with pytest.raises(FieldError, match=r"torque: 18\.1 N·m is outside -18…18 N·m"):
        mit_motor.encode(
            "Command", dialect="AK80_9", motor=1, position=0, velocity=0, kp=0, kd=0, torque=18.1
        )


def test_special_frames_go_before_commands() -> None:
    """All at maximum is a command as well; the special meaning wins, as in the motor."""
    scanner = mit_motor.scanner(dialect="DM4310")
    frames = [Frame(1, b"\xff" * 7 + bytes([last])) for last in (0xFA, 0xFB, 0xFC, 0xFD, 0xFE, 0xFF)]
    assert [type(r).__name__ for r in scanner.feed(frames)] == [
        "Command",
        "ClearError",
        "Enable",
        "Disable",
        "SetZero",
        "Command",
    ]


def test_a_register_reply_needs_its_request() -> None:
    """The bytes of a reply are a feedback too; only the request tells, and it tells once."""
    reply = Frame(0x011, bytes.fromhex("0100331500004841"))
    ask = Frame(0x7FF, bytes.fromhex("0100331500000000"))
    scanner = mit_motor.scanner(dialect="DM4310")
    assert [type(r).__name__ for r in scanner.feed([reply, ask, reply, reply])] == [
        "Feedback",
        "ReadFloat",
        "ReadFloatReply",
        "Feedback",
    ]


def test_motors_of_two_models_share_a_bus() -> None:
    """Each variant has the motors of its configuration; one scanner reads both."""
    ak = mit_motor.variant("AK80_9", {"motors": {1: True, 2: True}})
    dm = mit_motor.variant("DM4310", {"motors": {3: True}})
    scanner = make_scanner([ak, dm], include_unknown=True)
    zero = bytes.fromhex("7FFF7FF0000007FF")
    ak_reply, dm_reply = bytes([2]) + bytes(7), bytes([0x13]) + bytes(7)
    records = scanner.feed(
        [Frame(1, zero), Frame(3, zero), Frame(4, zero), Frame(0, ak_reply), Frame(0, dm_reply)]
    )
    assert [round(getattr(r, "velocity", 99)) for r in records] == [0, 0, 99, -50, -30]
    assert isinstance(records[2], Unknown)
    assert [r.meta.message for r in records[3:]] == ["Feedback", "Feedback"]


# ---------------------------------------------------------------------- the invented car

SPEEDS: dict[str, Any] = {
    "state": "ok", "front_left": 50.0, "front_right": 50.0625, "rear": 49.9375, "slip": -1.5, "counter": 3,
}  # fmt: skip


def test_bit_orders_stand_side_by_side() -> None:
    """LSB-first, MSB-first and signed fields land on the bits that their sheets say."""
    data = bytes(automotive.encode("WheelSpeeds", **SPEEDS).data)
    assert data[1] & 0xF == 3
    assert data[1] >> 4 & 3 == 1
    assert int.from_bytes(data[2:5], "little") == 800 | 801 << 12
    assert data[5] << 4 | data[6] >> 4 == 799
    assert data[7] == 0xFD


def test_the_check_covers_the_identifier() -> None:
    """It is over the identifier, low byte first, and all data but itself."""
    frame = automotive.encode("WheelSpeeds", **SPEEDS)
    assert frame.data[0] == Crc("CRC8-SAE-J1850").compute(b"\xa0\x01" + bytes(frame.data[1:]))
    (record,) = automotive.scanner().feed([frame])
    assert {**as_dict(record)} == {**SPEEDS, "reserved": 0}


def test_the_check_covers_a_data_id_that_is_not_sent() -> None:
    """Steering's check begins with its data id."""
    frame = automotive.encode("Steering", angle=12.3, rate=-4.5, alive=200)
    assert frame.data[5] == Crc("CRC8-SAE-J1850").compute(b"\x2a\x01" + bytes(frame.data[:5]))


def test_any_wrong_bit_fails_the_check() -> None:
    """A frame with one bit changed is malformed; the good one behind it is decoded."""
    for good in (
        automotive.encode("WheelSpeeds", **SPEEDS),
        automotive.encode("Steering", angle=1, rate=2, alive=3),
    ):
        scanner = automotive.scanner(include_unknown=True)
        for bit in range(8 * len(good.data)):
            data = (int.from_bytes(good.data, "little") ^ 1 << bit).to_bytes(len(good.data), "little")
            (lost, found) = scanner.feed([Frame(good.arbitration_id, data), good])
            assert isinstance(lost, Unknown)
            assert lost.reason == "malformed: checksum"
            assert not isinstance(found, Unknown)
        assert scanner.counts.malformed == scanner.counts.decoded == 8 * len(good.data)


def test_a_rolling_counter_counts_what_was_missed() -> None:
    """The encoder rolls at its modulus; the scanner counts gaps and nothing else."""
    encoder = automotive.variant().encoder
    values = {k: v for k, v in SPEEDS.items() if k != "counter"}
    frames = [encoder.next("WheelSpeeds", **values) for _ in range(40)]
    assert [f.data[1] & 0xF for f in frames[13:17]] == [13, 14, 0, 1]
    scanner = automotive.scanner()
    scanner.feed(frames)
    assert scanner.counts.missed == 0
    scanner.feed(frames[10:20])  # 39 % 15 = 9, so nothing between
    scanner.feed(frames[23:])
    assert scanner.counts.missed == 3


@pytest.mark.parametrize(
    ("fields", "data"),
    [
        ({"page": "temperatures", "ignition": 1, "inside": -1.5, "outside": 20.0}, "10f16309"),
        ({"page": "fans", "ignition": 0, "fan": 75, "flaps": 40}, "014b2800"),
        ({"page": 2, "ignition": 0, "flaps": 100}, "02006400"),
        ({"page": "faults", "ignition": 0, "faults": ["sensor", "leak"]}, "05800100"),
        ({"page": 9, "ignition": 1, "reserved": 0x700}, "19070000"),
    ],
)
def test_pages_of_a_bit_layout(fields: dict[str, Any], data: str) -> None:
    """A signal is there on its page only; bits of no signal are kept."""
    frame = automotive.encode("Climate", **fields)
    assert bytes(frame.data).hex() == data
    (record,) = automotive.scanner().feed([frame])
    values = as_dict(record)
    for name in ("inside", "outside", "fan", "flaps", "faults"):
        if name not in fields:
            assert values[name] is None
        elif name == "faults":
            assert list(values[name]) == fields[name]
        else:
            assert values[name] == pytest.approx(fields[name])


def test_a_signal_of_another_page_is_refused() -> None:
    """What the page cannot carry is named."""
    with pytest.raises(FieldError, match="fan: only there while page is 1"):
        automotive.encode("Climate", page="temperatures", ignition=0, inside=1, outside=1, fan=3)


@pytest.mark.parametrize(
    ("fields", "data"),
    [
        ({"kind": "odometer", "odometer": 123456.7}, "0187d61200"),
        ({"kind": "voltages", "voltages": [12.0, 5.0, 3.3]}, "02e02e8813e40c"),
        ({"kind": "build", "variant": 7, "build": 4000}, "0307a00f"),
        ({"kind": 77}, "4d"),
    ],
)
def test_a_record_whose_length_is_its_kind(fields: dict[str, Any], data: str) -> None:
    """Each kind has its fields and its length; another length is malformed."""
    frame = automotive.encode("Diagnosis", **fields)
    assert bytes(frame.data).hex() == data
    scanner = automotive.scanner(include_unknown=True)
    longer = Frame(frame.arbitration_id, bytes(frame.data) + b"\0")
    (record, lost) = scanner.feed([frame, longer])
    values = {name: value for name, value in as_dict(record).items() if value is not None}
    assert values == {
        name: pytest.approx(value) if name != "kind" else value for name, value in fields.items()
    }
    assert lost.reason.startswith("malformed: length")


# ---------------------------------------------------------------------- J1939


def test_raw_values_that_mean_not_available() -> None:
    """They decode to None, and None is sent as them."""
    frame = j1939_like.encode("VehicleDistance", priority=6, source_address=0x21, trip=None, total=1000.5)
    assert bytes(frame.data).hex() == "ffffffff441f0000"
    (record,) = j1939_like.scanner().feed([frame])
    assert (record.trip, record.total) == (None, 1000.5)


def test_a_pattern_larger_than_any_table() -> None:
    """Half a billion identifiers are one message; making the scanner does not list them."""
    scanner = j1939_like.scanner()
    assert isinstance(scanner, CanScanner)
    frames = [Frame(priority << 26 | pgn << 8 | source, b"\1", is_extended_id=True)
              for priority in (0, 7) for pgn in (0x100, 0x3FF00) for source in (0, 0xFF)]  # fmt: skip
    records = scanner.feed(frames)
    assert [(r.priority, r.pgn, r.source_address) for r in records] == [
        (p, g, s) for p in (0, 7) for g in (0x100, 0x3FF00) for s in (0, 0xFF)
    ]
