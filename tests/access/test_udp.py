# Requests are answered without a socket.
# pyright: reportPrivateUsage=false
"""The original's UDP service: what it answers, what it takes, and what it makes of everything else."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from aces_bus.access import UdpStates
from aces_bus.errors import CallerError, UnknownNameError
from aces_bus.robot import run_virtual
from aces_bus.runtime import VirtualClock
from aces_bus.runtime.loop import Loop
from aces_bus.state import State
from tests.device.fan import ROBOT, drivers, robot_of

MS = 1_000_000


class Client:
    """A program that asks."""

    def __init__(self, port: int) -> None:
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.settimeout(5)
        self.socket.connect(("127.0.0.1", port))

    def send(self, data: bytes) -> None:
        self.socket.send(data)

    def answer(self) -> bytes:
        return self.socket.recv(1000)

    def get(self) -> bytes:
        self.send(b"GET")
        return self.answer()


@pytest.fixture
def clients() -> Iterator[list[Client]]:
    """Whose sockets are closed at the end."""
    made: list[Client] = []
    yield made
    for one in made:
        one.socket.close()


def made_states(clock: Any) -> tuple[dict[str, State], list[float]]:
    """A joint that can be set, and a temperature."""
    taken: list[float] = []
    hip = State("hip", unit="rad", clock=clock, setter=taken.append, request=lambda: taken.append(-1.0))
    return {"hip": hip, "heat": State("heat", unit="K", clock=clock, stale_after_s=1.0)}, taken


def test_values_are_answered_as_c_prints_them(clients: list[Client]) -> None:
    """`GET` gives six decimals without a terminator; what is unknown or stale is `nan`; a blank behind it does no harm."""
    clock = VirtualClock()
    states, _ = made_states(clock)
    with UdpStates(states, {"hip": 0, "heat": 0}, clock=clock) as service:
        hip, heat = (Client(service.ports[name]) for name in ("hip", "heat"))
        clients += [hip, heat]
        for client, data in ((hip, b"GET"), (heat, b"GET\0"), (heat, b" GET\r\n")):
            client.send(data)
        clock.advance(10 * MS)
        assert [hip.answer(), heat.answer(), heat.answer()] == [b"nan", b"nan", b"nan"]
        states["hip"].push(-0.5, clock.now())
        states["heat"].push(300, clock.now())
        hip.send(b"GET")
        heat.send(b"GET")
        clock.advance(10 * MS)
        assert [hip.answer(), heat.answer()] == [b"-0.500000", b"300.000000"]
        clock.advance(2000 * MS)
        heat.send(b"GET")
        clock.advance(10 * MS)
        assert heat.answer() == b"nan"
        assert (service.gets, service.junk) == (6, 0)


def test_setting_is_off_unless_it_is_allowed(clients: list[Client]) -> None:
    """Without `allow_set` a `SET` does nothing and is counted; with it the set-point goes down the state's own way."""
    clock = VirtualClock()
    for allowed, wanted in ((False, []), (True, [0.25])):
        states, taken = made_states(clock)
        with UdpStates(states, ["hip", "heat"], clock=clock, first_port=0, allow_set=allowed) as service:
            client, heat = Client(service.ports["hip"]), Client(service.ports["heat"])
            clients += [client, heat]
            client.send(b"SET 0.25")
            heat.send(b"SET 1")
            clock.advance(20 * MS)
            assert taken == wanted
            assert service.sets == 2
            assert service.refused == int(allowed)
            assert [event.detail for event in service.events.last] == (
                ["'heat': state 'heat' is read-only"] if allowed else []
            )


def test_sample_requests_reach_the_device(clients: list[Client]) -> None:
    """`SMP` asks the state for a new sample, and is not answered."""
    clock = VirtualClock()
    states, taken = made_states(clock)
    with UdpStates(states, {"hip": 0}, clock=clock) as service:
        clients.append(Client(service.ports["hip"]))
        clients[0].send(b"SMP")
        clock.advance(20 * MS)
        assert taken == [-1.0]
        assert service.samples == 1


WORDS = [b"", b"get", b"GETS", b"SET", b"SET x", b"SET 1e999999", b"SET nan", b"SET 1_0", b"SET 1 2"]
JUNK = [*WORDS, b"SET " + b"1" * 130, b"GET" + b" " * 126, b"\xff" * 128, b"SMP\x01"]


def test_junk_is_counted_and_not_answered(clients: list[Client]) -> None:
    """Other words, numbers that are none and datagrams that are too long do nothing, and the next request is answered."""
    clock = VirtualClock()
    states, taken = made_states(clock)
    with UdpStates(states, {"hip": 0}, clock=clock, allow_set=True) as service:
        client = Client(service.ports["hip"])
        clients.append(client)
        for data in JUNK:
            client.send(data)
        client.send(b"GET")
        clock.advance(20 * MS)
        assert client.answer() == b"nan"
        assert service.junk == len(JUNK)
        assert taken == []


@given(st.binary(max_size=200))
def test_no_datagram_does_harm(data: bytes) -> None:
    """Whatever comes is one of the three requests or junk; only finite numbers are handed down."""
    clock = VirtualClock()
    states, taken = made_states(clock)
    service = UdpStates(states, {"hip": 0}, clock=clock, allow_set=True)
    answer = service._answer("hip", data)
    clock.advance(MS)
    assert service.gets + service.samples + service.sets + service.junk == 1
    assert (answer is not None) == (service.gets == 1)
    assert len(taken) <= 1


def test_a_flood_costs_one_action(clients: list[Client]) -> None:
    """However many set-points wait, the newest of each state goes down, once."""
    clock = VirtualClock()
    states, taken = made_states(clock)
    with UdpStates(states, {"hip": 0}, clock=clock, allow_set=True) as service:
        client = Client(service.ports["hip"])
        clients.append(client)
        for i in range(30):
            client.send(b"SET %d" % i)
        clock.advance(6 * MS)
        assert taken == [29.0]
        client.send(b"SET 1e300000")
        client.send(b"SET 1e3000")  # a number in its letters, and no finite one
        clock.advance(6 * MS)
        assert taken == [29.0]
        assert service.refused == 1


def test_it_serves_in_real_time_on_a_thread(clients: list[Client]) -> None:
    """Beside a loop it answers by itself, sets on the loop's thread, and ends without a thread left."""
    import threading

    where: list[str] = []
    with Loop("the loop") as loop:
        state = State("hip", clock=loop, setter=lambda _: where.append(threading.current_thread().name))
        state.push(1.0, loop.now())
        with UdpStates({"hip": state}, {"hip": 0}, clock=loop, allow_set=True) as service:
            client = Client(service.ports["hip"])
            clients.append(client)
            assert client.get() == b"1.000000"
            client.send(b"SET 2")
            assert loop.wait(lambda: where == ["the loop"], 5_000 * MS)
    assert not any(thread.name == "udp states" for thread in threading.enumerate())
    service.close()


def test_a_robot_is_driven_through_it(clients: list[Client]) -> None:
    """On a robot a set-point beyond the limits is limited by the device, and the value comes back."""
    with run_virtual(robot_of(ROBOT), [], load=drivers) as run:
        states = {name: run.states[name] for name in ("A.left", "A.right")}
        with UdpStates(states, dict.fromkeys(states, 0), clock=run.clock, allow_set=True) as service:
            left, right = (Client(service.ports[name]) for name in states)
            clients += [left, right]
            left.send(b"SET 1e6")
            right.send(b"SET 100")
            run.clock.wait(lambda: False, 200 * MS)
            left.send(b"GET")
            run.clock.wait(lambda: False, 20 * MS)
            assert float(left.answer()) == pytest.approx(300, abs=0.1)


def test_wrong_calls_are_said(clients: list[Client]) -> None:
    """States, ports and addresses that cannot be are refused; a port that is taken is named."""
    clock = VirtualClock()
    states, _ = made_states(clock)
    with pytest.raises(UnknownNameError, match="hop"):
        UdpStates(states, ["hop"], clock=clock)
    with pytest.raises(CallerError, match="70000 is not a UDP port"):
        UdpStates(states, {"hip": 70_000}, clock=clock)
    with pytest.raises(CallerError, match="two states"):
        UdpStates(states, {"hip": 3000, "heat": 3000}, clock=clock)
    with UdpStates(states, {"hip": 0}, clock=clock) as service:
        port = service.ports["hip"]
        with pytest.raises(CallerError, match=f"UDP port {port} of 127.0.0.1 cannot be had"):
            UdpStates(states, {"heat": port}, clock=clock).open()
    assert UdpStates(states, ["hip", "heat"], clock=clock).ports == {"hip": 2827, "heat": 2828}
