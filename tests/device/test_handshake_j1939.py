"""Packets of J1939 to one address: devices and twins keep the handshake of RTS, CTS and acknowledgement, in virtual time."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from random import Random
from typing import Any, ClassVar

import pytest

from aces_bus import Frame
from aces_bus.hardware import ListeningNode
from aces_bus.robot import VirtualRobot, connect
from tests.device.crane import LOAD, TOOL, A, B, C, crane, robot_of_cranes
from tests.device.truck import LOAD as TRUCK_LOAD
from tests.device.truck import robot_of_unit

#: Identifiers of TP.CM and TP.DT from the tool to unit A, and back.
TO_CM, TO_DT, BACK_CM, BACK_DT = 0x1CEC10F9, 0x1CEB10F9, 0x1CECF910, 0x1CEBF910
EF00 = "00 EF 00"


class Peer:
    """Another unit on the line: what it received, and what it sends."""

    def __init__(self, robot: VirtualRobot) -> None:
        self.robot = robot
        self.recorder = ListeningNode(robot.wires["line"])
        self.port = robot.ports("peer")["line"]
        self.port.open(lambda frame, instant: None)

    def send(self, identifier: int, *texts: str) -> None:
        for text in texts:
            self.port.send(Frame(identifier, bytes.fromhex(text), is_extended_id=True))

    def after(self, seconds: float) -> list[str]:
        """What was on the line, after so much more time; it is forgotten then."""
        self.robot.advance(seconds)
        found = [
            f"{frame.arbitration_id & 0x3FFFFFF:07X} {frame.data[:3].hex(' ')}"
            for frame in self.recorder.frames()
        ]
        self.recorder.received.clear()
        return found

    def at(self) -> list[float]:
        """When frames were on the line (s)."""
        return [instant / 1e9 for instant, _ in self.recorder.received]


@pytest.fixture
def robot() -> Iterator[VirtualRobot]:
    with VirtualRobot(robot_of_cranes(), load=LOAD) as robot:
        yield robot


@pytest.fixture
def alone(robot: VirtualRobot) -> VirtualRobot:
    """The host's devices, with no twin that answers."""
    for twin in robot.twins.values():
        twin.power(False)
    return robot


@pytest.fixture
def twin_alone(robot: VirtualRobot) -> VirtualRobot:
    """The twins, without their host."""
    robot.rig.close()
    return robot


def text(size: int) -> bytes:
    return bytes((7 * place + size) & 0xFF for place in range(size))


@pytest.mark.parametrize("size", [8, 13, 14, 222, 1784])
def test_packets_go_both_ways_and_every_frame_is_accounted_for(robot: VirtualRobot, size: int) -> None:
    """A device loads its twin, which reports, each with a handshake; a bystander loses nothing."""
    recorder = ListeningNode(robot.wires["line"])
    ticket = robot.devices["A"].ask("Load", reply="Report", timeout_s=5.0, priority=6, data=text(size))
    robot.advance(2.0)
    assert robot.twins["A"].loaded == [text(size)]
    assert ticket.result is not None, ticket.error
    assert ticket.result.data == text(size)[::-1]
    scanner = crane.scanner()
    records = scanner.feed(list(recorder.frames()))
    assert [type(record).__name__ for record in records] == ["Load", "Report"]
    counts = scanner.counts
    assert (counts.malformed, counts.pending, counts.decoded + counts.control) == (0, 0, counts.total)
    assert counts.control == (4 if size < 1784 else counts.control)


def test_packets_of_several_pairs_run_side_by_side(robot: VirtualRobot) -> None:
    """To two units, and back from them, frame by frame in turn; those to one unit go one behind the other."""
    tickets = [
        robot.devices[name].ask(
            "Load", reply="Report", timeout_s=5.0, priority=6, data=text(100 + place) + name.encode()
        )
        for place, name in enumerate("ABAB")
    ]
    robot.advance(3.0)
    assert [ticket.error for ticket in tickets] == [None] * 4
    for name, places in (("A", (0, 2)), ("B", (1, 3))):
        assert robot.twins[name].loaded == [text(100 + place) + name.encode() for place in places]


# ---------------------------------------------------------------------- sending


def loading(robot: VirtualRobot, size: int = 20) -> Any:
    """A ticket of three data frames (21 bytes)."""
    return robot.devices["A"].send("Load", priority=7, data=text(size))


def test_what_the_receiver_asks_for_is_sent(alone: VirtualRobot) -> None:
    """As many frames as a CTS says, from the one that it names, and again where it names one that was sent."""
    peer = Peer(alone)
    ticket = loading(alone)
    assert peer.after(0.01) == ["0EC10F9 10 15 00"]
    peer.send(BACK_CM, f"11 02 01 FF FF {EF00}")
    assert [line[:10] for line in peer.after(0.01)[1:]] == ["0EB10F9 01", "0EB10F9 02"]
    peer.send(BACK_CM, f"11 01 02 FF FF {EF00}")
    assert [line[:10] for line in peer.after(0.01)[1:]] == ["0EB10F9 02"]
    peer.send(BACK_CM, f"11 FF 03 FF FF {EF00}")
    assert [line[:10] for line in peer.after(0.01)[1:]] == ["0EB10F9 03"]
    assert ticket.state == "waiting"
    peer.send(BACK_CM, f"11 01 01 FF FF {EF00}")
    assert [line[:10] for line in peer.after(0.01)[1:]] == ["0EB10F9 01"]
    peer.send(BACK_CM, f"13 15 00 03 FF {EF00}")
    assert len(peer.after(3.0)) == 1
    assert ticket.state == "done"


def test_a_receiver_may_hold_its_sender(alone: VirtualRobot) -> None:
    """A CTS without frames: the sender waits for the next one, 1.05 s at most, and aborts then."""
    peer = Peer(alone)
    ticket = loading(alone)
    peer.after(0.01)
    for _ in range(4):
        peer.send(BACK_CM, f"11 00 01 FF FF {EF00}")
        assert len(peer.after(1.0)) == 1
    assert ticket.state == "waiting"
    assert [line[:10] for line in peer.after(0.1)] == ["0EC10F9 ff"]
    assert "gave no go-ahead in time" in str(ticket.error)


@pytest.mark.parametrize("behind", ["request", "data"])
def test_without_an_answer_the_packet_is_aborted(alone: VirtualRobot, behind: str) -> None:
    """1.25 s after the last frame that it sent, with the reason that it timed out; nothing is sent again."""
    peer = Peer(alone)
    ticket = loading(alone)
    if behind == "data":
        alone.advance(0.01)
        peer.send(BACK_CM, f"11 03 01 FF FF {EF00}")
    alone.advance(3.0)
    *_, last, aborted = peer.at()
    assert 1.25 <= aborted - last < 1.252
    assert peer.after(3.0)[-1] == "0EC10F9 ff 03 ff"
    what = "acknowledgement" if behind == "data" else "go-ahead"
    assert f"its receiver gave no {what} in time" in str(ticket.error)


def test_an_abort_is_told_with_its_reason(alone: VirtualRobot) -> None:
    """The ticket fails with it, no abort is answered, and the next packet begins."""
    peer = Peer(alone)
    first, second = loading(alone), loading(alone, 30)
    peer.after(0.01)
    peer.send(BACK_CM, f"FF 02 FF FF FF {EF00}")
    assert peer.after(0.01) == ["0ECF910 ff 02 ff", "0EC10F9 10 1f 00"]
    assert "was not sent: its receiver aborted: no resources" in str(first.error)
    assert second.state == "waiting"


def test_steering_of_another_packet_is_none(alone: VirtualRobot) -> None:
    """Another parameter group, another unit, an acknowledgement of another size or before the data: nothing happens."""
    peer = Peer(alone)
    ticket = loading(alone)
    peer.after(0.01)
    peer.send(
        BACK_CM, "11 03 01 FF FF 00 EE 00", "FF 01 FF FF FF 00 EE 00", f"13 15 00 03 FF {EF00}", "11 03"
    )
    peer.send(0x1CECF911, f"11 03 01 FF FF {EF00}")
    assert len(peer.after(0.01)) == 5
    peer.send(BACK_CM, f"11 03 01 FF FF {EF00}")
    assert len(peer.after(0.01)) == 4
    peer.send(BACK_CM, f"13 16 00 04 FF {EF00}")
    peer.after(0.01)
    assert ticket.state == "waiting"


def test_a_receiver_that_asks_for_what_there_is_not_or_for_ever_is_given_up(alone: VirtualRobot) -> None:
    """A frame beyond the packet's end is a contradiction; the same frames again and again end, too."""
    peer = Peer(alone)
    ticket = loading(alone)
    peer.after(0.01)
    peer.send(BACK_CM, f"11 01 04 FF FF {EF00}")
    assert peer.after(0.01)[1:] == ["0EC10F9 ff 07 ff"]
    assert "asks for frame 4 of 3" in str(ticket.error)
    ticket = loading(alone)
    count = 0
    lines: list[str] = []
    while ticket.state == "waiting":
        peer.send(BACK_CM, f"11 01 01 FF FF {EF00}")
        lines = peer.after(0.01)
        count += 1
    assert count < 30
    assert lines[-1] == "0EC10F9 ff 05 ff"
    assert "asks for the same frames too often" in str(ticket.error)


def test_a_stop_overtakes(alone: VirtualRobot) -> None:
    """It leaves at once, what is under way to its device is aborted, what waits is dropped; another device's goes on."""
    peer = Peer(alone)
    tickets = [loading(alone), loading(alone)]
    other = alone.devices["B"].send("Load", priority=7, data=text(20))
    peer.after(0.01)
    peer.send(BACK_CM, f"11 02 01 FF FF {EF00}")
    peer.after(0.01)
    alone.devices["A"].send_now("Stop", priority=3, why=b"")
    assert sorted(peer.after(0.01)) == ["0EC10F9 ff 02 ff", "0EF10F9 02"]
    assert [str(ticket.error).rpartition(": ")[2] for ticket in tickets] == ["a stop overtook it"] * 2
    assert other.state == "waiting"


def test_a_stop_of_several_frames_waits_for_no_more_than_one(robot: VirtualRobot) -> None:
    """A long packet is ended in the middle of its data: the stop's session begins behind its abort, and is taken."""
    recorder = ListeningNode(robot.wires["line"])
    ticket = robot.devices["A"].send("Load", priority=6, data=text(1000))
    robot.advance(0.03)
    stop = robot.devices["A"].send_now("Stop", priority=3, why=text(20))
    robot.advance(1.0)
    assert "a stop overtook it" in str(ticket.error)
    assert stop.state == "done"
    assert robot.twins["A"].stopped == [text(20)]
    assert robot.twins["A"].loaded == []
    scanner = crane.scanner()
    assert [type(record).__name__ for record in scanner.feed(list(recorder.frames()))] == ["Stop"]
    counts = scanner.counts
    assert counts.decoded + counts.control + counts.malformed == counts.total
    host: Any = robot.rig.hosts["line"].port
    assert host.failed == 1


# ---------------------------------------------------------------------- receiving

RTS, LAST = f"10 15 00 03 FF {EF00}", "03 01 01 01 01 01 01 01"
ONE, TWO = "01 01 02 03 04 05 06 07", "02 01 02 03 04 05 06 07"


def test_no_more_is_asked_for_than_the_sender_takes(twin_alone: VirtualRobot) -> None:
    """The request's fifth byte bounds each CTS; the last frame is acknowledged."""
    peer = Peer(twin_alone)
    peer.send(TO_CM, f"10 15 00 03 02 {EF00}")
    assert peer.after(0.01)[1:] == ["0ECF910 11 02 01"]
    peer.send(TO_DT, ONE, TWO)
    assert peer.after(0.01)[2:] == ["0ECF910 11 01 03"]
    peer.send(TO_DT, LAST)
    assert peer.after(0.01)[1] == "0ECF910 13 15 00"
    (loaded,) = twin_alone.twins["A"].loaded
    assert len(loaded) == 20


def test_what_is_missing_is_asked_for_again(twin_alone: VirtualRobot) -> None:
    """Behind the last frame at once, and where that is missing when 0.75 s are over."""
    peer = Peer(twin_alone)
    peer.send(TO_CM, RTS)
    peer.after(0.01)
    peer.send(TO_DT, ONE, ONE, LAST)
    assert peer.after(0.01)[3:] == ["0ECF910 11 01 02"]
    peer.send(TO_DT, TWO)
    assert peer.after(0.01)[1] == "0ECF910 13 15 00"
    peer.after(3.0)
    peer.send(TO_CM, RTS)
    peer.after(0.01)
    peer.send(TO_DT, ONE)
    assert len(peer.after(0.74)) == 1
    assert peer.after(0.02) == ["0ECF910 11 02 02"]
    peer.send(TO_DT, TWO, LAST)
    assert peer.after(0.01)[2] == "0ECF910 13 15 00"
    assert len(twin_alone.twins["A"].loaded) == 2


def test_a_sender_that_falls_silent_is_aborted(twin_alone: VirtualRobot) -> None:
    """1.25 s after its last frame, however often it was asked: the scanner waits no longer."""
    peer = Peer(twin_alone)
    for frames in ([], [ONE], [ONE, LAST]):
        peer.send(TO_CM, RTS)
        peer.send(TO_DT, *frames)
        twin_alone.advance(3.0)
        lines = [(f.arbitration_id & 0x3FFFFFF, f.data[:2]) for f in peer.recorder.frames()]
        last = max(place for place, (identifier, _) in enumerate(lines) if identifier & 0xFF == TOOL)
        assert lines[-1] == (0xECF910, b"\xff\x03")
        assert 1.25 <= peer.at()[-1] - peer.at()[last] < 1.253
        assert len(peer.after(3.0)) == len(lines)
    assert twin_alone.twins["A"].loaded == []


def test_frames_that_come_again_keep_no_packet_open(twin_alone: VirtualRobot) -> None:
    """A bystander waits 1.25 s for the next frame of the packet, whatever comes twice meanwhile; so does the receiver."""
    peer = Peer(twin_alone)
    peer.send(TO_CM, RTS)
    peer.after(0.01)
    peer.send(TO_DT, ONE)
    lines = peer.after(0.5)
    for pause in (0.5, 0.2, 0.2):
        peer.send(TO_DT, ONE)
        lines += peer.after(pause)
    assert [line for line in lines if line[:5] == "0ECF9"] == ["0ECF910 11 02 02", "0ECF910 ff 03 ff"]


def test_a_second_request_begins_anew(twin_alone: VirtualRobot) -> None:
    """What came of the first packet is forgotten."""
    peer = Peer(twin_alone)
    peer.send(TO_CM, RTS)
    peer.after(0.01)
    peer.send(TO_DT, TWO)
    peer.send(TO_CM, f"10 0A 00 02 FF {EF00}")
    peer.after(0.01)
    peer.send(TO_DT, ONE)
    assert len(peer.after(0.01)) == 1
    peer.send(TO_DT, TWO)
    assert peer.after(0.01)[1] == "0ECF910 13 0a 00"
    assert [len(data) for data in twin_alone.twins["A"].loaded] == [9]


def test_a_packet_that_its_sender_aborts_is_forgotten(twin_alone: VirtualRobot) -> None:
    """Nothing is asked any more."""
    peer = Peer(twin_alone)
    peer.send(TO_CM, RTS)
    peer.after(0.01)
    peer.send(TO_CM, f"FF 02 FF FF FF {EF00}")
    peer.after(0.01)
    peer.send(TO_DT, ONE, TWO, LAST)
    assert len(peer.after(3.0)) == 3
    assert twin_alone.twins["A"].loaded == []


@pytest.mark.parametrize("data", [[ONE, "01 09 09 09 09 09 09 09"], ["04 01 02 03 04 05 06 07"], ["01 02"]])
def test_what_contradicts_itself_is_aborted(twin_alone: VirtualRobot, data: list[str]) -> None:
    """A frame that comes again with other data, one beyond the end, a short one: as the scanner sees it."""
    peer = Peer(twin_alone)
    peer.send(TO_CM, RTS)
    peer.after(0.01)
    peer.send(TO_DT, *data)
    assert peer.after(3.0)[-1] == "0ECF910 ff 07 ff"


def test_too_many_at_once_are_told_so(twin_alone: VirtualRobot) -> None:
    """As many sessions as the transport has senders are open; the next one's receiver is busy, and those go on."""
    peer = Peer(twin_alone)
    for unit in (A, B, C):
        peer.send(0x1CEC0000 | unit << 8 | TOOL, RTS)
        line = peer.after(0.01)[-1]
        assert line == f"0ECF9{unit:02X} " + ("ff 01 ff" if unit == C else "11 03 01")
    peer.send(TO_DT, ONE, TWO, LAST)
    assert peer.after(0.01)[-1] == "0ECF910 13 15 00"


def test_only_packets_to_an_own_address_are_let_go_on(robot: VirtualRobot) -> None:
    """To another tool or unit, of a group that nobody knows, to who only listens, to who has no address: no answer."""
    peer = Peer(robot)
    peer.send(0x1CECF810, RTS)
    peer.send(0x1CEC13F9, RTS)
    peer.send(0x1CECF910, "10 15 00 03 FF 00 D0 00")
    assert len(peer.after(2.0)) == 3
    robot.rig.close()
    looker = connect(robot.robot, robot.ports("looker"), passive=True, load=LOAD)
    looker.open()
    peer.send(BACK_CM, RTS)
    assert len(peer.after(2.0)) == 1
    with VirtualRobot(robot_of_unit(), load=TRUCK_LOAD) as other:
        peer = Peer(other)
        peer.send(0x1CEC1010, RTS)
        peer.send(0x1CECF910, RTS)
        assert [line[:7] for line in peer.after(0.5)] == ["0EC1010", "0ECF910"]


def test_a_group_for_all_may_come_to_one_address(robot: VirtualRobot) -> None:
    """Faults that the tool asked for: the address is that of what the tool sends."""
    peer = Peer(robot)
    robot.twins["A"].power(False)
    for tool in (0xF8, TOOL):
        peer.send(0x1CEC0010 | tool << 8, "10 09 00 02 FF CA FE 00")
        peer.after(0.01)
        peer.send(0x1CEB0010 | tool << 8, "01 01 02 03 04 05 06 07", "02 08 09 FF FF FF FF FF")
    assert peer.after(0.01)[-1] == "0EC10F9 13 09 00"
    # A packet to another tool is seen, as by any bystander.
    assert robot.devices["A"].noted == [bytes(range(1, 10))] * 2


# ---------------------------------------------------------------------- losses


class LossyPort:
    """A port that loses every so many-th frame that comes or leaves, at random, and sends others twice."""

    def __init__(self, port: Any, seed: int) -> None:
        self.port, self.random = port, Random(seed)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.port, name)

    def open(self, received: Callable[[Frame, int], Any]) -> None:
        """Hand over what is not lost."""

        def some(frame: Frame, instant: int) -> None:
            for _ in range(self.times()):
                received(frame, instant)

        self.port.open(some)

    def times(self) -> int:
        """How often the next frame arrives."""
        return self.random.choices((0, 1, 2), (6, 90, 4))[0]

    def send(self, frame: Frame, age_ns: int = 0, *, report: Any = None, **how: Any) -> bool:
        """What is lost has left all the same."""
        times = self.times()
        if times == 0:
            self.port.clock.call_soon(lambda: report is not None and report("sent", ""))
        else:
            self.port.send(frame, age_ns, report=report, **how)
        if times == 2:
            self.port.send(frame, age_ns, **how)
        return True


@pytest.mark.parametrize("seed", range(12))
def test_whatever_is_lost_nothing_wrong_arrives(robot: VirtualRobot, seed: int) -> None:
    """Lost and doubled frames: a packet arrives as it was or not at all, its ticket says which, all sessions end, and a
    bystander accounts for each frame."""
    robot.rig.close()
    recorder = ListeningNode(robot.wires["line"])
    port: Any = LossyPort(robot.ports("lossy")["line"], seed)
    data = [text(size) for size in (30, 15, 60, 200)]
    with connect(robot.robot, {"line": port}, load=LOAD) as rig:
        tickets = [
            rig.devices[name].ask("Load", reply="Report", timeout_s=20.0, retries=0, priority=6, data=one)
            for name, one in zip("ABAB", data, strict=True)
        ]
        robot.advance(30.0)
        answers = [ticket.result.data[::-1] for ticket in tickets if ticket.result is not None]
        assert all(ticket.is_over for ticket in tickets)
        host: Any = rig.hosts["line"].port
        assert host.under_way == robot.twins["A"].twins.port.under_way == 0
        failed = host.failed
    loaded = robot.twins["A"].loaded + robot.twins["B"].loaded
    # What is loaded without a ticket that says so: its acknowledgement was lost.
    assert set(answers) <= set(loaded) <= set(data)
    assert len(loaded) + failed >= len(data)
    scanner = crane.scanner()
    scanner.feed(list(recorder.frames()))
    counts = scanner.counts
    assert counts.total == counts.decoded + counts.control + counts.malformed + counts.pending


def test_most_packets_survive_losses(robot: VirtualRobot) -> None:
    """Single data frames are asked for again: with each third one lost once, every packet arrives at the first try."""
    robot.rig.close()

    class Losing(LossyPort):
        """Loses each third data frame, but none of those that are sent again."""

        seen: ClassVar[set[bytes]] = set()

        def send(self, frame: Frame, age_ns: int = 0, **how: Any) -> bool:
            if frame.arbitration_id >> 16 & 0xFF == 0xEB and frame.data[0] % 3 == 0:
                if frame.data not in self.seen:
                    self.seen.add(frame.data)
                    self.port.clock.call_soon(lambda: how["report"]("sent", ""))
                    return True
            return bool(self.port.send(frame, age_ns, **how))

    port: Any = Losing(robot.ports("lossy")["line"], 0)
    port.times = lambda: 1  # nothing else is lost
    with connect(robot.robot, {"line": port}, load=LOAD) as rig:
        tickets = [rig.devices["A"].send("Load", priority=6, data=text(size)) for size in (30, 100, 300)]
        robot.advance(5.0)
        assert [ticket.state for ticket in tickets] == ["done"] * 3
    assert robot.twins["A"].loaded == [text(size) for size in (30, 100, 300)]
