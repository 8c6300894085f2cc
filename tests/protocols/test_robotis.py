"""Dynamixel 1.0: the worked examples of the manual and of recordings, who answers whom, and the control table.

1. Bytes of an example are written out here, never made by the code under test.
"""

from __future__ import annotations

import doctest
from pathlib import Path
from typing import Any, Literal

import pytest

from aces_bus import Unknown, as_dict
from aces_bus.errors import CallerError, FieldError, UnknownNameError
from aces_bus.protocol.live.stream import StreamScanner
from aces_protocols.robotis import spec
from aces_protocols.robotis.spec import control_table, robotis

Direction = Literal["to device", "from device"]
TO: Direction = "to device"
FROM: Direction = "from device"


def packet(text: str) -> bytes:
    return bytes.fromhex(text)


def opened(direction: Direction | Literal["both"], *, include_unknown: bool = False) -> StreamScanner:
    scanner = robotis.scanner(direction=direction, include_unknown=include_unknown)
    assert isinstance(scanner, StreamScanner)
    return scanner


def read(data: bytes, direction: Direction | Literal["both"]) -> list[Any]:
    """Everything that is found in `data`, the stream being closed behind it."""
    scanner = opened(direction, include_unknown=True)
    found = scanner.feed(data) + scanner.close()
    assert scanner.counts.balance == 0
    return found


def names(found: list[Any]) -> list[str]:
    return [f.reason if isinstance(f, Unknown) else type(f).__name__ for f in found]


# ---------------------------------------------------------------------- worked examples

#: What it is, its bytes, its direction, message and fields.
EXAMPLES: list[tuple[str, str, Direction, str, dict[str, Any]]] = [
    ("read 50 bytes", "FF FF 01 04 02 00 32 C6", TO, "Read", {"id": 1, "start": 0, "count": 50}),
    ("LED on", "FF FF 01 04 03 19 01 DD", TO, "Write", {"id": 1, "start": 0x19, "data": b"\x01"}),
    ("goal 502", "FF FF 01 05 03 1E F6 01 E1", TO, "Write", {"id": 1, "start": 0x1E, "data": b"\xf6\x01"}),
    ("OK", "FF FF 01 02 00 FC", FROM, "Status", {"id": 1, "error": 0, "parameters": b""}),
    ("read temperature", "FF FF 01 04 02 2B 01 CC", TO, "Read", {"id": 1, "start": 0x2B, "count": 1}),
    ("temperature 32", "FF FF 01 03 00 20 DB", FROM, "Status", {"id": 1, "error": 0, "parameters": b"\x20"}),
    ("two errors", "FF FF 01 02 24 D8", FROM, "Status", {"id": 1, "error": 0x24, "parameters": b""}),
    ("set id 1", "FF FF FE 04 03 03 01 F6", TO, "Write", {"id": 0xFE, "start": 3, "data": b"\x01"}),
    (
        "two goals",
        "FF FF FE 0A 83 1E 02 47 10 02 60 00 02 99",
        TO,
        "SyncWrite",
        {
            "start": 0x1E,
            "size": 2,
            "servos": [{"id": 71, "data": b"\x10\x02"}, {"id": 96, "data": b"\x00\x02"}],
        },
    ),
    ("ping", "FF FF 01 02 01 FB", TO, "Ping", {"id": 1}),
    (
        "goal 0, held",
        "FF FF 00 05 04 1E 00 00 D8",
        TO,
        "RegWrite",
        {"id": 0, "start": 0x1E, "data": b"\x00\x00"},
    ),
    ("action", "FF FF FE 02 05 FA", TO, "Action", {"id": 0xFE}),
    ("reset", "FF FF 00 02 06 F7", TO, "Reset", {"id": 0}),
    ("voltages", "FF FF 01 05 03 0C 64 AA DC", TO, "Write", {"id": 1, "start": 0x0C, "data": b"\x64\xaa"}),
]
by_name = pytest.mark.parametrize(
    ("data", "direction", "message", "fields"),
    [(packet(text), direction, message, fields) for _, text, direction, message, fields in EXAMPLES],
    ids=[name for name, *_ in EXAMPLES],
)


@by_name
def test_an_example_is_read(data: bytes, direction: Direction, message: str, fields: dict[str, Any]) -> None:
    """Each worked example is one packet with the fields that its source names."""
    (found,) = read(data, direction)
    assert type(found).__name__ == message
    assert as_dict(found) == fields
    assert (found.meta.offset, found.meta.size, found.meta.raw) == (0, len(data), data)
    assert (found.meta.direction, found.meta.protocol) == (direction, "robotis")


@by_name
def test_an_example_is_written(
    data: bytes, direction: Direction, message: str, fields: dict[str, Any]
) -> None:
    """The fields of each worked example give its bytes, length and checksum included."""
    assert robotis.encode(message, **fields) == data


@by_name
def test_an_example_survives_every_stream(
    data: bytes, direction: Direction, message: str, fields: dict[str, Any]
) -> None:
    """An example is found byte by byte, behind one FF, behind noise and before the beginning of another packet."""
    noise = packet("00 13 FF FF 40 02 FF 77")  # a false header among it, too short to swallow anything
    scanner = opened(direction)
    found = [record for byte in data for record in scanner.feed(bytes([byte]))]
    for before, behind in ((b"", b"\xff"), (b"\xff", b""), (noise, noise), (b"\xff\xff", b"\xff\xff\x01")):
        (record,) = [f for f in read(before + data + behind, direction) if not isinstance(f, Unknown)]
        assert record.meta.offset == len(before)
        found.append(record)
    assert [as_dict(record) for record in found] == [fields] * 5


@by_name
def test_a_flipped_bit_is_noticed(
    data: bytes, direction: Direction, message: str, fields: dict[str, Any]
) -> None:
    """With any one bit flipped, an example is not read as a packet of its size."""
    for bit in range(8 * len(data)):
        damaged = bytearray(data)
        damaged[bit // 8] ^= 1 << bit % 8
        assert len(data) not in [
            f.meta.size for f in read(bytes(damaged), direction) if not isinstance(f, Unknown)
        ]


@pytest.mark.parametrize(
    ("text", "direction"),
    [("FF FF 01 02 00 FD", FROM), ("FF FF 01 05 03 0C 64 AA DD", TO)],
    ids=["OK of id 1", "the worked checksum"],
)
def test_checksums_that_the_manual_misprints_are_malformed(text: str, direction: Direction) -> None:
    """Examples that the manual prints one off are not packets: the rule wins, and the byte before them is right."""
    data = packet(text)
    assert names(read(data, direction))[0] == "malformed: checksum"
    right = data[:-1] + bytes([data[-1] - 1])
    assert len(read(right, direction)) == 1


# ---------------------------------------------------------------------- framing


def test_id_ff_cannot_occur() -> None:
    """Of FF FF FF the last two are the header, and a packet to id 0xFF is refused."""
    found = read(packet("FF FF FF FF 01 02 01 FB"), TO)
    assert names(found) == ["skipped", "Ping"]
    assert [f.meta.offset for f in found] == [0, 2]
    with pytest.raises(FieldError, match="Ping: FF behind FF FF"):
        robotis.encode("Ping", id=0xFF)


def test_a_false_header_loses_no_packet() -> None:
    """A false header with a long length holds a good packet back only until silence or the end of the stream."""
    false, good = packet("FF FF 10 FA"), packet("FF FF 01 02 00 FC")
    for end in ("idle", "close"):
        scanner = opened(FROM)
        assert scanner.feed(false + good) == []
        (record,) = getattr(scanner, end)()
        assert record.meta.offset == len(false)


def test_lengths_are_bounded() -> None:
    """The greatest packet has 259 bytes; the encoder refuses one more, and one below the least is malformed."""
    assert len(robotis.encode("Write", id=1, start=0, data=bytes(252))) == 259
    with pytest.raises(FieldError, match="259"):
        robotis.encode("Write", id=1, start=0, data=bytes(253))
    assert names(read(packet("FF FF 01 00 FE"), TO))[0] == "malformed: length"


def test_an_unknown_instruction_is_unknown() -> None:
    """A whole packet with an instruction that does not exist is counted as unknown, with its bytes."""
    (found,) = read(packet("FF FF 01 02 07 F5"), TO)
    assert (found.reason, found.meta.raw) == ("unknown", packet("FF FF 01 02 07 F5"))


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("FF FF FE 0A 83 1E 02 47 10 02 60 00 02 99", "SyncWrite"),
        ("FF FF FE 07 83 1E 02 47 10 02 FE", "SyncWrite"),
        ("FF FF FE 04 83 1E 02 5A", "SyncWrite"),  # to nobody
        ("FF FF FE 06 83 1E 00 47 60 B3", "SyncWrite"),  # nothing to each
        ("FF FF FE 09 83 1E 02 47 10 02 60 00 9C", "unknown"),  # one byte short
        ("FF FF FE 08 83 1E 02 47 10 02 60 9D", "unknown"),
        ("FF FF FE 0B 83 1E 02 47 10 02 60 00 02 05 93", "unknown"),  # one byte more
        ("FF FF FE 03 83 1E 5D", "unknown"),  # no size
    ],
)
def test_a_sync_write_has_whole_servos(text: str, what: str) -> None:
    """A SyncWrite whose length is not 4 + n · (size + 1) is unknown; nothing is made of its beginning."""
    assert names(read(packet(text), TO)) == [what]


def test_a_sync_write_to_one_servo_is_unknown() -> None:
    """SYNC_WRITE must go to everyone: with another id it is not a message."""
    assert names(read(packet("FF FF 47 07 83 1E 02 47 10 02 B5"), TO)) == ["unknown"]


def test_a_sync_write_of_uneven_data_is_refused() -> None:
    """Each servo of a SyncWrite gets `size` bytes; the error names the field and both sizes."""
    servos = [{"id": 1, "data": b"\x01\x02"}, {"id": 2, "data": b"\x01"}]
    with pytest.raises(FieldError, match=r"SyncWrite: servos.*expected 2, found 1"):
        robotis.encode("SyncWrite", start=0x1E, size=2, servos=servos)


# ---------------------------------------------------------------------- errors


def test_error_bits_have_names() -> None:
    """A status names its errors; a bit without a name is kept and written again."""
    (status,) = read(packet("FF FF 01 02 24 D8"), FROM)
    assert list(status.error) == ["overheating", "overload"]
    assert status.error.overload
    assert not status.error.voltage
    assert (
        robotis.encode("Status", id=1, error={"overload", "overheating"}, parameters=b"") == status.meta.raw
    )

    (odd,) = read(packet("FF FF 01 02 81 7B"), FROM)
    assert (list(odd.error), odd.error.unknown) == (["voltage"], 0x80)
    assert robotis.encode("Status", **as_dict(odd)) == odd.meta.raw


@pytest.mark.parametrize(
    ("bit", "name"),
    list(
        enumerate(["voltage", "angle_limit", "overheating", "range", "checksum", "overload", "instruction"])
    ),
)
def test_each_error_bit_is_the_sheet_s(bit: int, name: str) -> None:
    """Bits 0 to 6 of the error byte are named in the sheet's order."""
    (status,) = read(robotis.encode("Status", id=9, error=1 << bit, parameters=b""), FROM)
    assert list(status.error) == [name]


# ---------------------------------------------------------------------- who speaks

PING, READ, OK = "FF FF 01 02 01 FB", "FF FF 01 04 02 2B 01 CC", "FF FF 01 02 00 FC"
READ_REPLY = "FF FF 01 03 00 20 DB"
ACTION, PING_ALL = "FF FF FE 02 05 FA", "FF FF FE 02 01 FE"


def test_bytes_alone_do_not_tell_who_speaks() -> None:
    """A scanner that does not know the direction is refused, and the message names the ways out."""
    with pytest.raises(CallerError, match=r"Ping.*'to device', 'from device' or 'both'"):
        robotis.scanner()


@pytest.mark.parametrize(
    ("packets", "messages"),
    [
        ([READ, READ_REPLY], ["Read", "Status"]),
        ([PING, OK, READ, READ_REPLY], ["Ping", "Status", "Read", "Status"]),
        ([READ, READ_REPLY, READ, READ_REPLY], ["Read", "Status"] * 2),
        # the answer may look like an instruction: error 1 is 0x01, as a Ping is
        ([PING, PING], ["Ping", "Status"]),
        # a request to another servo opens nothing for this one
        (["FF FF 02 02 01 FA", PING], ["Ping", "Ping"]),
        # one answer a request
        ([READ, READ_REPLY, PING], ["Read", "Status", "Ping"]),
        # broadcasts are not answered …
        ([ACTION, PING], ["Action", "Ping"]),
        (["FF FF FE 04 03 03 01 F6", READ, READ_REPLY], ["Write", "Read", "Status"]),
        (["FF FF FE 0A 83 1E 02 47 10 02 60 00 02 99", PING, OK], ["SyncWrite", "Ping", "Status"]),
        # … except a Ping, once by each servo
        (
            [PING_ALL, OK, "FF FF 02 02 00 FB", READ, READ_REPLY],
            ["Ping", "Status", "Status", "Read", "Status"],
        ),
        ([PING_ALL, "FF FF FE 02 05 FA"], ["Ping", "Action"]),
    ],
)
def test_both_directions_are_told_by_the_request(packets: list[str], messages: list[str]) -> None:
    """On a line where both speak, a packet is a status when a request to its id is open, else an instruction."""
    data = b"".join(packet(text) for text in packets)
    assert names(read(data, "both")) == messages
    scanner = opened("both")
    assert [type(r).__name__ for byte in data for r in scanner.feed(bytes([byte]))] == messages


def test_a_status_without_a_request_says_what_it_needs() -> None:
    """An answer to nothing that was seen is unknown, with the requests that would explain it."""
    (found,) = read(packet(READ_REPLY), "both")
    assert found.reason.startswith("unknown: needs request Ping|Read|Write")


def test_a_request_grows_old() -> None:
    """A request is open for half a second, by the times that the stream is fed with."""
    for later, message in ((0.4, "Status"), (0.6, "Ping")):
        scanner = opened("both")
        scanner.feed(packet(PING), 100.0)
        (found,) = scanner.feed(packet(PING), 100.0 + later)
        assert type(found).__name__ == message


# ---------------------------------------------------------------------- control table

#: address, size and name of every register, as the manual lists them.
REGISTERS = [
    (0x00, 2, "model_number"), (0x02, 1, "firmware_version"), (0x03, 1, "id"), (0x04, 1, "baud_rate"),
    (0x05, 1, "return_delay"), (0x06, 2, "cw_angle_limit"), (0x08, 2, "ccw_angle_limit"),
    (0x0B, 1, "highest_temperature"), (0x0C, 1, "lowest_voltage"), (0x0D, 1, "highest_voltage"),
    (0x0E, 2, "max_torque"), (0x10, 1, "status_return_level"), (0x11, 1, "alarm_led"),
    (0x12, 1, "alarm_shutdown"), (0x18, 1, "torque_enable"), (0x19, 1, "led"),
    (0x1A, 1, "cw_compliance_margin"), (0x1B, 1, "ccw_compliance_margin"), (0x1C, 1, "cw_compliance_slope"),
    (0x1D, 1, "ccw_compliance_slope"), (0x1E, 2, "goal_position"), (0x20, 2, "moving_speed"),
    (0x22, 2, "torque_limit"), (0x24, 2, "present_position"), (0x26, 2, "present_speed"),
    (0x28, 2, "present_load"), (0x2A, 1, "present_voltage"), (0x2B, 1, "present_temperature"),
    (0x2C, 1, "registered_instruction"), (0x2E, 1, "moving"), (0x2F, 1, "lock"), (0x30, 2, "punch"),
]  # fmt: skip
HOLES = {0x0A, *range(0x13, 0x18), 0x2D}


def test_the_table_is_the_manual_s() -> None:
    """Every register of the manual is there at its address; the holes are holes; each one is explained."""
    found = sorted((r.address, r.size, r.name) for r in control_table.values())
    assert found == REGISTERS
    covered = {at + i for at, size, _ in REGISTERS for i in range(size)}
    assert covered | HOLES == set(range(50))
    assert not covered & HOLES
    assert [r.name for r in control_table.values() if not r.doc or not r.source] == []
    assert robotis.register_map is control_table


def test_what_is_measured_cannot_be_written() -> None:
    """Exactly the sheet's read-only registers are read only."""
    assert {r.name for r in control_table.values() if r.access == "read"} == {
        "model_number", "firmware_version", "present_position", "present_speed", "present_load",
        "present_voltage", "present_temperature", "registered_instruction", "moving",
    }  # fmt: skip
    with pytest.raises(FieldError, match="present_position can only be read"):
        control_table.write(1, {"present_position": 10})


@pytest.mark.parametrize(
    ("name", "data", "value"),
    [
        ("model_number", "1C 00", "RX-28"),
        ("model_number", "63 00", 99),
        ("baud_rate", "01", 1_000_000),
        ("baud_rate", "03", 500_000),
        ("baud_rate", "10", 117_647.06),
        ("baud_rate", "22", 57_142.86),
        ("baud_rate", "67", 19_230.77),
        ("baud_rate", "CF", 9_615.38),
        ("return_delay", "FA", 500),
        ("highest_temperature", "50", 80),
        ("lowest_voltage", "3C", 6.0),
        ("highest_voltage", "BE", 19.0),
        ("max_torque", "FF 03", 100.0),
        ("status_return_level", "01", "read_only"),
        ("torque_enable", "01", "on"),
        ("cw_compliance_margin", "01", 300 / 1023),
        ("cw_compliance_slope", "20", 32),
        ("goal_position", "00 00", 0.0),
        ("goal_position", "00 02", 150.1466),
        ("goal_position", "FF 03", 300.0),
        ("moving_speed", "FF 03", 113.553),
        ("present_speed", "64 00", 11.1),
        ("present_speed", "64 04", -11.1),
        ("present_load", "FF 03", 100.0),
        ("present_load", "FF 07", -100.0),
        ("present_voltage", "6F", 11.1),
        ("present_temperature", "25", 37),
        ("punch", "20 00", 32),
    ],
)
def test_a_register_reads_in_the_sheet_s_unit(name: str, data: str, value: Any) -> None:
    """Register bytes read as the sheet's value and, where the register can be written, are written from it."""
    register = control_table[name]
    found = register.decode(packet(data))
    assert found == (value if isinstance(value, str) else pytest.approx(value))
    if register.access != "read":
        assert register.encode(found) == packet(data)


@pytest.mark.parametrize("name", [name for _, _, name in REGISTERS])
def test_raw_values_are_the_bytes(name: str) -> None:
    """Raw, every register is the unsigned little-endian number on the wire, both ways."""
    register = control_table[name]
    for number in (0, 1, 0x7F, 0xFF) if register.size == 1 else (0, 1, 0x3FF, 0x464, 0xFFFF):
        data = number.to_bytes(register.size, "little")
        assert register.decode(data, raw=True) == number
        assert register.encode(number, raw=True) == data


def test_defaults_are_inside_the_ranges() -> None:
    """A default of the sheet can be written, in the sheet's unit."""
    defaults = {r.name: r.default for r in control_table.values() if r.default is not None}
    assert defaults == {
        "id": 1, "baud_rate": 34, "return_delay": 250, "cw_angle_limit": 0, "ccw_angle_limit": 1023,
        "highest_temperature": 80, "lowest_voltage": 60, "highest_voltage": 240, "alarm_led": 36,
        "alarm_shutdown": 36, "cw_compliance_margin": 0, "ccw_compliance_margin": 0,
        "cw_compliance_slope": 32, "ccw_compliance_slope": 32, "punch": 32,
    }  # fmt: skip
    for name, default in defaults.items():
        register = control_table[name]
        data = default.to_bytes(register.size, "little")
        assert register.encode(register.decode(data)) == data


@pytest.mark.parametrize(
    ("values", "says"),
    [
        ({"goal_position": 301}, r"goal_position.*301 ° is outside 0…300 °"),
        ({"goal_position": -1}, r"goal_position.*outside"),
        ({"id": 254}, r"id.*254.*outside 0…253"),
        ({"cw_compliance_slope": 0}, r"cw_compliance_slope.*outside 1…254"),
        ({"punch": 31}, r"punch.*outside 32…1023"),
        ({"cw_compliance_margin": 80}, r"cw_compliance_margin.*outside"),
        ({"led": "dim"}, r"led.*'dim'.*off, on"),
        ({"alarm_led": ["heat"]}, r"alarm_led.*'heat'.*overheating"),
        ({"baud_rate": 1_500_000}, r"baud_rate.*within 3 %.*2000000"),
        ({"baud_rate": 1200}, r"baud_rate.*within 3 %.*7812"),
        ({"goal_position": 10, "torque_limit": 50}, r"side by side"),
    ],
)
def test_a_value_that_does_not_fit_is_refused(values: dict[str, Any], says: str) -> None:
    """What the sheet does not allow is not sent; the message names register, value and what would do."""
    with pytest.raises(FieldError, match=says):
        control_table.write(1, values)


def test_an_unknown_register_is_named() -> None:
    """A name that does not exist is answered with the one that was probably meant."""
    with pytest.raises(UnknownNameError, match="did you mean 'goal_position'"):
        control_table.read(1, "goal_positon")


@pytest.mark.parametrize(("rate", "setting"), [(57_600, 34), (1_000_000, 1), (115_200, 16), (9_600, 207)])
def test_nominal_baud_rates_find_their_setting(rate: int, setting: int) -> None:
    """A nominal rate is written as the setting that comes within 3 % of it."""
    assert control_table["baud_rate"].encode(rate) == bytes([setting])


def test_registers_are_read_and_written_by_name() -> None:
    """Reading, writing and holding back registers gives the packets of the worked examples."""
    assert control_table.read(1, "model_number", "punch") == packet("FF FF 01 04 02 00 32 C6")
    assert control_table.read(1, "present_temperature") == packet("FF FF 01 04 02 2B 01 CC")
    assert control_table.write(1, {"led": "on"}) == packet("FF FF 01 04 03 19 01 DD")
    assert control_table.write(1, {"goal_position": 502 * 300 / 1023}) == packet("FF FF 01 05 03 1E F6 01 E1")
    assert control_table.write(0xFE, {"id": 1}) == packet("FF FF FE 04 03 03 01 F6")
    assert control_table.write(1, {"highest_voltage": 17, "lowest_voltage": 10}) == packet(
        "FF FF 01 05 03 0C 64 AA DC"
    )
    assert control_table.write(0, {"goal_position": 0}, message="RegWrite") == packet(
        "FF FF 00 05 04 1E 00 00 D8"
    )


def test_many_servos_are_written_at_once() -> None:
    """One register of many servos goes out as the SyncWrite of the worked example."""
    goals = {71: 528 * 300 / 1023, 96: 512 * 300 / 1023}
    assert control_table.sync_write("goal_position", goals) == packet(
        "FF FF FE 0A 83 1E 02 47 10 02 60 00 02 99"
    )


def test_an_answer_reads_through_the_table() -> None:
    """Bytes read from any address give the registers that are whole among them."""
    (status,) = read(packet("FF FF 01 03 00 20 DB"), FROM)
    assert control_table.decode(0x2B, status.parameters) == {"present_temperature": 32}
    # from the upper half of present_position to the lower half of present_load
    values = control_table.decode(0x25, packet("01 64 04 FF"))
    assert values == {"present_speed": pytest.approx(-11.1)}


@pytest.mark.shared
def test_a_real_table_reads_as_its_owner_says(shared_captures: Path) -> None:
    """The table of a real RX-10, asked for and answered on one line: model, limits, voltage, temperature, positions."""
    folder = shared_captures / "robotis"
    asked = (folder / "ctrl_tbl_read.to-servo.bin").read_bytes()
    answered = (folder / "ctrl_tbl_read.from-servo.bin").read_bytes()
    question, answer = read(asked[:8] + answered[:56], "both")
    assert answer.meta.offset == 8
    raw = control_table.decode(question.start, answer.parameters, raw=True)
    assert (raw["goal_position"], raw["present_position"], raw["baud_rate"]) == (338, 336, 34)
    values = control_table.decode(question.start, answer.parameters)
    assert len(values) == len(control_table)
    wanted = {
        "model_number": "RX-10",
        "firmware_version": 0x17,
        "id": 1,
        "baud_rate": pytest.approx(57_142.857),
        "return_delay": 500,
        "lowest_voltage": pytest.approx(6.0),
        "highest_voltage": pytest.approx(19.0),
        "status_return_level": "all",
        "alarm_led": 36,
        "torque_enable": "on",
        "cw_compliance_margin": pytest.approx(0.2933, abs=1e-4),
        "goal_position": pytest.approx(99.12, abs=0.01),
        "present_position": pytest.approx(98.53, abs=0.01),
        "present_voltage": pytest.approx(11.1),
        "present_temperature": 37,
        "moving": "no",
        "lock": "open",
        "punch": 32,
    }
    assert {name: values[name] for name in wanted} == wanted
    assert list(values["alarm_shutdown"]) == ["overheating", "overload"]


def test_the_readme_s_session_is_true() -> None:
    """What the README shows at the prompt is what Python answers."""
    text = Path(spec.__file__).with_name("README.md").read_text(encoding="utf-8").replace("```", "")
    session = doctest.DocTestParser().get_doctest(text, {}, "README.md", None, 0)
    assert len(session.examples) >= 4
    assert doctest.DocTestRunner().run(session).failed == 0
