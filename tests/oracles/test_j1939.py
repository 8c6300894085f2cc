"""can-j1939, unmodified, on our virtual bus: broadcasts and packets to one address, both ways.

Its times are real ones: what is asserted is order and content, with limits that a slow machine keeps.
"""

from __future__ import annotations

import queue
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import can
import pytest

from aces_bus.device import J1939Sender
from aces_bus.errors import CallerError, DeviceError, NoReplyError
from aces_bus.frames import Frame, message_to_frame
from aces_bus.hardware import CanGate, Received, port_of
from aces_bus.hardware.queues import Inbox
from aces_bus.robot import simulate
from aces_bus.runtime import Loop
from aces_tools.main import main
from tests.device.truck import FAULTS, LOAD, robot_of_unit
from tests.oracles.foreign import oracle
from tests.oracles.served import wait_until
from tests.specs.j1939_long import j1939_long

j1939 = oracle("j1939", "can-j1939")
#: Addresses of can-j1939's two units, and ours.
ONE, OTHER, OURS = 0x10, 0x20, 0xF9
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
    with CanGate(CHANNEL) as gate, J1939Sender(gate) as sender:
        sender.send(frames)
        assert gate.counters.sent + gate.waiting >= 1 + -(-size // 7)
    assert units[1].received.get(timeout=PATIENCE_S) == (0xEF00, OURS, data)


def test_a_broadcast_and_a_frame_of_ours_are_received(units: tuple[Unit, Unit]) -> None:
    """Both units have what was said to all."""
    with CanGate(CHANNEL) as gate, J1939Sender(gate) as sender:
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
    """Nobody answers; frames that are no packet."""
    frames = j1939_long.encode("Proprietary", priority=6, source=OURS, destination=NOBODY, data=text(20))
    with CanGate(CHANNEL) as gate, J1939Sender(gate) as sender:
        with pytest.raises(NoReplyError, match="48 gave no clear-to-send"):
            sender.send(frames)
        parts: list[list[Any]] = [frames[1:], frames[2:3], []]
        for part in parts:
            with pytest.raises(CallerError, match="give all frames that encode gave"):
                sender.send(part)


class RefusingGate:
    """A gate whose receiver has no room: its answer is there when the request has left."""

    name = "refusing"

    def __init__(self) -> None:
        self.inbox: Inbox[Any] = Inbox()

    def subscribe(self, filter: Any) -> Inbox[Any]:
        """What arrives, as far as the filter wants it."""
        self.filter = filter
        return self.inbox

    def send(self, frame: Frame) -> bool:
        """Refuse a request to send, and say something that is not for us."""
        for identifier in (0x1CEC0000 | OURS << 8 | ONE, 0x1CEC0000 | OURS << 8 | OTHER):
            answer = Frame(identifier, bytes.fromhex("FF 02 FF FF FF 00 EF 00"), is_extended_id=True)
            if frame.data[0] == 16 and self.filter.matches(answer):
                self.inbox.put([Received(answer, 0)])
        return True


def test_a_receiver_that_refuses_is_named() -> None:
    """An abort is an error with its reason."""
    gate: Any = RefusingGate()
    frames = j1939_long.encode("Proprietary", priority=6, source=OURS, destination=OTHER, data=text(20))
    with (
        J1939Sender(gate) as sender,
        pytest.raises(DeviceError, match="refusing: 32 aborted the packet: it has no resources"),
    ):
        sender.send(frames)
