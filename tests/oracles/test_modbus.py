"""pymodbus and minimalmodbus, through pseudo-terminals: their masters ask our twin, our driver asks pymodbus' server.

Real time: what is asserted is order and content; the limits are those of a machine that is twenty times slower.
"""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import Generator
from contextlib import contextmanager
from typing import Any

import pytest

from aces_bus import as_dict
from aces_bus.device import Robot
from aces_bus.errors import DeviceError
from aces_bus.hardware.ports import SerialPort
from aces_bus.robot import connect, parse_robot
from aces_protocols.modbus.spec import modbus
from tests.oracles.foreign import oracle
from tests.oracles.terminals import a_terminal, twins_at_a_terminal

pymodbus: Any = oracle("pymodbus", "pymodbus")
client: Any = oracle("pymodbus.client", "pymodbus")
server: Any = oracle("pymodbus.server", "pymodbus")
datastore: Any = oracle("pymodbus.datastore", "pymodbus")
pdu: Any = oracle("pymodbus.pdu", "pymodbus")

WAIT_S = 20.0
BAUD = 115_200
ROBOT = """
name = "bench"
[buses]
line = { link = "serial", protocol = "modbus", baud = 115_200 }

[devices.PLC]
driver = "modbus"
bus = "line"
credentials = { unit = 5 }

[devices.PLC.settings]
every_s = 0.05
timeout_s = 5.0
stop = { speed = 0 }

[devices.PLC.settings.registers]
voltage = { address = 0, type = "u16", table = "input", unit = "V", scale = 0.1 }
power = { address = 1, type = "float", table = "input", unit = "W" }
swapped = { address = 3, type = "u32", table = "input", words = "low first" }
speed = { address = 10, type = "s16", access = "read-write", unit = "rpm", lower = -3000, upper = 3000 }
goal = { address = 11, type = "float", access = "read-write", unit = "°C" }
count = { address = 13, type = "s32", access = "read-write" }
label = { address = 20, type = "text", count = 4, access = "read-write" }
lamp = { address = 2, type = "bit", table = "coil", access = "read-write" }
fan = { address = 3, type = "bit", table = "coil", access = "read-write" }
door = { address = 0, type = "bit", table = "input_bit" }
open = { address = 1, type = "bit", table = "input_bit" }
"""


def bench() -> Robot:
    robot, problems = parse_robot(ROBOT)
    assert robot is not None, problems
    return robot


def test_pymodbus_reads_and_writes_our_twin() -> None:
    """Each function that it has: the twin answers what it holds, refuses what it has not, and we read all that was said."""
    with twins_at_a_terminal(bench(), "line") as made:
        twin: Any = made.twins["PLC"]
        port, passed = made.port, made.passed
        master = client.ModbusSerialClient(port.path, baudrate=BAUD, timeout=WAIT_S, retries=0)
        convert, kind = master.convert_from_registers, master.DATATYPE
        with port.lock:
            for name, value in {"voltage": 230.1, "power": 12.5, "swapped": 0x00012345, "door": True}.items():
                twin.put(name, value)
        assert master.connect()
        try:
            answer = master.read_input_registers(0, count=5, device_id=5)
            assert answer.registers[0] == 2301
            assert convert(answer.registers[1:3], kind.FLOAT32) == 12.5
            assert convert(answer.registers[3:5], kind.UINT32, word_order="little") == 0x12345
            assert master.read_discrete_inputs(0, count=2, device_id=5).bits[:2] == [True, False]
            assert not master.write_register(10, 0xFFFF & -1500, device_id=5).isError()
            raw = master.convert_to_registers(21.25, kind.FLOAT32)
            assert not master.write_registers(11, [*raw, 0xFFFF, 0xFFFE], device_id=5).isError()
            assert not master.write_coil(2, True, device_id=5).isError()
            assert not master.write_coils(2, [False, True], device_id=5).isError()
            taken = {name: twin.take(name) for name in ("speed", "goal", "count", "lamp", "fan")}
            assert taken == {"speed": -1500, "goal": 21.25, "count": -2, "lamp": False, "fan": True}
            assert master.read_coils(2, count=2, device_id=5).bits[:2] == [False, True]
            assert not master.mask_write_register(
                address=10, and_mask=0x00FF, or_mask=0x1200, device_id=5
            ).isError()
            assert twin.take("speed") == 0x1224
            answer = master.readwrite_registers(
                read_address=10, read_count=1, write_address=13, values=[0, 7], device_id=5
            )
            assert (answer.registers, twin.take("count")) == ([0x1224], 7)
            refused = master.read_holding_registers(99, count=1, device_id=5)
            assert (refused.isError(), refused.exception_code) == (True, 2)
            assert master.write_registers(0, [1], device_id=5).exception_code == 2
            assert master.read_exception_status(device_id=5).status == 0
            assert not master.diag_query_data(b"\xa5\x37", device_id=5).isError()
            assert master.diag_read_bus_exception_error_count(device_id=5).message in (2, [2], b"\0\2")
            assert b"PLC" in master.report_device_id(device_id=5).identifier
            assert not master.write_registers(13, [1, 9], device_id=5).isError()  # a queue of one
            # pymodbus 3.16 counts two bytes too few for this answer of a serial line, and waits: its reading alone.
            queue = pdu.file_message.ReadFifoQueueResponse()
            queue.decode(twin._queue(b"\0\x0d"))
            assert queue.values == [9]
            told = master.read_device_information(read_code=1, object_id=0, device_id=5)
            assert told.information == {0: b"aces-bus", 1: b"PLC", 2: b"1.0"}
            assert master.read_device_information(read_code=4, object_id=7, device_id=5).exception_code == 2
            assert master.diag_change_ascii_input_delimeter(device_id=5).exception_code == 1
        finally:
            master.close()
    data = b"".join(passed)
    scanner = modbus.scanner(direction="both", include_unknown=True)
    records = [*scanner.feed(data), *scanner.close()]
    names = [type(one).__name__ for one in records]
    said = (
        "ReadRegisters Registers ReadBits Bits WriteRegister RegisterWritten WriteRegisters RegistersWritten"
    )
    said += " WriteBit BitWritten WriteBits BitsWritten ReadBits Bits MaskRegister RegisterMasked ExchangeRegisters"
    said += " Registers ReadRegisters Refusal WriteRegisters Refusal"
    assert names[:22] == said.split()
    first: Any = records[1]
    assert as_dict(first)["registers"][0] == 2301
    assert (first.start, first.count) == (0, 5)


def test_pymodbus_reads_our_packets_and_we_its() -> None:
    """Each request that it builds is read here as it was meant; each answer that we build it reads as we mean it."""
    from pymodbus.framer import FramerRTU  # type: ignore[import-untyped,unused-ignore]
    from pymodbus.pdu import DecodePDU  # type: ignore[import-untyped,unused-ignore]

    cases: list[tuple[bool, str, dict[str, Any], dict[str, Any]]] = [
        (True, "ReadRegisters", {"function": 4, "start": 7, "count": 125}, {"address": 7, "count": 125}),
        (
            True,
            "WriteRegister",
            {"start": 0xFFFF, "value": 0x8000},
            {"address": 0xFFFF, "registers": [0x8000]},
        ),
        (
            True,
            "WriteRegisters",
            {"start": 1, "count": 2, "registers": [1, 2]},
            {"address": 1, "registers": [1, 2]},
        ),
        (False, "UnaskedRegisters", {"function": 3, "registers": [9, 0xFFFF]}, {"registers": [9, 0xFFFF]}),
        (False, "RegistersWritten", {"start": 1, "count": 2}, {"address": 1, "count": 2}),
        (False, "Refusal", {"function": 3, "reason": "busy"}, {"exception_code": 6}),
    ]
    for is_server, message, fields, attributes in cases:
        packet = modbus.encode(message, unit=17, **fields)
        framer = FramerRTU(DecodePDU(is_server))
        used, unit, _, content = framer.decode(packet)
        assert (used, unit) == (len(packet), 17)
        found = DecodePDU(is_server).decode(content)
        assert {name: getattr(found, name) for name in attributes} == attributes, message
        again = framer.encode(content, 17, 0)
        direction: Any = "to device" if is_server else "from device"
        (record,) = modbus.scanner(direction=direction).feed(again)
        assert {name: value for name, value in as_dict(record).items() if name in fields} == fields


def test_minimalmodbus_reads_and_writes_our_twin() -> None:
    """A master of another hand: registers, floats, longs, texts, bits."""
    minimalmodbus: Any = oracle("minimalmodbus", "minimalmodbus")
    with twins_at_a_terminal(bench(), "line") as made:
        twin: Any = made.twins["PLC"]
        port = made.port
        instrument = minimalmodbus.Instrument(port.path, 5)
        instrument.serial.baudrate = BAUD
        instrument.serial.timeout = WAIT_S
        try:
            with port.lock:
                twin.put("voltage", 12.3)
                twin.put("power", -0.5)
            assert instrument.read_register(0, 1, functioncode=4) == 12.3
            assert instrument.read_float(1, functioncode=4) == -0.5
            instrument.write_register(10, -42, functioncode=6, signed=True)
            instrument.write_float(11, 3.5)
            instrument.write_long(13, -100_000, signed=True)
            instrument.write_string(20, "oven 7", 4)
            instrument.write_bit(3, 1)
            names = ("speed", "goal", "count", "label", "fan")
            assert [twin.take(name) for name in names] == [-42, 3.5, -100_000, "oven 7", True]
            assert instrument.read_register(10, functioncode=3, signed=True) == -42
            assert instrument.read_string(20, 4).startswith("oven 7")
            assert instrument.read_bits(2, 2, functioncode=1) == [0, 1]
        finally:
            instrument.serial.close()


@contextmanager
def a_server(path: str, holds: Any) -> Generator[None]:
    """pymodbus' server on this terminal, on a thread of its own."""
    loop = asyncio.new_event_loop()
    made: list[Any] = []
    ready = threading.Event()

    async def serve() -> None:
        made.append(
            server.ModbusSerialServer(holds, port=path, baudrate=BAUD, framer=pymodbus.FramerType.RTU)
        )
        task = asyncio.ensure_future(made[0].serve_forever())
        await asyncio.sleep(0)
        ready.set()
        await asyncio.gather(task, return_exceptions=True)

    thread = threading.Thread(target=lambda: loop.run_until_complete(serve()), daemon=True)
    thread.start()
    assert ready.wait(WAIT_S)
    try:
        yield
    finally:
        asyncio.run_coroutine_threadsafe(made[0].shutdown(), loop).result(WAIT_S)
        thread.join(WAIT_S)
        loop.close()


def until(condition: Any) -> None:
    """Wait until it is so."""
    end = time.monotonic() + WAIT_S
    while not condition():
        assert time.monotonic() < end, "it never came"
        time.sleep(0.01)


def test_our_driver_reads_and_writes_pymodbus_server() -> None:
    """What its datastore holds is what our signals say; what we set it holds; what it has not is refused by name."""
    block = datastore.ModbusSequentialDataBlock
    floats = client.ModbusSerialClient.convert_to_registers(12.5, client.ModbusSerialClient.DATATYPE.FLOAT32)
    inputs = block(1, [2301, *floats, 0x2345, 0x0001])
    holding = block(1, [0] * 30)
    coils, doors = block(1, [False] * 8), block(1, [True, False])
    context = datastore.ModbusDeviceContext(di=doors, co=coils, hr=holding, ir=inputs)
    robot = bench()
    holds = datastore.ModbusServerContext({5: context}, single=False)
    with a_terminal(robot, "line") as made, a_server(made.port.path, holds):
        port = made.port
        rig = connect(robot, {"line": SerialPort(made.line, name="line")}, rate_hz=20)
        device: Any = rig.devices["PLC"]

        def done(ticket: Any) -> Any:
            until(lambda: ticket.is_over)
            if ticket.error is not None:
                raise ticket.error
            return ticket.result

        def ask(method: Any, *values: Any) -> Any:
            with port.lock:
                started = method(*values)
            return done(started)

        try:
            with port.lock:
                rig.open()
            until(lambda: all(one.instant is not None for one in device.signals.values()))
            names = ("voltage", "power", "swapped", "door", "open")
            found = [device.signals[f"PLC.{name}"].last for name in names]
            assert found == [pytest.approx(230.1), 12.5, 0x12345, True, False]
            with port.lock:
                for name, value in {"speed": -1500, "goal": 21.25, "lamp": True, "label": "oven 7"}.items():
                    device.signals[f"PLC.{name}"].set(value)
            until(lambda: device.signals["PLC.label"].last == "oven 7" and device.signals["PLC.lamp"].last)
            assert (device.signals["PLC.speed"].last, device.signals["PLC.goal"].last) == (-1500, 21.25)
            assert ask(device.read, "speed") == -1500
            ask(device.stop_motion)
            assert ask(device.read, "speed") == 0
            with pytest.raises(DeviceError, match="refused: address"):
                ask(lambda: device.job("x", lambda job: refused(device)))
        finally:
            with port.lock:
                rig.close()


def refused(device: Any) -> Any:
    """Steps that read what is not there."""
    answer = yield device.ask(
        "ReadRegisters", reply=("Registers", "Refusal"), timeout_s=5.0, function=3, start=900, count=1
    )
    raise DeviceError(f"refused: {answer.reason}")
