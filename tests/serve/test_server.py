"""The socket of a served robot: hostile bytes, refusals by name, clients that die; the run goes on in virtual time."""

from __future__ import annotations

import json
import os
import random
import socket
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from aces_bus.errors import CallerError
from aces_bus.robot import Runner, parse_robot, run_virtual
from aces_lab.serve import messages
from aces_lab.serve.desk import Desk
from aces_lab.serve.messages import MOST_BYTES, socket_path
from aces_lab.serve.server import MOST_CLIENTS, RobotServer
from tests.serve.test_desk import MS, WHOLE

#: An answer, as JSON has it.
Answered = dict[str, Any]


class Served:
    """A leg in virtual time, and its server."""

    def __init__(self, run: Runner, desk: Desk, server: RobotServer) -> None:
        self.run, self.desk, self.server = run, desk, server
        self.streams: list[socket.socket] = []

    def let_pass(self, ms: int = 1) -> None:
        for _ in range(ms):
            self.run.clock.wait(lambda: False, MS)
            self.server.poll(self.run.rig)

    def connect(self, name: str = "") -> socket.socket:
        stream = socket.socket(socket.AF_UNIX)
        self.streams.append(stream)
        stream.connect(self.server.path)
        stream.setblocking(False)
        if name:
            assert "ok" in self.ask(stream, do="attach", name=name)
        return stream

    def send(self, stream: socket.socket, data: bytes) -> list[Answered]:
        """All answers that come within 20 ms."""
        stream.sendall(data)
        self.let_pass(20)
        return self.answers(stream)

    @staticmethod
    def answers(stream: socket.socket) -> list[Answered]:
        try:
            return [json.loads(line) for line in stream.recv(1 << 20).splitlines()]
        except (BlockingIOError, ConnectionError):
            return []

    def ask(self, stream: socket.socket, **message: object) -> Answered:
        (answer,) = self.send(stream, json.dumps(message).encode() + b"\n")
        return answer


@pytest.fixture
def served(tmp_path: Path) -> Iterator[Served]:
    robot, problems = parse_robot(WHOLE)
    assert robot is not None, problems
    desk = Desk(robot, rate_hz=200)
    server = RobotServer(tmp_path / "leg.sock", desk, drives=True)
    with run_virtual(robot, [desk]) as run:
        run.do("enable")
        run.start()
        made = Served(run, desk, server)
        made.let_pass(20)
        yield made
        server.close()
        run.stop()
        for stream in made.streams:
            stream.close()


def test_two_clients_hand_over(served: Served) -> None:
    """A second owner is refused by name; the joint keeps its set-point over the change."""
    wave, grasp = served.connect("wave"), served.connect("grasp")
    assert served.ask(wave, do="own", joints=["HIP"]) == {"ok": True}
    assert "HIP is owned by wave" in served.ask(grasp, do="own", joints=["HIP"])["error"]
    assert (
        "another client is attached as wave"
        in served.ask(served.connect(), do="attach", name="wave")["error"]
    )
    served.ask(wave, do="set", values={"HIP": 0.2})
    served.let_pass(300)
    asked = {"do": "hand_over", "owner": "wave", "joints": ["HIP"]}
    assert "'grab' is not attached (there are: wave, grasp)" in served.ask(wave, **asked, to="grab")["error"]
    assert served.ask(served.connect(), **asked, to="grasp") == {"ok": ["HIP"]}
    status = served.ask(grasp, do="status")["ok"]
    assert status["clients"] == ["wave", "grasp"]
    assert status["joints"]["HIP"] == {
        "owner": "grasp",
        "enabled": True,
        "wanted": 0.2,
        "measured": pytest.approx(0.2, abs=0.01),
    }
    assert served.ask(grasp, do="read", names=["HIP2.position"])["ok"]["HIP2.position"] == pytest.approx(
        0.2, abs=0.01
    )
    assert "HIP" in served.ask(grasp, do="read", names=["HIPS"])["error"]


def test_one_that_dies_is_missed_at_once(served: Served) -> None:
    """Its joints stand still and are free; its name, too."""
    wave = served.connect("wave")
    served.ask(wave, do="own", joints=["HIP"])
    served.ask(wave, do="set", values={"HIP": 0.9})
    wave.close()
    served.let_pass(5)
    assert served.desk.owners == {}
    grasp = served.connect("wave")
    assert served.ask(grasp, do="own", joints=["HIP"]) == {"ok": True}
    assert served.desk.wanted["HIP"] < 0.5


@pytest.mark.slow
def test_stop_and_enable_again(served: Served) -> None:
    """A client without a name stops all devices; owners are free; joints are off until they are enabled again."""
    wave = served.connect("wave")
    served.ask(wave, do="own", joints=["KNEE"])
    served.ask(wave, do="set", values={"KNEE": 0.3})
    looker = served.connect()
    looker.sendall(b'{"do": "stop"}\n')
    served.let_pass(200)
    assert served.answers(looker) == [{"ok": True}]
    twins = served.run.world.twins
    assert not twins["JMC1"].channels[0].control_on
    assert "owned by nobody" in served.ask(wave, do="set", values={"KNEE": 0.3})["error"]
    assert "own the joints that are to be enabled first" in served.ask(wave, do="enable")["error"]
    served.ask(wave, do="own", joints=["KNEE"])
    assert "KNEE is not enabled" in served.ask(wave, do="set", values={"KNEE": 0.3})["error"]
    wave.sendall(b'{"do": "enable"}\n{"do": "set", "values": {"KNEE": 0.2}}\n')
    served.let_pass(1500)
    assert served.answers(wave) == [{"ok": True}, {"ok": True}]
    assert twins["JMC1"].channels[0].control_on
    assert not twins["JMC0"].channels[0].control_on
    assert served.run.stopped == {}


def test_a_board_of_two_joints_is_enabled_by_who_owns_both(served: Served) -> None:
    """Or whose neighbour nobody owns."""
    wave, grasp = served.connect("wave"), served.connect("grasp")
    served.ask(wave, do="own", joints=["HIP"])
    served.ask(grasp, do="own", joints=["ROLL"])
    assert "HIP is owned by wave, and would be enabled, too" in served.ask(grasp, do="enable")["error"]


def test_parking(served: Served) -> None:
    """By any client; the joints stay enabled in the pose."""
    looker = served.connect()
    assert served.ask(looker, do="park") == {"ok": ["HIP", "ROLL"]}
    served.let_pass(800)
    assert served.run.states["HIP"].last == pytest.approx(0.5, abs=0.01)
    assert served.desk.owners == {}


HOSTILE = (
    b"\n\n   \n",
    b"\x00\xff\xfe\n",
    b"{}\n",
    b"[]\n",
    b'{"do": "explode"}\n',
    b'{"do": "set"}\n',
    b'{"do": "set", "values": {"HIP": NaN}}\n',
    b'{"do": "set", "values": {"HIP": 1e999}}\n',
    b'{"do": "set", "values": {"HIP": "0.5"}}\n',
    b'{"do": "set", "values": {"HIP": 0.5}, "run": "import os"}\n',
    b'{"do": "own", "joints": [["HIP"]]}\n',
    b'{"do": "attach", "name": "\\u001b[2J"}\n',
    b'{"do": "attach", "name": "parking"}\n',
    b'{"do": "attach", "name": "' + b"x" * 65 + b'"}\n',
    b"[" * 50_000 + b"\n",
    b'{"do": "status", "x": ' + b"[" * 20_000 + b"\n",
    b"x" * (3 * MOST_BYTES) + b"\n",
    b'{"do": "own", "joints": ["HIP"]}\n',
    b'{"do": "enable"}\n',
    b'{"do": "hand_over", "owner": "wave", "to": "nobody"}\n',
    b'{"do": "free", "joints": ["HIP"]}\n',
)


def test_hostile_bytes_cost_one_error(served: Served) -> None:
    """Each bad line gets one error, which is one printable line; the client, the others and the robot go on."""
    wave, other = served.connect("wave"), served.connect()
    served.ask(wave, do="own", joints=["HIP"])
    for data in HOSTILE:
        other.setblocking(True)
        sent = 0
        while sent < len(data):  # as much as a poll takes
            sent += other.send(data[sent : sent + 50_000])
            served.let_pass()
        other.setblocking(False)
        served.let_pass(5)
        answers = served.answers(other)
        assert len(answers) == (1 if data.strip() else 0), data[:50]
        for answer in answers:
            assert answer["error"].isprintable(), data[:50]
        served.ask(wave, do="set", values={"HIP": 0.1})
    assert served.ask(other, do="status")["ok"]["joints"]["HIP"]["owner"] == "wave"
    assert served.run.stopped == {}


def test_random_bytes_never_reach_the_robot(served: Served) -> None:
    """Messages that were changed at random, and noise: whatever they are, only errors, or what a right message does."""
    chance = random.Random(7)
    wave = served.connect("wave")
    served.ask(wave, do="own", joints=["HIP"])
    noise = served.connect("noise")
    good = [
        b'{"do": "set", "values": {"KNEE": 0.5}}',
        b'{"do": "own", "joints": ["HIP"]}',
        b'{"do": "status"}',
    ]
    for number in range(200):
        line = bytearray(chance.choice(good))
        for _ in range(chance.randrange(1, 6)):
            line[chance.randrange(len(line))] = chance.randrange(256)
        try:
            noise.sendall(bytes(line) + b"\n")
        except BlockingIOError:
            pass
        if number % 20 == 0:
            served.ask(wave, do="set", values={"HIP": 0.1})
        served.answers(noise)
    assert served.desk.owners["HIP"] == "wave"
    assert served.run.stopped == {}


@pytest.mark.slow
def test_one_that_does_not_read_waits(served: Served) -> None:
    """Its requests wait in its own socket; nothing is gathered for it without end, and others are served."""
    lazy = served.connect()
    lazy.setblocking(False)
    sent = 0
    for _ in range(2000):
        try:
            sent += lazy.send(b'{"do": "status"}\n' * 100)
        except BlockingIOError:
            pass
        served.let_pass()
    (client,) = served.server.clients
    assert len(client.unsent) + len(client.received) < 4 * MOST_BYTES
    assert sent < 1 << 22
    assert "ok" in served.ask(served.connect(), do="status")


def test_clients_are_counted(served: Served) -> None:
    """One too many is refused with the reason."""
    for _ in range(MOST_CLIENTS):
        served.connect()
        served.let_pass()
    late = served.connect()
    served.let_pass(2)
    assert served.answers(late) == [{"error": f"{MOST_CLIENTS} clients are connected already"}]
    served.streams[0].close()
    served.let_pass(2)
    assert "ok" in served.ask(served.connect(), do="status")


def test_another_user_is_refused(served: Served, monkeypatch: pytest.MonkeyPatch) -> None:
    """The peer's uid is checked, whatever the file's mode is."""
    monkeypatch.setattr(messages, "peer_user", lambda stream: os.getuid() + 1)
    stranger = served.connect()
    served.let_pass(2)
    assert served.answers(stranger) == [{"error": f"this robot is served for user {os.getuid()} only"}]
    assert served.server.clients == []


def test_without_tx_nothing_is_enabled_or_stopped(tmp_path: Path) -> None:
    """The server says that it transmits nothing."""
    robot, _ = parse_robot(WHOLE)
    assert robot is not None
    desk = Desk(robot, rate_hz=200)
    with run_virtual(robot, [desk], drives=False) as run:
        run.start()
        server = RobotServer(tmp_path / "leg.sock", desk, drives=False)
        made = Served(run, desk, server)
        client = made.connect("wave")
        made.ask(client, do="own", joints=["HIP"])
        for word in ("enable", "stop"):
            assert "transmits nothing: start it with --tx" in made.ask(client, do=word)["error"]
        client.close()
        server.close()


def test_a_robot_is_served_once(tmp_path: Path) -> None:
    """A second server is refused; what a killed one has left is taken away."""
    robot, _ = parse_robot(WHOLE)
    assert robot is not None
    path = tmp_path / "leg.sock"
    left = socket.socket(socket.AF_UNIX)
    left.bind(str(path))
    left.close()
    server = RobotServer(path, Desk(robot, rate_hz=100), drives=False)
    with pytest.raises(CallerError, match="it is served already"):
        RobotServer(path, Desk(robot, rate_hz=100), drives=False)
    server.close()
    assert not path.exists()


def test_where_the_socket_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In a folder 0700 below XDG_RUNTIME_DIR; anything else is refused with what to do."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    path = socket_path("leg")
    assert path == tmp_path / "aces-robots" / "leg.sock"
    assert path.parent.stat().st_mode & 0o777 == 0o700
    path.parent.chmod(0o750)
    with pytest.raises(CallerError, match="not a folder of this user alone"):
        socket_path("leg")
    path.parent.chmod(0o700)
    for name in ("", "../leg", ".leg", "a\nb"):
        with pytest.raises(CallerError, match="cannot be the name of a socket"):
            socket_path(name)
    with pytest.raises(CallerError, match="longer than the 107 bytes"):
        socket_path("l" * 100)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path / "gone"))
    with pytest.raises(CallerError, match="No such file"):
        socket_path("leg")
    monkeypatch.setenv("XDG_RUNTIME_DIR", "/tmp")
    with pytest.raises(CallerError, match="not a folder of this user alone"):
        socket_path("leg")
    monkeypatch.delenv("XDG_RUNTIME_DIR")
    with pytest.raises(CallerError, match="XDG_RUNTIME_DIR is not set"):
        socket_path("leg")
