"""damiao-motor, unmodified, with our twin on a served bus; its bytes and ours; where it is wrong."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from aces_bus import Frame
from aces_devices.damiao.twin import DamiaoTwin
from aces_protocols.damiao.spec import MODELS, REGISTERS, damiao
from tests.oracles.foreign import oracle
from tests.oracles.served import ServedTwins, served, wait_until

theirs = oracle("damiao_motor", "damiao-motor")

ROBOT = """
name = "arm"
[buses]
arm = { link = "can", protocol = "damiao", bitrate = 1_000_000 }
[devices]
DM1 = { driver = "damiao", bus = "arm", credentials = { motor = 1 }, model = "4340", settings = { master = 0x11 } }
DM2 = { driver = "damiao", bus = "arm", credentials = { motor = 2 }, model = "4310", settings = { master = 0x12 } }
"""


@pytest.fixture
def arm() -> Iterator[ServedTwins]:
    with served(ROBOT) as made:
        yield made


def test_it_drives_our_twin(arm: ServedTwins) -> None:
    """It reads the registers that the twin has, switches it on, moves it by stiffness, and reads where the twin is."""
    controller = theirs.DaMiaoController(channel=arm.channel, bustype="aces")
    try:
        motor = controller.add_motor(1, 0x11, "4340")
        twin = arm.twins["DM1"]
        assert isinstance(twin, DamiaoTwin)
        for name in ("position_max", "velocity_max", "torque_max", "can_id", "baud_code"):
            number = REGISTERS[name]
            assert motor.get_register(number, timeout=30.0) == pytest.approx(twin.registers[number])
        motor.ensure_control_mode("MIT")
        motor.enable()
        wait_until(lambda: motor.get_states().get("status") == "ENABLED")

        def is_there() -> bool:
            motor.send_cmd_mit(target_position=0.5, stiffness=60.0, damping=2.0)
            state = motor.get_states()
            return bool(abs(state["pos"] - 0.5) < 0.02 and abs(state["vel"]) < 0.02)

        wait_until(is_there)
        assert arm.call(lambda: twin.angle) == pytest.approx(0.5, abs=0.05)
        motor.disable()
        wait_until(lambda: motor.get_states()["status"] == "DISABLED")
        wait_until(lambda: arm.call(lambda: twin.status) == "disabled")
    finally:
        controller.shutdown()
    records = damiao.scanner(dialect="4340").feed(arm.frames())
    names = [type(one).__name__ for one in records]
    for name in (
        "ReadFloat",
        "ReadFloatReply",
        "ReadInteger",
        "ReadIntegerReply",
        "Enable",
        "Feedback",
        "Command",
        "Disable",
    ):
        assert name in names
    command = next(one for one in records if type(one).__name__ == "Command")
    assert command.position == pytest.approx(0.5, abs=25 / 65535)
    assert command.kp == pytest.approx(60, abs=500 / 4095)


@given(
    st.sampled_from(sorted(MODELS)),
    st.tuples(*[st.floats(-1, 1)] * 3),
    st.floats(0, 500),
    st.floats(0, 5),
)
def test_its_commands_and_ours_are_a_count_apart_at_most(
    model: str, shares: tuple[float, float, float], kp: float, kd: float
) -> None:
    """It truncates, we round to the nearest."""
    motor: Any = theirs.DaMiaoMotor(1, 0x11, None, motor_type=model)
    p, v, t = (share * limit for share, limit in zip(shares, MODELS[model], strict=True))
    data = int.from_bytes(motor.encode_cmd_msg(p, v, t, kp, kd), "big")
    frame = damiao.encode(
        "Command", motor=1, position=shares[0], velocity=shares[1], torque=shares[2], kp=kp, kd=kd
    )
    ours = int.from_bytes(frame.data, "big")
    for shift, width in ((48, 16), (36, 12), (24, 12), (12, 12), (0, 12)):
        mask = (1 << width) - 1
        assert abs((data >> shift & mask) - (ours >> shift & mask)) <= 1


@given(
    st.integers(0, 15),
    st.integers(0, 65535),
    st.tuples(*[st.integers(0, 4095)] * 2),
    st.binary(min_size=2, max_size=2),
)
def test_it_reads_a_feedback_as_we_do(
    status: int, position: int, rest: tuple[int, int], temperatures: bytes
) -> None:
    """Ranges of the model, status, temperatures."""
    packed = (position << 24 | rest[0] << 12 | rest[1]).to_bytes(5, "big")
    data = bytes((status << 4 | 1,)) + packed + temperatures
    motor: Any = theirs.DaMiaoMotor(1, 0x11, None, motor_type="4310")
    told = motor.decode_sensor_feedback(data)
    (ours,) = damiao.scanner(dialect="4310").feed([Frame(0x11, data)])
    assert told["pos"] == pytest.approx(ours.position, abs=1e-9)
    assert told["vel"] == pytest.approx(ours.velocity, abs=1e-9)
    assert told["torq"] == pytest.approx(ours.torque, abs=1e-9)
    assert (told["t_mos"], told["t_rotor"]) == (ours.mos_temperature, ours.rotor_temperature)
    if isinstance(ours.status, str):
        assert told["status_code"] == status


def test_where_it_is_wrong() -> None:
    """What acknowledges a write it takes for a feedback that says "off", and switches the motor on with its next command."""
    sent: list[bytes] = []

    class Bus:
        def send(self, message: Any) -> None:
            sent.append(bytes(message.data))

    motor: Any = theirs.DaMiaoMotor(1, 0x11, Bus(), motor_type="4340")
    motor.process_feedback_frame(
        bytes.fromhex("01 00 55 0A 02 00 00 00")
    )  # write control_mode 2, acknowledged
    assert motor.get_states()["status"] == "DISABLED"
    motor.send_cmd_mit()
    assert sent[0] == bytes.fromhex("FFFFFFFFFFFFFFFC")
