"""mjbots' own Python library against our spec and our twin: its frames, its values, its transport over python-can."""

from __future__ import annotations

import asyncio
import json
import math
import shutil
import struct
import tempfile
import threading
import time
from collections.abc import Awaitable, Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from aces_bus import Frame
from aces_bus.frames import FD_LENGTHS
from aces_bus.hardware import CanGate
from aces_bus.hardware.ports import port_of
from aces_bus.hardware.served.channel import ServedChannel
from aces_bus.hardware.served.server import BusServer
from aces_bus.robot import parse_robot
from aces_bus.robot.rig import simulate
from aces_bus.runtime.loop import Loop
from aces_protocols.moteus.registers import BY_NAME, BY_NUMBER, TYPES
from aces_protocols.moteus.spec import moteus
from aces_protocols.moteus.subframes import register_values
from tests.oracles.foreign import oracle

peer = oracle("moteus", "moteus")
multiplex = oracle("moteus.multiplex", "moteus")
vendor = oracle("moteus.protocol", "moteus")
transports = oracle("moteus.transport", "moteus")
python_can = oracle("moteus.pythoncan_device", "moteus")
factory = oracle("moteus.transport_factory", "moteus")
tool = oracle("moteus.moteus_tool", "moteus")

#: A limit that a machine twenty times slower keeps, too.
PATIENCE_S = 60.0
RESOLUTIONS = {
    "i8": multiplex.INT8,
    "i16": multiplex.INT16,
    "i32": multiplex.INT32,
    "f32": multiplex.F32,
}
#: What `make_position` takes, by register.
LIMITS = {
    "position": "command_position",
    "velocity": "command_velocity",
    "feedforward_torque": "command_feedforward_torque",
    "kp_scale": "command_kp_scale",
    "kd_scale": "command_kd_scale",
    "maximum_torque": "command_position_max_torque",
    "stop_position": "command_stop_position",
    "watchdog_timeout": "command_timeout",
    "velocity_limit": "command_velocity_limit",
    "accel_limit": "command_accel_limit",
    "fixed_voltage_override": "command_fixed_voltage_override",
    "ilimit_scale": "command_ilimit_scale",
    "fixed_current_override": "command_fixed_current_override",
}


def frame_of(command: Any) -> Frame:
    """A command of the library as its transport sends it."""
    identifier = (0x8000 if command.reply_required else 0) | command.source << 8 | command.destination
    size = next(n for n in FD_LENGTHS if n >= len(command.data))
    data = bytes(command.data).ljust(size, b"\x50")
    return Frame(identifier, data, is_fd=True, is_extended_id=identifier > 0x7FF)


def decoded(frame: Frame) -> Any:
    (record,) = moteus.scanner().feed([frame])
    return record


def same(one: float, other: float, step: float = 0.0) -> bool:
    """Equal, NaN too; to within a step."""
    if math.isnan(one) or math.isnan(other):
        return math.isnan(one) and math.isnan(other)
    return math.isclose(one, other, rel_tol=1e-6, abs_tol=1.001 * step)


@pytest.mark.parametrize("kind", RESOLUTIONS)
def test_what_it_commands_we_read(kind: str) -> None:
    """Every limit of position mode in every resolution, NaN too: the values that were given, and its own reading of them."""

    class Resolution(peer.PositionResolution):  # type: ignore[misc,name-defined]
        pass

    for name in LIMITS:
        setattr(Resolution, name, RESOLUTIONS[kind])
    controller = peer.Controller(id=5, position_resolution=Resolution(), transport=object())
    for value in (0.0, 0.3, -0.7, 0.021, math.nan):
        given = {name: value if n % 2 else -value / 2 for n, name in enumerate(LIMITS)}
        frame = frame_of(controller.make_position(**given, query=False))
        record = decoded(frame)
        assert record.id == 5
        values = register_values(record.subframes)
        assert values.pop("mode") == "position"
        theirs = vendor.parse_registers(frame.data).command
        assert set(values) == set(LIMITS.values())
        for name, register in LIMITS.items():
            known = BY_NAME[register]
            assert same(values[register], given[name], known.step(kind) or 0.0), register
            if register != "command_fixed_current_override":  # which it does not scale: see the README
                assert same(values[register], theirs[known.number]), register
        assert moteus.encode("Command", id=5, subframes=plain(record)).data == frame.data


def test_what_it_asks_and_stops() -> None:
    """Its default query, its stop, the brake: the bytes are ours, too."""
    controller = peer.Controller(id=1, transport=object())
    query = decoded(frame_of(controller.make_query()))
    assert type(query).__name__ == "Query"
    reads = [(one.kind, list(one.data)) for one in query.subframes]
    assert reads == [
        ("read_i8", ["mode"]),
        ("read_f32", ["position", "velocity", "torque"]),
        ("read_i8", ["voltage", "temperature", "fault"]),
    ]
    for made, mode in ((controller.make_stop(), "stopped"), (controller.make_brake(), "brake")):
        assert register_values(decoded(frame_of(made)).subframes) == {"mode": mode}
    stop = moteus.encode("Command", id=1, subframes=[{"kind": "write_i8", "data": {"mode": "stopped"}}])
    assert stop.data == bytes(controller.make_stop().data)


@pytest.mark.parametrize("kind", RESOLUTIONS)
def test_what_we_answer_it_reads(kind: str) -> None:
    """Each register that it knows, in each type: what we build it reads as the value, NaN too."""
    for register in BY_NUMBER.values():
        for value in (0, 1, -1, 0.25, math.nan):
            if (not register.measure and value != value) or (not register.measure and value != round(value)):
                continue
            data = {register.name: value}
            frame = moteus.encode("Reply", id=1, subframes=[{"kind": f"reply_{kind}", "data": data}])
            (theirs,) = vendor.parse_reply(frame.data).values()
            (ours,) = register_values(decoded(frame).subframes).values()
            if isinstance(ours, str):
                assert register.names[int(theirs)] == ours
            elif is_scaled_by_it(register.number) or kind == "f32":
                assert same(float(theirs), float(ours)), register
            else:
                (raw,) = struct.unpack(TYPES[kind], frame.data[-struct.calcsize(TYPES[kind]) :])
                assert theirs == raw, (
                    f"{register.name}: the library has learnt to scale it; say so in the README"
                )


def is_scaled_by_it(number: int) -> bool:
    """Whether the library scales integers of this register; it leaves those that it does not list as they are."""
    return bool(vendor.scale_register(number, multiplex.INT16, 1000) != 1000) or not BY_NUMBER[number].measure


def plain(record: Any) -> list[dict[str, Any]]:
    """Sub-frames as they are given to `encode`."""
    found: list[dict[str, Any]] = []
    for one in record.subframes:
        data = one.data
        if hasattr(data, "__struct_fields__"):
            data = {name: getattr(data, name) for name in data.__struct_fields__}
        found.append({"kind": one.kind, "data": data, "reason": one.reason})
    return found


# ---------------------------------------------------------------------- its transport, over a served bus

ROBOT = """
name = "bench"
rate_hz = 20
[buses]
can = { link = "can", protocol = "moteus", bitrate = 1_000_000 }
[devices]
ONE = { driver = "moteus", bus = "can", credentials = { id = 1 } }
ELEVEN = { driver = "moteus", bus = "can", credentials = { id = 11 } }
[joints]
LEFT = { device = "ONE" }
RIGHT = { device = "ELEVEN", direction = -1 }
"""


class Bench:
    """Two twins on a served bus, and the library's own transport on it."""

    def __init__(self, address: str, loop: Loop, twins: Any) -> None:
        self.address, self._loop, self._twins = address, loop, twins

    def twin(self, name: str, do: Callable[[Any], Any]) -> Any:
        """Something of a twin, on its own thread."""
        return self._loop.call(partial(do, self._twins[name]))

    def run(self, steps: Callable[[Any], Awaitable[None]], patience_s: float = PATIENCE_S) -> None:
        """Let steps run with the library's transport, for at most `patience_s`."""

        async def inside() -> None:
            device = python_can.PythonCanDevice(interface="aces", channel=self.address, fd=True)
            with transports.Transport(device) as transport:
                await asyncio.wait_for(steps(transport), patience_s)

        asyncio.run(inside())


@pytest.fixture
def bench() -> Iterator[Bench]:
    folder = Path(tempfile.mkdtemp(prefix="aces"))
    channel = ServedChannel("can", bitrate=1_000_000, data_bitrate=5_000_000, fd=True)
    server = BusServer([channel], unix=str(folder / "can"), tcp=None, socketcand=None)
    serving = threading.Thread(target=server.serve, daemon=True)
    serving.start()
    robot, _ = parse_robot(ROBOT)
    assert robot is not None
    address = server.addresses["can"][0]
    try:
        with Loop("twins") as loop:
            gate = CanGate({"interface": "aces", "channel": address, "fd": True})
            with simulate(robot, {"can": port_of(gate, loop)}) as twins:
                yield Bench(address, loop, twins)
    finally:
        server.stop()
        serving.join(PATIENCE_S)
        shutil.rmtree(folder, ignore_errors=True)


@pytest.mark.parametrize(("number", "name"), [(1, "ONE"), (11, "ELEVEN")])
def test_its_transport_drives_our_twin(bench: Bench, number: int, name: str) -> None:
    """Query, position with all limits, stop: it reads what the twin is, and the twin does what it says."""

    async def steps(transport: Any) -> None:
        controller = peer.Controller(id=number, transport=transport)
        state = (await controller.query()).values
        assert state[peer.Register.MODE] == 0
        assert state[peer.Register.VOLTAGE] == bench.twin(name, lambda twin: twin.value_of("voltage"))
        assert state[peer.Register.FAULT] == 0
        limits = {
            "maximum_torque": 1.5,
            "velocity_limit": 50.0,
            "accel_limit": 5.0,
            "watchdog_timeout": math.nan,
        }
        state = (await controller.set_position(position=0.25, velocity=0.0, **limits, query=True)).values
        assert state[peer.Register.MODE] == 10
        command = bench.twin(name, lambda twin: dict(twin.command))
        assert command["command_position"] == 0.25
        assert command["command_velocity_limit"] == 50.0
        assert command["command_accel_limit"] == 5.0
        assert command["command_position_max_torque"] == 1.5
        assert math.isnan(command["command_timeout"])
        end = time.monotonic() + PATIENCE_S
        is_there = False
        while not is_there:  # and stands: it may pass its goal first
            values = (await controller.query()).values
            is_there = (
                abs(values[peer.Register.POSITION] - 0.25) <= 1e-3
                and abs(values[peer.Register.VELOCITY]) <= 1e-3
            )
            assert time.monotonic() < end
        asked = await controller.custom_query(
            {peer.Register.POSITION: multiplex.INT16, peer.Register.COMMAND_POSITION: multiplex.F32}
        )
        assert asked.values[peer.Register.POSITION] == pytest.approx(0.25, abs=2e-3)
        assert asked.values[peer.Register.COMMAND_POSITION] == 0.25
        state = (await controller.set_stop(query=True)).values
        assert state[peer.Register.MODE] == 0
        assert state[peer.Register.POSITION] == pytest.approx(0.25, abs=0.01)
        assert bench.twin(name, lambda twin: twin.mode) == "stopped"

    bench.run(steps)


def test_its_watchdog_is_the_twins(bench: Bench) -> None:
    """A command with a short watchdog ends in mode 11, and only its stop leads out of it."""

    async def steps(transport: Any) -> None:
        controller = peer.Controller(id=1, transport=transport)
        await controller.set_position(position=math.nan, velocity=0.1, watchdog_timeout=0.01, query=True)
        end = time.monotonic() + PATIENCE_S
        while (await controller.query()).values[peer.Register.MODE] != 11:
            assert time.monotonic() < end
        state = await controller.set_position(position=0.0, watchdog_timeout=math.nan, query=True)
        assert state.values[peer.Register.MODE] == 11
        assert (await controller.set_stop(query=True)).values[peer.Register.MODE] == 0

    bench.run(steps)


# ---------------------------------------------------------------------- moteus_tool


def run_tool(bench: Bench, monkeypatch: pytest.MonkeyPatch, *arguments: str) -> None:
    """Run moteus_tool's own `main` on the bench.

    It sends `tel stop` first and gives the answer 0.2 s to come and be thrown away, which is too short for a busy machine.
    """
    given = ["moteus_tool", "--can-iface", "aces", "--can-chan", bench.address, "--no-tel-stop", *arguments]
    monkeypatch.setattr("sys.argv", given)
    monkeypatch.setattr(factory, "GLOBAL_TRANSPORT", None)  # each run of the program makes its own
    tool.main()


def test_moteus_tool_shows_who_it_is(
    bench: Bench, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """`--info`: schemas and values in their binary form; `--read` of the servo's channel."""
    run_tool(bench, monkeypatch, "-t", "11", "--info")
    shown = json.loads(capsys.readouterr().out)
    assert shown["model"] == "100"
    assert shown["uuid"].endswith("-00000000000b")
    run_tool(bench, monkeypatch, "-t", "11", "--read", "servo_stats")
    stats = json.loads(capsys.readouterr().out)
    assert (stats["mode"], stats["fault"], stats["filt_bus_V"]) == (0, 0, 24.0)


def test_moteus_tool_finds_both_and_dumps_their_configuration(
    bench: Bench, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """`--dump-config` without a target discovers both twins; each value is the twin's."""
    run_tool(bench, monkeypatch, "--dump-config")
    one, eleven = capsys.readouterr().out.split("Target: ")[1:]
    for text, name in ((one, "ONE"), (eleven, "ELEVEN")):
        lines = [line.split() for line in text.splitlines()[1:] if line]
        configuration = bench.twin(name, lambda twin: dict(twin.configuration))
        assert [key for key, _ in lines] == list(configuration)
        assert all(same(float(value), configuration[key]) for key, value in lines)


def test_moteus_tool_restores_a_configuration(
    bench: Bench, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """`--restore-config` sets and saves what the twin has; what it has not is named."""
    file = tmp_path / "moteus.cfg"
    file.write_text("servo.max_current_A 12.5\nservo.pid_dq_hz 100\nservo.timeout_mode 15\n")
    run_tool(bench, monkeypatch, "-t", "1", "--restore-config", str(file))
    stored = bench.twin("ONE", lambda twin: dict(twin.stored))
    assert (stored["servo.max_current_A"], stored["servo.timeout_mode"]) == (12.5, 15)
    assert "servo.pid_dq_hz 100" in capsys.readouterr().out


def test_moteus_tool_sets_the_offset(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    """`--set-offset` and `--zero-offset` are where the joint is, and outlive power-off."""
    for arguments, position in ((("--set-offset", "0.25"), 0.25), (("--zero-offset",), 0.0)):
        bench.twin("ONE", lambda twin: twin.motor.place(twin.clock.now(), 2.0))
        run_tool(bench, monkeypatch, "-t", "1", *arguments)
        bench.twin("ONE", lambda twin: twin.reboot())
        assert bench.twin("ONE", lambda twin: twin.value_of("position")) == pytest.approx(position, abs=1e-6)


def test_moteus_tool_stops_it(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    """`--stop` ends position mode."""
    bench.twin("ONE", lambda twin: twin._write({"mode": "position", "command_timeout": math.nan}))
    assert bench.twin("ONE", lambda twin: twin.mode) == "position"
    run_tool(bench, monkeypatch, "-t", "1", "--stop")
    assert bench.twin("ONE", lambda twin: twin.mode) == "stopped"


@pytest.mark.slow
def test_its_cycle_has_both_controllers(bench: Bench) -> None:
    """A thousand cycles of two controllers: each has both replies, which often arrive in one packet."""

    async def steps(transport: Any) -> None:
        controllers = [peer.Controller(id=number, transport=transport) for number in (1, 11)]
        for _ in range(1000):
            asked = [controller.make_position(position=math.nan, query=True) for controller in controllers]
            replies = await asyncio.wait_for(
                transport.cycle(asked), PATIENCE_S
            )  # a busy machine needs minutes
            assert sorted(reply.id for reply in replies) == [1, 11]

    bench.run(steps, 1000 * PATIENCE_S)
