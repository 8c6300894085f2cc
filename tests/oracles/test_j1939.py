"""can-j1939, unmodified, on our virtual bus: broadcasts and packets to one address, both ways.

Its times are real ones: what is asserted is order and content, with limits that a slow machine keeps.
"""

from __future__ import annotations

import queue
from collections.abc import Callable, Generator, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any

import can
import pytest

from aces_bus import Frame
from aces_bus.device import PacketSender
from aces_bus.errors import CallerError, DeviceError, NoReplyError
from aces_bus.frames import message_to_frame
from aces_bus.hardware import CanGate
from aces_bus.hardware.ports import port_of
from aces_bus.robot import connect
from aces_bus.robot.rig import simulate
from aces_bus.runtime.loop import Loop
from aces_tools.main import main
from tests.device.crane import LOAD as CRANES
from tests.device.crane import TOOL, A, B, robot_of_cranes
from tests.device.truck import FAULTS, LOAD, robot_of_unit
from tests.oracles.foreign import oracle
from tests.oracles.served import wait_until
from tests.specs.j1939_long import j1939_long

j1939 = oracle("j1939", "can-j1939")
#: Addresses of can-j1939's two units, and ours.
ONE, OTHER, OURS = 0x50, 0x20, 0xF8
#: An address that neither has.
NOBODY = 0x30
#: Seconds that a slow machine has.
PATIENCE_S = 30.0
CHANNEL: dict[str, Any] = {"interface": "aces", "channel": "truck", "physics": False}


class Unit:
    """A control unit of can-j1939 with an address, and what it has received."""

    def __init__(self, address: int, **settings: Any) -> None:
        self.unit = j1939.ElectronicControlUnit(**settings)
        self.unit.connect(**CHANNEL)
        self.received: queue.Queue[tuple[Any, ...]] = queue.Queue()
        self.unit.subscribe(self._take, address)

    def _take(self, priority: int, group: int, source: int, timestamp: float, data: Any) -> None:
        self.received.put((group, source, bytes(data)))

    def close(self) -> None:
        self.unit.stop()
        self.unit.disconnect()


@pytest.fixture(scope="module")
def running() -> Iterator[tuple[Unit, Unit]]:
    """Two units; the other one takes three frames at once. Each takes a second to end."""
    both = Unit(ONE, max_cmdt_packets=255), Unit(OTHER, max_cmdt_packets=3)
    yield both
    with ThreadPoolExecutor() as pool:
        list(pool.map(Unit.close, both))


@pytest.fixture
def units(running: tuple[Unit, Unit]) -> tuple[Unit, Unit]:
    """The units, with nothing received so far."""
    for one in running:
        one.received = queue.Queue()
    return running


@pytest.fixture
def bus() -> Iterator[can.BusABC]:
    with can.Bus(**CHANNEL) as ours:
        yield ours


def text(size: int) -> bytes:
    return bytes((11 * place + size) & 0xFF for place in range(size))


def say(unit: Unit, *packet: Any) -> None:
    """Have a unit send a packet: as soon as the one before is over for it, which its own thread finds."""
    wait_until(lambda: unit.unit.send_pgn(*packet))


def records_until(bus: can.BusABC, count: int) -> tuple[list[Any], Any]:
    """The first `count` records of what comes, with all that is lost, and the counts."""
    scanner = j1939_long.scanner(include_unknown=True)
    found: list[Any] = []
    while sum(not hasattr(one, "reason") for one in found) < count:
        message = bus.recv(PATIENCE_S)
        assert message is not None, found
        found += scanner.feed([message_to_frame(message)])
    return found, scanner.counts


def test_a_broadcast_is_read(units: tuple[Unit, Unit], bus: can.BusABC) -> None:
    """BAM: our record has its bytes; another unit of its own reads the same."""
    data = text(18)
    say(units[0], 0, 0xFE, 0xEC, 6, ONE, list(data))
    (record,), counts = records_until(bus, 1)
    assert (type(record).__name__, record.source, record.number) == ("VehicleIdentification", ONE, data)
    assert (counts.decoded, counts.records) == (4, 1)
    assert units[1].received.get(timeout=PATIENCE_S) == (0xFEEC, ONE, data)


@pytest.mark.parametrize("size", [9, 14, 1785])
def test_a_packet_to_one_address_is_read(units: tuple[Unit, Unit], bus: can.BusABC, size: int) -> None:
    """RTS/CTS between two of its units: we read the packet, and count what steers it."""
    data = text(size)
    say(units[0], 0, 0xEF, OTHER, 6, ONE, list(data))
    found, counts = records_until(bus, 1)
    record = found[-1]
    assert (type(record).__name__, record.source, record.destination, record.data) == (
        "Proprietary",
        ONE,
        OTHER,
        data,
    )
    assert {one.reason for one in found[:-1]} == {"control: clear to send"}
    frames = -(-size // 7)
    assert (counts.decoded, counts.malformed, counts.pending) == (frames + 1, 0, 0)
    assert counts.control >= -(-frames // 3)
    assert units[1].received.get(timeout=PATIENCE_S) == (0xEF00, ONE, data)


def test_packets_of_several_senders_at_once(units: tuple[Unit, Unit], bus: can.BusABC) -> None:
    """Both units send to each other and to all at the same time: four packets, each whole."""
    for (unit, address), other in (((units[0], ONE), OTHER), ((units[1], OTHER), ONE)):
        say(unit, 0, 0xFE, 0xEC, 6, address, list(text(20 + address)))
        say(unit, 0, 0xEF, other, 6, address, list(text(30 + address)))
    found, counts = records_until(bus, 4)
    records = [one for one in found if not hasattr(one, "reason")]
    assert {getattr(one, "data", None) or one.number for one in records} == {
        text(size + address) for size in (20, 30) for address in (ONE, OTHER)
    }
    assert counts.malformed == 0
    for unit in units:
        assert len([unit.received.get(timeout=PATIENCE_S) for _ in range(2)]) == 2


@pytest.mark.parametrize("size", [9, 1785])
def test_a_packet_of_ours_is_received(units: tuple[Unit, Unit], size: int) -> None:
    """Through our gate, with the handshake: `send` comes back when the receiver has acknowledged."""
    data = text(size)
    frames = j1939_long.encode("Proprietary", priority=6, source=OURS, destination=OTHER, data=data)
    with CanGate(CHANNEL) as gate, PacketSender(gate, [j1939_long.variant()]) as sender:
        sender.send(frames)
        assert gate.counters.sent + gate.waiting >= 1 + -(-size // 7)
    assert units[1].received.get(timeout=PATIENCE_S) == (0xEF00, OURS, data)


def test_a_broadcast_and_a_frame_of_ours_are_received(units: tuple[Unit, Unit]) -> None:
    """Both units have what was said to all."""
    with CanGate(CHANNEL) as gate, PacketSender(gate, [j1939_long.variant()]) as sender:
        for size in (8, 17):
            sender.send(
                j1939_long.encode("VehicleIdentification", priority=6, source=OURS, number=text(size))
            )
    for unit in units:
        got = [unit.received.get(timeout=PATIENCE_S) for _ in range(2)]
        assert got == [(0xFEEC, OURS, text(8)), (0xFEEC, OURS, text(17))]


def test_a_broadcast_of_a_twin_is_received(units: tuple[Unit, Unit]) -> None:
    """It keeps the pauses by itself, on the clock of its loop."""
    with Loop("twins") as loop:
        port = port_of(CanGate(CHANNEL), loop)
        with simulate(robot_of_unit(), {"line": port}, load=LOAD):
            got = [unit.received.get(timeout=PATIENCE_S) for unit in units]
    frames = [message_to_frame(frame) for frame in j1939_long.encode("ActiveFaults", source=0x10, **FAULTS)]
    assert got == [(0xFECA, 0x10, b"".join(frame.data[1:] for frame in frames[1:])[:18])] * 2


@pytest.mark.parametrize("destination", [OTHER, 0xFF])
def test_aces_send_keeps_the_handshake(units: tuple[Unit, Unit], destination: int) -> None:
    """`aces send` sends a packet as its transport wants it: with the handshake, or with pauses."""
    what = [
        "Proprietary",
        "priority=6",
        f"source={OURS}",
        f"destination={destination}",
        f"data=hex:{text(20).hex()}",
    ]
    where = ["-i", "aces", "-c", "truck", "--bus-kwargs", "physics=False"]
    assert main(["send", *what, "-p", "tests/specs/j1939_long.py", *where, "--tx"]) == 0
    assert units[1].received.get(timeout=PATIENCE_S) == (0xEF00, OURS, text(20))


def test_what_fails_is_said() -> None:
    """Nobody answers; frames that are not a packet."""
    frames = j1939_long.encode("Proprietary", priority=6, source=OURS, destination=NOBODY, data=text(20))
    with CanGate(CHANNEL) as gate, PacketSender(gate, [j1939_long.variant()]) as sender:
        with pytest.raises(NoReplyError, match="its receiver gave no go-ahead in time"):
            sender.send(frames)
        parts: list[list[Any]] = [frames[1:], frames[2:3], []]
        for part in parts:
            with pytest.raises(CallerError, match="give all frames that encode gave"):
                sender.send(part)


# ---------------------------------------------------------------------- our devices and twins

SIZES = [9, 14, 15, 223, 1785]


class LossyPort:
    """A port that loses what `is_lost` says, in both directions."""

    def __init__(self, port: Any, is_lost: Callable[[Frame], bool]) -> None:
        self.port, self.is_lost = port, is_lost

    def __getattr__(self, name: str) -> Any:
        return getattr(self.port, name)

    def open(self, received: Callable[[Frame, int], Any]) -> None:
        """Hand over what is not lost."""
        self.port.open(lambda frame, instant: None if self.is_lost(frame) else received(frame, instant))

    def send(self, frame: Frame, age_ns: int = 0, *, report: Any = None, **how: Any) -> bool:
        """What is lost has left all the same."""
        if not self.is_lost(frame):
            return bool(self.port.send(frame, age_ns, report=report, **how))
        if report is not None:
            report("sent", "")
        return True


class Once:
    """Loses the first data frame of a number."""

    def __init__(self, number: int) -> None:
        self.number, self.is_over = number, False

    def __call__(self, frame: Frame) -> bool:
        is_it = frame.arbitration_id >> 16 & 0xFF == 0xEB and frame.data[0] == self.number
        is_lost, self.is_over = is_it and not self.is_over, self.is_over or is_it
        return is_lost


def never(frame: Frame) -> bool:
    return False


@contextmanager
def cranes(make: Callable[..., Any], is_lost: Callable[[Frame], bool] = never) -> Generator[Any]:
    """Our twins (`simulate`), or their devices (`connect`), on the bus in life."""
    with Loop("cranes") as loop:
        port = LossyPort(port_of(CanGate(CHANNEL, name="cranes"), loop), is_lost)
        with make(robot_of_cranes(), {"line": port}, load=CRANES) as made:
            yield made


@contextmanager
def unit_of(address: int, most: int) -> Generator[Unit]:
    """A unit of can-j1939 that takes so many frames at once."""
    made = Unit(address, max_cmdt_packets=most)
    try:
        yield made
    finally:
        made.close()


def sent_by(unit: Unit) -> bytes:
    """The data of the next packet that a unit has received."""
    data: bytes = unit.received.get(timeout=PATIENCE_S)[2]
    return data


@pytest.mark.slow
@pytest.mark.parametrize("most", [255, 3])
def test_our_twin_receives_and_sends(most: int) -> None:
    """Their unit loads our twin with packets of all sizes, and has each back, the other way round."""
    with unit_of(TOOL, most) as unit, cranes(simulate):
        for size in SIZES:
            say(unit, 0, 0xEF, A, 6, TOOL, [1, *text(size - 1)])
            assert sent_by(unit) == b"\x03" + text(size - 1)[::-1]


@pytest.mark.slow
@pytest.mark.parametrize("most", [255, 3])
def test_our_device_sends_and_receives(most: int) -> None:
    """Our device loads their unit with packets of all sizes, and has its answers."""
    with unit_of(A, most) as unit, cranes(connect) as rig:
        for size in SIZES:
            ticket = rig.clock.call(
                lambda size=size: rig.devices["A"].ask(
                    "Load", reply="Report", timeout_s=PATIENCE_S, priority=6, data=text(size - 1)
                )
            )
            assert sent_by(unit) == b"\x01" + text(size - 1)
            say(unit, 0, 0xEF, TOOL, 6, A, [3, *text(size - 1)])
            assert ticket.wait(PATIENCE_S).data == text(size - 1)


@pytest.mark.slow
def test_aces_send_lets_a_long_reply_go_on(capsysbinary: pytest.CaptureFixture[bytes]) -> None:
    """With --reply: the answer comes with a handshake of its own."""
    given = ["send", "Load", "priority=6", f"unit={A}", f"tool={TOOL}", f"data=hex:{text(20).hex()}"]
    where = ["-i", "aces", "-c", "truck", "--bus-kwargs", "physics=False", "-p", "tests/device/crane.py"]

    def answer(unit: Unit) -> None:
        sent_by(unit)
        say(unit, 0, 0xEF, TOOL, 6, A, [3, *text(30)])

    with unit_of(A, 255) as unit, ThreadPoolExecutor() as pool:
        answered = pool.submit(answer, unit)
        assert main([*given, *where, "--tx", "--reply", "20s"]) == 0
        answered.result()
    assert f"data={text(30).hex().upper()}".encode() in capsysbinary.readouterr().out.replace(b" ", b"")


@pytest.mark.slow
def test_sessions_side_by_side() -> None:
    """Their tool loads two of our twins at once, while these answer: each packet arrives, none in another's frames."""
    with unit_of(TOOL, 3) as unit, cranes(simulate):
        for address in (A, B):
            say(unit, 0, 0xEF, address, 6, TOOL, [1, *text(200 + address)])
        found = {unit.received.get(timeout=PATIENCE_S)[1:] for _ in range(2)}
        assert found == {(address, b"\x03" + text(200 + address)[::-1]) for address in (A, B)}


@pytest.mark.slow
def test_what_their_unit_does_not_take_is_told(bus: can.BusABC) -> None:
    """A data frame is lost, which can-j1939 never asks for again; it is busy with another packet: the ticket says why.

    What it takes then, it has.
    """

    def load(rig: Any) -> Any:
        return rig.clock.call(lambda: rig.devices["A"].send("Load", priority=6, data=text(40)))

    with unit_of(A, 255) as unit, cranes(connect, Once(2)) as rig:
        with pytest.raises(DeviceError, match=r"its receiver (gave no acknowledgement in time|aborted)"):
            load(rig).wait(PATIENCE_S)
        wait_until(lambda: not unit.unit.j1939_dll._rcv_buffer)
        request = can.Message(
            arbitration_id=0x1CEC00F9 | A << 8, data=bytes.fromhex("10 F9 06 FF FF 00 EF 00")
        )
        bus.send(request)
        wait_until(lambda: unit.unit.j1939_dll._rcv_buffer)
        with pytest.raises(DeviceError, match="its receiver aborted: busy"):
            load(rig).wait(PATIENCE_S)
        wait_until(lambda: not unit.unit.j1939_dll._rcv_buffer)
        load(rig).wait(PATIENCE_S)
        assert sent_by(unit) == b"\x01" + text(40)


@pytest.mark.slow
def test_what_we_lack_is_asked_for(bus: can.BusABC) -> None:
    """A data frame of theirs is lost: we ask for it by its number; can-j1939 sends none again, and we abort."""
    with unit_of(TOOL, 255) as unit, cranes(simulate, Once(2)) as made:
        say(unit, 0, 0xEF, A, 6, TOOL, [1, *text(40)])
        steering: list[bytes] = []
        while not steering or steering[-1][0] != 255:
            message = bus.recv(PATIENCE_S)
            assert message is not None, steering
            if message.arbitration_id == 0x1CECF900 | A:
                steering.append(bytes(message.data[:3]))
        assert steering == [b"\x11\x06\x01", b"\x11\x01\x02", b"\xff\x03\xff"]
        assert made.twins["A"].loaded == []


def test_ours_among_ourselves_lose_frames() -> None:
    """Twin and device, in life: what is lost on the way is asked for again, both ways."""
    with cranes(simulate, Once(2)) as made, cranes(connect, Once(5)) as rig:
        ticket = rig.clock.call(
            lambda: rig.devices["A"].ask(
                "Load", reply="Report", timeout_s=PATIENCE_S, priority=6, data=text(60)
            )
        )
        assert ticket.wait(PATIENCE_S).data == text(60)[::-1]
        assert made.twins["A"].loaded == [text(60)]
