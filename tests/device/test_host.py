"""The host's side of a bus: polling, coalescing, budgets, requests and replies, and what goes wrong."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import pytest

from aces_bus import Frame
from aces_bus.device import UNKNOWN, Driver, OutgoingMessage, Poll, uncoalesced
from aces_bus.device.coalesce import Setpoint, per_device
from aces_bus.device.host import Host
from aces_bus.errors import CallerError, FieldError, NoReplyError, UnknownNameError
from aces_bus.hardware import ListeningNode
from aces_bus.robot import VirtualRobot, connect
from tests.device.fan import COUNTED_ROBOT, ROBOT, RPM, SERIAL_ROBOT, Fan, FanTwin, drivers, robot_of
from tests.interpreted import replaces_methods


def made(text: str = ROBOT, **options: Any) -> VirtualRobot:
    robot = robot_of(text)
    options.setdefault("rate_hz", robot.rate_hz)
    return VirtualRobot(robot, load=drivers, **options)


def host_of(robot: VirtualRobot) -> Host:
    return robot.rig.hosts["line"]


@pytest.mark.parametrize("text", [ROBOT, SERIAL_ROBOT], ids=["can", "serial"])
def test_what_is_polled_is_known_and_fresh(text: str) -> None:
    """A signal is unknown before anything was heard, then has the twin's value in SI."""
    with made(text) as robot:
        assert robot["A.left"].value is UNKNOWN
        assert robot["A.temperature"].age_ns is None
        robot.advance(0.05)
        assert robot["A.temperature"].value == pytest.approx(313.15)
        assert robot["A.temperature"].age_ns in range(10_000_001)


def test_set_points_of_a_board_are_one_frame() -> None:
    """Two set-points of one board go out in one frame a tick, in the sheet's unit; none before both are given."""
    with made() as robot:
        recorder = ListeningNode(robot.wires["line"])
        robot.advance(0.005)
        robot["A.left"].set(100 * RPM)
        robot.advance(0.05)
        assert not [f for f in recorder.frames() if f.arbitration_id == 0x111]
        robot["A.right"].set(200 * RPM)
        robot.advance(0.03)
        frames = [frame for frame in recorder.frames() if frame.arbitration_id == 0x111]
        assert [frame.data.hex() for frame in frames] == ["6400c800"] * 3


def test_both_sides_count_the_packets_of_each_device() -> None:
    """Polls, set-points and answers carry a counter on, for each device: neither side finds that any was lost."""
    with made(COUNTED_ROBOT) as robot:
        for name in "AB":
            robot[f"{name}.left"].set(100 * RPM)
            robot[f"{name}.right"].set(200 * RPM)
        robot.advance(1.0)
        host, twin = host_of(robot), robot.twins["A"]
        twins = twin.twins
        assert host.scanner.counts.missed == twins.scanner.counts.missed == 0
        assert twins.scanner.counts.records > host.counts.polls > 190
        twins.packet(twin, "State", {"left": 0, "right": 0, "temperature": 0})  # built, and lost on its way
        robot.advance(0.1)
        assert host.scanner.counts.missed == 1


def test_a_writer_writes_what_the_encoder_does() -> None:
    """With the credentials bound once: the same frame, and the same error for what does not fit."""
    with made() as robot:
        device = robot.devices["A"]
        encoder, message = device.variant.encoder, device.variant["Set"]
        write = encoder.writer(message, {"node": 1})
        for left in (0, 100, 300):
            fields = {"left": left, "right": 7}
            assert write(fields) == encoder.packet(message, {"node": 1, **fields})
        errors: list[str] = []
        for encode in (write, lambda fields: encoder.packet(message, {"node": 1, **fields})):
            with pytest.raises(FieldError) as raised:
                encode({"left": 1e9, "right": 0})
            errors.append(str(raised.value))
        assert errors[0] == errors[1]
        assert "left" in errors[0]


def test_rules_are_replaceable() -> None:
    """A user's own rule is given all that is wanted and says what goes out: here one frame a set-point, or a constant."""

    def stop(wants: Any) -> Any:
        assert all(isinstance(want, Setpoint) for want in wants)
        yield OutgoingMessage(wants[0].device, "Set", {"left": 0, "right": 0})

    for rule, count in ((uncoalesced, 2), (stop, 1)):
        with made(rules={"Set": rule}) as robot:
            recorder = ListeningNode(robot.wires["line"])
            robot["A.left"].set(10.0)
            robot["A.right"].set(10.0)
            robot.advance(0.009)
            assert sum(frame.arbitration_id == 0x111 for frame in recorder.frames()) == count


def test_the_budget_carries_polls_over_in_turn() -> None:
    """What does not fit into a tick is first in the next: everybody is asked equally often."""
    with made(budget=0.025) as robot:  # 0.25 ms of 10 ms: one request with its answer, not two
        robot.advance(1.0)
        counts = host_of(robot).counts
        assert counts.polls_carried > 50
        assert robot.events.count("overrun") > 50
        assert "did not fit into a tick of 10 ms" in robot.events.of("overrun")[0].detail
        asked = [twin.requests for twin in robot.twins.values()]
        assert max(asked) - min(asked) <= 1
        assert counts.polls - sum(asked) in (0, 1)  # the last may be on its way


def test_the_default_rule_makes_one_message_a_device() -> None:
    """A user's rule may hand on to `per_device`: one frame a board with all its channels, none while one of them lacks."""
    given: list[int] = []

    def noted(wants: Sequence[Setpoint]) -> Any:
        given.append(len(wants))
        return per_device(wants)

    with made(rules={"Set": noted}) as robot:
        recorder = ListeningNode(robot.wires["line"])
        robot["A.left"].set(100 * RPM)
        robot["A.right"].set(200 * RPM)
        robot["B.left"].set(300 * RPM)
        robot.advance(0.009)
        robot["B.right"].set(400 * RPM)
        robot.advance(0.01)
        frames = [
            (f.arbitration_id, f.data.hex()) for f in recorder.frames() if f.arbitration_id & ~3 == 0x110
        ]
        assert frames == [(0x111, "6400c800"), (0x111, "6400c800"), (0x112, "2c019001")]
        assert given == [3, 4]


def test_slow_polls_are_spread_over_their_period() -> None:
    """Polls of ten a second of eight boards do not meet in one tick: none has more than two of them."""
    text = ROBOT + "".join(
        f'N{node} = {{ driver = "fan", bus = "line", credentials = {{ node = {node} }} }}\n'
        for node in range(3, 9)
    )

    class SlowFan(Fan):
        polls: Sequence[Poll] = (Poll("Ask", reply="State", every_s=0.1),)

    slow = replace(drivers("fan"), device=SlowFan)
    with VirtualRobot(robot_of(text), rate_hz=100, load=lambda name: slow) as robot:
        counts, asked = host_of(robot).counts, list[int]()
        for _ in range(20):
            before = counts.polls
            robot.advance(0.01)
            asked.append(counts.polls - before)
        assert sum(asked) in range(16, 24)  # each two or three times
        assert max(asked) <= 2


class HeldUp:
    """The clock of a host on a machine that looks at what is due so much later (ns)."""

    def __init__(self, clock: Any, late_ns: int) -> None:
        self._clock, self._late = clock, late_ns
        self.call_at, self.call_in = clock.call_at, clock.call_in

    def now(self) -> int:
        return int(self._clock.now() + self._late)


@replaces_methods
@pytest.mark.parametrize(("held_ms", "is_heard"), [(4, False), (6, True)])
def test_a_machine_that_was_held_up_reads_before_it_counts_a_miss(held_ms: int, is_heard: bool) -> None:
    """Over 5 ms late, a time-out waits 10 ms more for answers that may lie there; one that then comes is in time."""
    with made(rate_hz=0) as robot:
        host = host_of(robot)
        robot.twins["A"].fault("late", 0.0101)  # just over
        ticket = robot.devices["A"].ask("Ask", reply="State", timeout_s=0.01, retries=0)
        host.unanswered.clock = HeldUp(robot.clock, held_ms * 1_000_000)  # type: ignore[assignment]
        robot.advance(0.012)
        assert (host.counts.missed, ticket.state == "done") == (int(not is_heard), is_heard)


@replaces_methods
def test_a_machine_that_was_held_up_counts_what_never_comes_once() -> None:
    """Ten milliseconds after a late time-out the request has failed, although the machine is late once more."""
    with made(rate_hz=0) as robot:
        host = host_of(robot)
        robot.twins["A"].fault("silent")
        for count in (1, 2):
            ticket = robot.devices["A"].ask("Ask", reply="State", timeout_s=0.01, retries=0)
            host.unanswered.clock = HeldUp(robot.clock, 8_000_000)  # type: ignore[assignment]
            robot.advance(0.018)
            assert ticket.state == "waiting"
            robot.advance(0.004)
            assert isinstance(ticket.error, NoReplyError)
            assert host.counts.missed == count


@replaces_methods
def test_ticks_are_left_out_after_the_first_one_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """The first tick waits until all buses are open, which is not an overrun; a later one that is late by whole ticks is."""
    robot = made()
    host, now, late = host_of(robot), robot.clock.now, [0]
    monkeypatch.setattr(robot.clock, "now", lambda: now() + late[0])
    robot.open()
    late[0] = 55_000_000
    robot.advance(0.001)
    assert (host.counts.ticks, host.counts.ticks_missed) == (1, 0)
    late[0] = 100_000_000
    robot.advance(0.1)
    assert host.counts.ticks_missed == 10
    assert robot.events.count("overrun") == 1


def test_a_poll_without_an_answer_is_sent_again_in_the_next_tick() -> None:
    """A lost reply costs one tick; who does not answer at all is asked twice more, and then after the time-out."""
    with made() as robot:  # 100 Hz
        robot.advance(0.1)
        counts = host_of(robot).counts
        robot.twins["A"].fault("loses", 5)
        ages: list[int] = []
        for _ in range(50):
            robot.advance(0.01)
            age_ns = robot["A.temperature"].age_ns
            assert age_ns is not None
            ages.append(age_ns)
        assert counts.repeated == counts.answered_late > 5
        assert max(ages) < 20_000_000
        assert counts.missed == 0
        robot.twins["A"].fault("loses", on=False)
        robot.twins["A"].fault("silent")
        repeated = counts.repeated
        robot.advance(0.045)
        assert counts.repeated - repeated == 2
        assert robot.events.count("duplicate reply") == robot.events.count("late reply") == 0


def test_an_answer_that_is_later_than_a_tick_is_counted() -> None:
    """A device that takes longer than a tick is asked once more, and from then on once a tick: its values are as fresh."""
    with made() as robot:  # 100 Hz
        robot.advance(0.1)
        robot.twins["A"].fault("late", 0.012)
        robot.advance(0.5)
        assert host_of(robot).counts.answered_late == host_of(robot).counts.repeated == 1
        age_ns = robot["A.temperature"].age_ns
        assert age_ns is not None
        assert age_ns < 20_000_000
        assert robot.events.count("duplicate reply") == 0
        assert not robot.devices["A"].is_silent


def test_both_answers_to_a_poll_that_was_sent_again_are_one_device_s() -> None:
    """A device is late once: the second answer was asked for, too; it is neither late nor a second device's."""
    with made() as robot:  # 100 Hz
        robot.advance(1.0)
        robot.twins["A"].fault("late", 0.0125)
        robot.advance(0.005)
        robot.twins["A"].fault("late", on=False)
        robot.advance(0.5)
        assert host_of(robot).counts.repeated == 1
        assert robot.events.count("late reply") == 0
        assert robot.events.count("duplicate reply") == 0


def test_a_host_without_a_rate_sends_at_once() -> None:
    """Without a rate nothing is polled by itself; set-points and polls go out when they are given."""
    with made(rate_hz=0) as robot:
        robot.advance(0.1)
        assert robot["A.left"].value is UNKNOWN
        host_of(robot).poll()
        robot.advance(0.002)
        assert robot["A.left"].read().value == 0
        robot["A.left"].set(1.0)
        robot["A.right"].set(1.0)
        robot.advance(0.002)
        assert robot.twins["A"].left == 10


def test_a_request_has_its_answer() -> None:
    """`ask` gives a ticket whose result is the record that answered, with its latency."""
    with made() as robot:
        ticket = robot.devices["B"].ask("Ask", reply="State")
        record = ticket.wait()
        assert (record.node, record.temperature, ticket.tries) == (2, 40, 1)
        assert 0 < ticket.latency_ns < 2_000_000


def test_a_lost_answer_is_asked_for_again() -> None:
    """A request is repeated as often as said; then it fails, naming device, message and what to look at."""
    with made(rate_hz=0) as robot:
        robot.twins["A"].fault("loses", 2)
        ticket = robot.devices["A"].ask("Ask", reply="State", retries=1)
        assert ticket.wait().node == 1
        assert ticket.tries == 2
        robot.twins["A"].power(False)
        with pytest.raises(
            NoReplyError, match=r"line A: no answer to Ask within 10 ms \(3 tries\); is it powered"
        ):
            robot.devices["A"].ask("Ask", reply="State", timeout_s=0.01).wait()
        assert robot.events.count("no reply", "A") == 1


class BeatingTwin(FanTwin):
    """A fan that says its state by itself, each 10 ms from when it is powered."""

    def setup(self) -> None:
        super().setup()
        self.beats = 0
        self.every(0.01, self.beat)

    def beat(self) -> None:
        self.beats += 1
        self.reply("State", left=self.beats, right=0, temperature=40)
        if self.beats == 20:
            self.power(False)


def test_what_a_twin_does_by_itself_ends_when_it_is_switched_off() -> None:
    """What `setup` repeats begins with power, once, whatever was before, and ends without it, also from within."""

    def load(name: str) -> Driver:
        return replace(drivers(name), twin=BeatingTwin)

    with VirtualRobot(robot_of(ROBOT), rate_hz=0, load=load) as robot:
        twin = robot.twins["A"]
        robot.advance(0.055)
        assert (twin.beats, twin.replies) == (5, 5)
        twin.power(False)
        robot.advance(0.1)
        assert twin.beats == 5
        for _ in range(3):
            twin.reboot()
        robot.advance(0.055)
        assert (twin.beats, twin.replies) == (5, 10)
        robot.advance(0.5)
        assert (twin.beats, twin.is_powered) == (20, False)


@pytest.mark.parametrize("text", [ROBOT, SERIAL_ROBOT], ids=["can", "serial"])
def test_silence_is_told_once_and_goes_stale(text: str) -> None:
    """A silent device is told once, its values are stale with their age, and the others do not suffer."""
    with made(text) as robot:
        robot.advance(0.5)
        robot.twins["A"].fault("silent")
        robot.advance(1.0)
        assert robot.events.count("silent", "A") == 1
        assert robot["A.left"].value is UNKNOWN
        reading = robot["A.left"].read()
        assert (reading.value, reading.is_stale) == (0, True)
        assert reading.age_ns is not None
        assert 0.9e9 < reading.age_ns < 1.1e9
        assert robot["B.left"].value == 0
        robot.twins["A"].fault("silent", on=False)
        robot.advance(0.5)  # who is silent is asked less often
        assert robot.events.count("answers", "A") == 1
        assert not robot["A.left"].is_stale


def test_one_speaks_at_a_time_on_a_half_duplex_line() -> None:
    """On a half-duplex line nothing collides, although both devices are asked in each tick."""
    with made(SERIAL_ROBOT) as robot:
        robot["A.left"].set(1.0)
        robot["A.right"].set(1.0)
        robot.advance(1.0)
        wire: Any = robot.wires["line"]
        assert wire.garbled == 0
        assert robot.twins["A"].requests > 150
        assert robot.twins["B"].requests > 90


@replaces_methods
def test_a_stop_is_before_what_is_asked_again() -> None:
    """A request of the stopped device is not repeated behind its stop, and the others' are repeated after it; who hears that
    a request has failed may ask for another."""
    with made(SERIAL_ROBOT) as robot:
        for twin in robot.twins.values():
            twin.fault("silent")
        host, fan, other = host_of(robot), robot.devices["A"], robot.devices["B"]
        host.slots.clear()
        robot.advance(0.1)
        sent: list[tuple[str, str]] = []
        transmit = host.transmit

        def recorded(packet: Any, device: Any, message: str, *rest: Any, **more: Any) -> bool:
            sent.append((device.name, message))
            return transmit(packet, device, message, *rest, **more)

        host.transmit = recorded  # type: ignore[method-assign]
        asked = fan.ask("Ask", reply="State", retries=2)
        waiting = fan.ask("Ask", reply="State", retries=0)
        waiting.then(lambda _: other.ask("Ask", reply="State", retries=0))
        robot.advance(0.01)
        stopped = fan.send_now("Set", left=0, right=0)
        robot.advance(0.5)
        assert sent == [("A", "Ask"), ("A", "Set"), ("B", "Ask")]
        assert stopped.state == "done"
        assert [str(one.error) for one in (asked, waiting)] == ["Ask to A: a stop overtook it"] * 2
        sent.clear()
        asked = fan.ask("Ask", reply="State", retries=1)
        robot.advance(0.01)
        other.send_now("Set", left=0, right=0)
        robot.advance(0.5)
        assert sent == [("A", "Ask"), ("B", "Set"), ("A", "Ask")]


def test_unknown_devices_and_packets_are_named() -> None:
    """A device that is not in the robot, and a frame of the wrong length, are told with what they were."""
    with made() as robot:
        other = robot.wires["line"].attach("other")
        robot.advance(0.053)  # between two ticks: equal identifiers at once would be bit errors
        other.send(Frame(0x125, bytes(5)))
        other.send(Frame(0x121, bytes(7)))
        other.send(Frame(0x7FF, b"\x01"))
        robot.advance(0.005)
        (stranger,) = robot.events.of("unknown device")
        assert "State of node 0x05" in stranger.detail
        (malformed,) = robot.events.of("malformed")
        assert malformed.device == "A"
        assert "0x121 00 00 00 00 00 00 00: length 7, State has 5 bytes" in malformed.detail
        assert host_of(robot).unknown["unknown"] == 1
        robot.advance(0.05)
        assert robot["A.left"].value == 0


def test_an_impossible_set_point_stops_nothing() -> None:
    """A value that its field cannot hold is reported as not sent; other devices' set-points go out."""
    with made() as robot:
        robot.devices["A"].want("Set", "left", 1 << 20)
        robot.devices["A"].want("Set", "right", 1)
        robot["B.left"].set(1.0)
        robot["B.right"].set(1.0)
        robot.advance(0.02)
        assert robot.events.count("limited") == 0
        assert "1048576" in robot.events.of("not sent")[0].detail
        assert robot.twins["B"].left == 10


def test_a_message_without_one_of_its_fields_is_not_sent() -> None:
    """A rule that leaves a field out is reported by message and field, as not sent; nothing has been limited."""

    def forgetful(wants: Sequence[Setpoint]) -> Iterator[OutgoingMessage]:
        yield OutgoingMessage(wants[0].device, "Set", {"left": 10}, wants)

    with made(rules={"Set": forgetful}) as robot:
        robot["A.left"].set(1.0)
        robot["A.right"].set(1.0)
        robot.advance(0.02)
        assert robot.events.count("limited") == 0
        (first,) = robot.events.of("not sent")
        assert (first.device, first.detail) == ("A", "Set: no value given for right")
        assert robot.twins["A"].left == 0


def test_hold_and_drop() -> None:
    """Held set-points wait and then go out; dropped ones are forgotten."""
    with made() as robot:
        robot.advance(0.005)
        device = robot.devices["A"]
        device.hold("Set", 0.1)
        robot["A.left"].set(1.0)
        robot["A.right"].set(1.0)
        robot.advance(0.05)
        assert robot.twins["A"].left == 0
        robot.advance(0.1)
        assert robot.twins["A"].left == 10
        requests = robot.twins["A"].requests
        device.drop("Set")
        robot.advance(0.1)
        assert robot.twins["A"].requests - requests in (9, 10, 11)  # polls only


def test_wrong_calls_say_what_would_be_right() -> None:
    """Unknown names list those that exist, read-only signals refuse, probes speak what the bus has."""
    with made() as robot:
        with pytest.raises(UnknownNameError, match=r"A\.left"):
            robot["A.lift"]
        with pytest.raises(UnknownNameError, match="State"):
            robot.devices["A"].ask("Stat")
        with pytest.raises(FieldError, match="left"):
            robot.devices["A"].ask("Set", left=-1, right=0)
        with pytest.raises(CallerError, match="read-only"):
            robot["A.temperature"].set(1)
        with pytest.raises(CallerError, match="speaks hubo"):
            host_of(robot).probe("hubo", board=1)
        with pytest.raises(CallerError, match="no port for bus line"):
            connect(robot_of(ROBOT), {}, load=drivers)


def test_a_probe_asks_and_leaves() -> None:
    """A probe asks by number without there being a device; it leaves no trace."""
    with made(rate_hz=0) as robot:
        host = host_of(robot)
        probe = host.probe("fan", node=1)
        del robot.rig.hosts["line"].members["A"]
        assert probe.ask("Ask", reply="State").wait().temperature == 40
        host.remove(probe.name)
        assert list(host.devices) == ["B"]


def test_stopping_tells_every_device() -> None:
    """`stop_motion` ends streams and tells each device to stop."""
    with made() as robot:
        for name in ("A", "B"):
            robot[f"{name}.left"].set(5.0)
            robot[f"{name}.right"].set(5.0)
        robot.advance(0.1)
        assert robot.twins["A"].left > 0
        robot.rig.stop_motion().wait()
        robot.advance(0.1)
        assert [robot.twins[name].left for name in "AB"] == [0, 0]
