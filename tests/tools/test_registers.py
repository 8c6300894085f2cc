"""Registers by name, in decoded lines and in what is sent."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from construct import Byte, Bytes, Int16ul, Struct

from aces_bus import Frame
from aces_bus.protocol import Protocol, Quantity
from aces_protocols.dynamixel.spec import dynamixel
from aces_protocols.feetech.spec import feetech
from aces_protocols.robotis.spec import control_table, robotis
from aces_tools.registers import RegisterNotes
from tests.tools.live import Opened

Aces = Callable[..., Any]
SESSION = "examples/captures/robotis_session.dxconf.txt"


def shown(aces: Aces, path: Path, data: bytes, protocol: str) -> list[str]:
    """The decoded lines of a half-duplex line."""
    path.write_bytes(data)
    found = aces("decode", path, "-p", protocol, "--direction", "both")
    assert found.status == 0
    return [line.split(maxsplit=2)[2] for line in found.out.splitlines()[1:]]


# ---------------------------------------------------------------------- decode


def test_what_is_read_and_written_has_names(aces: Aces, tmp_path: Path) -> None:
    """A request names its registers, its answer and a write give their values in the table's units."""
    status = robotis.encode("Status", id=1, error=0, parameters=b"\x00\x02\x36\x00")
    data = control_table.read(1, "present_position", "present_speed") + status
    data += control_table.write(1, {"torque_enable": "on"}) + robotis.encode(
        "Status", id=1, error=0, parameters=b""
    )
    data += control_table.sync_write("goal_position", {1: 150, 2: 75})
    lines = shown(aces, tmp_path / "line.bin", data, "robotis")
    assert lines[0].endswith("count=4  present_position…present_speed")
    assert lines[1].endswith("parameters=00 02 36 00  present_position=150.15 °  present_speed=5.994 rpm")
    assert lines[2].endswith("data=01  torque_enable=on")
    assert lines[3].endswith("error={}")
    assert lines[4].endswith("goal_position={1: 149.85 °, 2: 75.07 °}")


def test_a_register_has_the_unit_of_its_quantity() -> None:
    """A register that is declared as a quantity shows its unit as one that is declared with `unit=` does."""
    made = Protocol("sheet", link="can", source="drawn")
    made.message("Read", id=1, payload=Struct("start" / Byte, "count" / Byte))
    made.message("Write", id=2, payload=Struct("start" / Byte, "data" / Bytes(4)))
    table = made.registers(read="Read", write="Write")
    table.add("voltage", 0, Quantity(Int16ul, unit="V", scale=0.5))
    table.add("speed", 2, Int16ul, unit="rpm")
    (record,) = made.scanner().feed([Frame(2, bytes([0, 25, 0, 5, 0]))])
    notes = RegisterNotes([made.variant()])
    notes.see([record])
    shown = [(field.label, field.value, field.unit) for field in notes.of(record)]
    assert shown == [("voltage=", "12.5", " V"), ("speed=", "5", " rpm")]


def test_an_answer_of_another_length_has_no_names(aces: Aces, tmp_path: Path) -> None:
    """Nor has one whose request is not known, or that answers something else by then."""
    ask, ping = control_table.read(1, "present_position"), robotis.encode("Ping", id=1)
    status = {n: robotis.encode("Status", id=1, error=0, parameters=bytes(n)) for n in (0, 1, 2)}
    data = ask + status[1] + ping + status[0] + ask + ping + status[2]
    lines = shown(aces, tmp_path / "line.bin", data, "robotis")
    assert [line for line in lines if "present_position=" in line] == []


def test_each_of_several_answers_for_itself(aces: Aces, tmp_path: Path) -> None:
    """A SyncRead is answered by each servo, and a BulkRead with an area each."""
    position = dynamixel.register_map["present_position"]  # type: ignore[index]
    ask = dynamixel.encode("SyncRead", start=position.address, count=4, ids=[1, 2])
    status = [
        dynamixel.encode(
            "Status", id=n, error={"code": "none", "alert": 0}, parameters=position.encode(n * 90)
        )
        for n in (1, 2)
    ]
    areas = [{"id": 1, "start": position.address, "count": 4}, {"id": 2, "start": 65, "count": 1}]
    bulk = dynamixel.encode("BulkRead", areas=areas)
    led = dynamixel.encode("Status", id=2, error={"code": "none", "alert": 0}, parameters=b"\x01")
    lines = shown(aces, tmp_path / "line.bin", ask + b"".join(status) + bulk + status[0] + led, "dynamixel")
    assert [line.rpartition("  ")[2] for line in lines if "  present_position=" in line or "  led=" in line] == [
        "present_position=90.000 °", "present_position=180.000 °", "present_position=90.000 °", "led=on",
    ]  # fmt: skip


def test_filters_do_not_hide_what_was_asked(aces: Aces) -> None:
    """A request that is not shown names its answer all the same; of many registers the first are shown."""
    found = aces("decode", SESSION, "-p", "robotis", "--direction", "both", "-m", "status", "-n", "9")
    lines = [line for line in found.out.splitlines() if "parameters=" in line]
    assert "model_number=RX-28" in lines[0]
    assert lines[0].endswith("… and 24 more registers")


def test_where_tables_differ_nothing_is_guessed(aces: Aces, tmp_path: Path) -> None:
    """Feetech's tables have words in two byte orders: registers have a name, and no value; single bytes have both."""
    data = feetech.encode("Write", id=1, start=40, data=b"\x01")
    data += feetech.encode("Status", id=1, error=0, parameters=b"")
    data += feetech.encode("Read", id=1, start=56, count=2)
    data += feetech.encode("Status", id=1, error=0, parameters=b"\x00\x08")
    lines = shown(aces, tmp_path / "line.bin", data, "feetech")
    assert lines[0].endswith("torque_enable=on")
    assert lines[2].endswith("present_position")
    assert lines[3].endswith("parameters=00 08")


# ---------------------------------------------------------------------- send


@pytest.mark.parametrize(
    ("fields", "packet"),
    [
        ("Read id=1 start=present_position", control_table.read(1, "present_position")),
        ("Read id=1 start=present_position count=8", control_table.read(1, "present_position", "present_temperature")),
        ("Write id=1 goal_position=150", control_table.write(1, {"goal_position": 150})),
        ("Write id=2 moving_speed=20 goal_position=150", control_table.write(2, {"goal_position": 150, "moving_speed": 20})),
        ("RegWrite id=1 torque_enable=on", control_table.write(1, {"torque_enable": "on"}, message="RegWrite")),
        ("Write id=1 start=goal_position data=0002", bytes(robotis.encode("Write", id=1, start=30, data=b"\x00\x02"))),
    ],
)  # fmt: skip
def test_registers_are_sent_by_name(aces: Aces, fields: str, packet: bytes) -> None:
    """An address by its register's name, with its size; a value in the sheet's unit, as address and bytes."""
    found = aces("send", *fields.split(), "-p", "robotis")
    assert found.status == 0
    assert found.out.splitlines()[0] == f"line  {packet.hex(' ').upper()}"


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        ("Read id=1 start=present_positon", "did you mean 'present_position'?"),
        ("Write id=1 goal_positon=3", "did you mean 'goal_position'?"),
        ("Write id=1 present_position=3", "present_position can only be read"),
        ("Write id=1 goal_position=500", "500 ° is outside 0…300 °"),
        ("Write id=1 goal_position=5 torque_enable=on", "do not stand side by side"),
        ("Write id=1 goal_position=5 start=3", "say the same"),
    ],
)
def test_what_does_not_fit_is_refused(aces: Aces, fields: str, said: str) -> None:
    """Names that there are not, values out of range, registers that are only read, gaps."""
    found = aces("send", *fields.split(), "-p", "robotis")
    assert found.status == 2
    assert said in found.err


@pytest.mark.parametrize("field", ["goal_position=150", "operating_mode=0"])
def test_tables_that_differ_refuse_a_name(aces: Aces, field: str) -> None:
    """What would be other bytes for another kind of servo is not sent by name."""
    found = aces("send", "Write", "id=1", field, "-p", "feetech")
    assert found.status == 2
    assert "give start= and data=" in found.err


@pytest.mark.skipif(os.name != "posix", reason="pseudo-terminals")
def test_a_reply_has_names(aces: Aces, opened: Opened) -> None:
    """With --reply the answer shows the register that was asked for."""
    import tty

    far, near = os.openpty()
    tty.setraw(near)
    asked = control_table.read(1, "present_voltage")

    def work() -> None:
        received = b""
        while len(received) < len(asked):
            received += os.read(far, 64)
        os.write(far, bytes(robotis.encode("Status", id=1, error=0, parameters=b"\x76")))

    try:
        opened.then(work)
        port = ("--serial", os.ttyname(near), "--tx", "--reply", "20s")
        found = aces("send", "Read", "id=1", "start=present_voltage", "-p", "robotis", *port)
    finally:
        opened.join()
        os.close(far)
        os.close(near)
    assert found.out.rstrip().endswith("parameters=76  present_voltage=11.8 V")


@pytest.fixture
def opened(monkeypatch: pytest.MonkeyPatch) -> Any:
    made = Opened(monkeypatch)
    yield made
    made.join()
