"""Foreign programs, unmodified, each in a short test with the fixture `aces_twin`: what a user of aces-bus would write.

1. A test compares what the program says with the twin's own state, so that it holds whatever that state is, and commands
   values by `aces_twin.value`: so it can be run with `--aces-faults all`.
2. `without` and `survives` of the marker are the program's own assumptions, found by running it under all faults.
"""

from __future__ import annotations

import asyncio
import struct
import time
from collections.abc import Callable
from contextlib import ExitStack, closing
from typing import Any

import pytest

from tests.oracles.foreign import oracle
from tests.oracles.pyvesc import pyvesc_module

pytest.importorskip("aces_lab")

#: How long programs without a time-out of their own wait (s).
PATIENCE_S = 3.0


def wait(is_so: Callable[[], Any], within_s: float = PATIENCE_S) -> None:
    """Wait until something is so, or raise `TimeoutError`."""
    end = time.monotonic() + within_s
    while not is_so():
        if time.monotonic() > end:
            raise TimeoutError("it does not become so")
        time.sleep(0.002)


def good(kit: Any, value: Any, result: int, error: int) -> Any:
    """Return what a servo kit has read; raise what it says of a failure, as a program does."""
    if result:
        raise ConnectionError(kit.getTxRxResult(result))
    assert error == 0
    return value


def test_moteus(aces_twin: Any) -> None:
    """mjbots' library: query, position and stop over its python-can transport."""
    moteus = oracle("moteus", "moteus")
    motor = aces_twin("moteus", id=1)

    async def steps() -> None:
        transport = moteus.Transport(moteus.PythonCanDevice(**motor.bus_options))
        with transport:
            controller = moteus.Controller(id=1, transport=transport)
            state = await asyncio.wait_for(controller.query(), PATIENCE_S)
            assert state.values[moteus.Register.POSITION] == pytest.approx(
                motor.state.value_of("position"), abs=1e-3
            )
            goal = aces_twin.value(0.25, -100.0, 100.0)
            await controller.set_position(position=goal, watchdog_timeout=1.0)
            motor.expect("Command")
            assert motor.state.command["command_position"] == pytest.approx(goal, abs=1e-3)
            await controller.set_stop()
            assert motor.state.mode == "stopped"

    asyncio.run(steps())


@pytest.mark.aces_faults(survives=["noise", "twice", "stale"], without=["overdue"])
def test_dynamixel_sdk(aces_twin: Any) -> None:
    """ROBOTIS' kit: ping, a register that is measured, one that is set, two servos asked at once."""
    sdk = oracle("dynamixel_sdk", "dynamixel-sdk")
    arm = aces_twin("dynamixel", ids=[1, 2], model="XL430-W250")
    port, kit = sdk.PortHandler(arm.port), sdk.PacketHandler(2.0)
    port.baudrate = arm.baud
    assert port.openPort()

    with closing(port.ser):
        model = good(kit, *kit.ping(port, 1))
        assert model == arm["DYNAMIXEL1"]["model_number"]
        for number, name in ((1, "DYNAMIXEL1"), (2, "DYNAMIXEL2")):
            assert good(kit, *kit.read4ByteTxRx(port, number, 132)) == round(arm[name].motion.at)
        goal = aces_twin.value(2100, 0, 4095)
        good(kit, None, *kit.write4ByteTxRx(port, 2, 116, goal))
        assert arm["DYNAMIXEL2"]["goal_position"] == goal
        assert good(kit, *kit.read4ByteTxRx(port, 2, 116)) == goal
        group = sdk.GroupSyncRead(port, kit, 116, 4)
        assert group.addParam(1)
        assert group.addParam(2)
        good(kit, None, group.txRxPacket(), 0)
        goals = [arm[name]["goal_position"] for name in ("DYNAMIXEL1", "DYNAMIXEL2")]
        assert [group.getData(number, 116, 4) for number in (1, 2)] == goals


def test_feetech_servo_sdk(aces_twin: Any) -> None:
    """Feetech's kit: ping, read, write."""
    sdk = oracle("scservo_sdk", "feetech-servo-sdk")
    arm = aces_twin("feetech", ids=[1, 2], model="STS3215")
    port, kit = sdk.PortHandler(arm.port), sdk.PacketHandler(0)
    assert port.openPort()
    with closing(port.ser):
        assert good(kit, *kit.ping(port, 1)) == 777
        assert good(kit, *kit.read2ByteTxRx(port, 2, 56)) == round(arm["FEETECH2"].motion.at)
        goal = aces_twin.value(1500, 0, 4095)
        good(kit, None, *kit.write2ByteTxRx(port, 1, 42, goal))
        assert arm["FEETECH1"]["goal_position"] == goal


@pytest.mark.filterwarnings("ignore:isSet:DeprecationWarning")
def test_pyvesc(aces_twin: Any) -> None:
    """PyVESC: version, what is measured, a duty cycle."""
    pyvesc = pyvesc_module()
    vesc = aces_twin("vesc_uart")
    with pyvesc.VESC(vesc.port, start_heartbeat=False, timeout=2.0) as motor:
        assert motor.get_firmware_version().startswith("6.5.")
        assert motor.get_measurements().temp_fet == pytest.approx(vesc.state.model.warm, abs=0.1)
        duty = aces_twin.value(0.25, -0.9, 0.9)
        motor.set_duty_cycle(duty)
        vesc.expect("SetDuty", duty=duty)


def test_canopen(aces_twin: Any) -> None:
    """canopen: NMT, SDO up and down, the identity."""
    canopen = oracle("canopen", "canopen")
    io = aces_twin("cia401", node=9)
    network = canopen.Network()
    network.connect(**io.bus_options)
    try:
        node = network.add_node(9, canopen.ObjectDictionary())
        node.sdo.RESPONSE_TIMEOUT = 1.0
        assert struct.unpack("<I", node.sdo.upload(0x1000, 0))[0] & 0xFFFF == 401
        node.sdo.download(0x6200, 1, bytes([aces_twin.value(0b101, 0, 255)]))
        assert node.sdo.upload(0x6200, 1)[0] == io.state.numbers[0x6200, 1]
        node.nmt.send_command(1)
    finally:
        network.disconnect()


METER = {
    "registers": {
        "voltage": {"address": 0, "type": "u16", "table": "input"},
        "speed": {"address": 10, "type": "s16", "access": "read-write"},
        "power": {"address": 12, "type": "float", "access": "read-write"},
        "count": {"address": 14, "type": "s32", "access": "read-write"},
        "lamp": {"address": 2, "type": "bit", "table": "coil", "access": "read-write"},
    }
}


@pytest.mark.aces_faults(survives=["loses", "garbled", "twice", "stale"], without=["reboot"])
def test_pymodbus(aces_twin: Any) -> None:
    """pymodbus' master: input and holding registers, a float, a coil."""
    client = oracle("pymodbus.client", "pymodbus")
    plc = aces_twin("modbus", unit=5, settings=METER)
    master = client.ModbusSerialClient(plc.port, baudrate=plc.baud, timeout=0.2, retries=2)
    with closing(master):
        assert master.connect()
        answer = master.read_input_registers(0, count=1, device_id=5)
        assert answer.registers == [plc.state.take("voltage")]
        raw = master.read_holding_registers(12, count=2, device_id=5).registers
        assert master.convert_from_registers(raw, master.DATATYPE.FLOAT32) == pytest.approx(
            plc.state.take("power")
        )
        speed = aces_twin.value(-1500, -32768, 32767)
        assert not master.write_register(10, speed & 0xFFFF, device_id=5).isError()
        assert plc.state.take("speed") == speed
        assert not master.write_coil(2, True, device_id=5).isError()
        assert master.read_coils(2, count=1, device_id=5).bits[0] is plc.state.take("lamp") is True


def test_minimalmodbus(aces_twin: Any) -> None:
    """minimalmodbus: a register, a signed one, a float, a long."""
    minimalmodbus = oracle("minimalmodbus", "minimalmodbus")
    plc = aces_twin("modbus", unit=5, settings=METER)
    master = minimalmodbus.Instrument(plc.port, 5)
    master.serial.baudrate, master.serial.timeout = plc.baud, 0.2
    with closing(master.serial):
        assert master.read_register(0, functioncode=4) == plc.state.take("voltage")
        assert master.read_register(10, signed=True) == plc.state.take("speed")
        assert master.read_float(12) == pytest.approx(plc.state.take("power"))
        count = aces_twin.value(-100_000, -(1 << 31), (1 << 31) - 1)
        master.write_long(14, count, signed=True)
        assert plc.state.take("count") == count


def test_pyubx2(aces_twin: Any) -> None:
    """pyubx2 on a serial port: a solution as it comes, and a version that it asks for."""
    pyubx2, serial = oracle("pyubx2", "pyubx2"), oracle("serial", "pyserial")
    receiver = aces_twin("ubx")
    with serial.Serial(receiver.port, receiver.baud, timeout=0.5) as port:
        reader = pyubx2.UBXReader(port, protfilter=pyubx2.UBX_PROTOCOL)

        def asked(group: str, name: str) -> Any:
            port.write(pyubx2.UBXMessage(group, name, pyubx2.POLL).serialize())
            for _ in range(5):
                if (parsed := reader.read()[1]) is not None and parsed.identity == name:
                    return parsed
            raise TimeoutError(f"no {name} came")

        assert asked("MON", "MON-VER").hwVersion.startswith(b"00190000")
        solution = asked("NAV", "NAV-PVT")
        sent = [one.record for one in receiver.frames if getattr(one.record, "itow", None) == solution.iTOW]
        assert any(solution.lat == pytest.approx(record.lat, abs=1e-7) for record in sent)


def test_damiao_motor(aces_twin: Any) -> None:
    """damiao-motor: registers, switching on, where the motor is, a command."""
    damiao = oracle("damiao_motor", "damiao-motor")
    twin = aces_twin("damiao", motors=[1, 2], model="4340", dialect="4340", settings={"master": 0x11})
    controller = damiao.DaMiaoController(channel=twin.channel, bustype="aces")
    with ExitStack() as stack:
        stack.callback(controller.shutdown)
        motor = controller.add_motor(1, 0x11, "4340")
        state = twin["DAMIAO1"]
        for number in (21, 22, 7, 8):
            assert motor.get_register(number, timeout=PATIENCE_S) == pytest.approx(state.registers[number])
        motor.enable()
        wait(lambda: motor.get_states().get("status") == "ENABLED")
        assert motor.get_states()["pos"] == pytest.approx(state.angle, abs=0.01)
        assert motor.get_states()["t_rotor"] == pytest.approx(state.motor.temperature, abs=1.0)
        goal, stiff = aces_twin.value(0.5, -12.0, 12.0), aces_twin.value(10.0, 0.0, 400.0)
        motor.send_cmd_mit(target_position=goal, stiffness=stiff, damping=1.0)
        command = twin.expect("Command", motor=1)
        assert (command.position, command.kp) == (
            pytest.approx(goal, abs=0.001),
            pytest.approx(stiff, abs=0.2),
        )


@pytest.mark.aces_faults(
    without=["others", "stale", "short"]
)  # it takes what comes next for its answer, whole
def test_robstride(aces_twin: Any) -> None:
    """robstride: parameters, switching on and off, the position in two ways."""
    robstride = oracle("robstride", "robstride")
    leg = aces_twin("robstride", motors=[1, 2], model="RS02", dialect="RS02")
    client = robstride.Client(leg.bus, recv_timeout=1.0)
    state = leg["ROBSTRIDE1"]
    assert client.read_param(1, "mechvel") == pytest.approx(0.0, abs=1e-4)
    assert client.read_param(1, "mechpos") == pytest.approx(state.angle, abs=1e-4)
    client.write_param(1, "run_mode", robstride.RunMode.Position)
    assert client.read_param(1, "run_mode") == robstride.RunMode.Position
    limit = aces_twin.value(2.5, 0.0, 40.0)
    client.write_param(1, "limit_spd", limit)
    assert client.read_param(1, "limit_spd") == pytest.approx(limit)
    answer = client.enable(1)
    assert answer.angle == pytest.approx(state.angle, abs=0.001)
    assert answer.temp == pytest.approx(state.motor.temperature, abs=0.5)
    assert client.disable(1).servo_id == 1


def test_udsoncan(aces_twin: Any) -> None:
    """udsoncan over can-isotp: a number, a text of several frames."""
    isotp, udsoncan = oracle("isotp", "can-isotp"), oracle("udsoncan", "udsoncan")
    from udsoncan.client import Client
    from udsoncan.connections import PythonIsoTpConnection

    values = {
        "limit": {"identifier": 0x0110, "type": "u16"},
        "name": {"identifier": 0x0111, "type": "text", "count": 30},
    }
    ecu = aces_twin("uds", ecu=0, settings={"identifiers": values})
    ecu.state.put("name", "a text that takes some frames.")
    address = isotp.Address(isotp.AddressingMode.Normal_11bits, txid=0x7E0, rxid=0x7E8)
    stack = isotp.CanStack(ecu.bus, address=address, params={"stmin": 0, "blocksize": 4, "tx_padding": 0xAA})
    codecs = {0x0110: ">H", 0x0111: udsoncan.AsciiCodec(30)}
    config: Any = {**udsoncan.configs.default_client_config, "data_identifiers": codecs, "request_timeout": 2}
    with Client(PythonIsoTpConnection(stack), config=config) as opened:
        client: Any = opened
        read = client.read_data_by_identifier([0x0110, 0x0111]).service_data.values
        assert read[0x0110] == (ecu.state.take("limit"),)
        assert read[0x0111] == "a text that takes some frames."


@pytest.fixture(autouse=True)
def patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Give kits whose patience is 34 ms some more: a busy machine takes longer."""
    for module in ("dynamixel_sdk.port_handler", "scservo_sdk.port_handler"):
        monkeypatch.setattr(oracle(module, "aces-bus[oracles]"), "LATENCY_TIMER", 100)
