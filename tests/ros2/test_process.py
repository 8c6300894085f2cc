"""`--ros2` beside another process: what that receives, what it costs, and that no other machine is reached."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Generator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import can
import msgspec
import pytest

from aces_bus import load_robot
from aces_bus.errors import CallerError
from aces_bus.robot import run_virtual
from aces_lab.ros2.dds import DdsDomain, configuration
from aces_lab.ros2.messages import JOINT_STATE
from aces_lab.ros2.view import Ros2View
from tests.ros2.domains import DOMAINS
from tests.ros2.peer import JAZZY, LOOPBACK
from tests.ros2.test_commands import Stage, point, trajectory

ROOT = Path(__file__).parents[2]
#: The longest that a process may take (s), on any machine.
WAIT_S = 60.0
#: A user's own configuration, which would reach everyone.
EVERYONE = (
    "<CycloneDDS><Domain><General><AllowMulticast>true</AllowMulticast></General></Domain></CycloneDDS>"
)


@contextmanager
def peer(domain: int, seconds: float, *more: str) -> Generator[subprocess.Popen[str]]:
    """Another process with plain cyclonedds that receives `/joint_states`, or does `more` (see there)."""
    process = subprocess.Popen(
        [sys.executable, "-m", "tests.ros2.peer", str(domain), str(seconds), *more],
        cwd=ROOT,
        env={**os.environ, "CYCLONEDDS_URI": LOOPBACK},
        stdout=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None
    try:
        assert process.stdout.readline() == "ready\n"
        yield process
    finally:
        process.kill()
        process.wait()
        process.stdout.close()


#: Messages at 200 Hz.
NUMBER = 200


def used_by(step: Callable[[], object]) -> float:
    """The share of a core that this process uses while something is done at 200 Hz."""
    used, began = time.process_time(), time.monotonic()
    for index in range(NUMBER):
        step()
        time.sleep(max(0.0, began + (index + 1) / 200 - time.monotonic()))
    return (time.process_time() - used) * 200 / NUMBER


@pytest.mark.slow
def test_joint_states_at_200_hz_reach_another_process() -> None:
    """Hubo's joints, as rosbags writes the same message, for under 5 % of a core."""
    domain = next(DOMAINS)
    with Ros2View(domain, name="hubo") as view, peer(domain, WAIT_S) as process:
        logger = view.states(200, None)
        robot = msgspec.structs.replace(load_robot("hubo2plus"), sensors={})
        run = run_virtual(robot, [], loggers=[logger])
        with run:
            run.start()
            run.clock.wait(lambda: False, 100_000_000)
            assert process.stdout is not None
            os.set_blocking(process.stdout.fileno(), False)
            lines: list[str] = []
            end = time.monotonic() + WAIT_S
            while not lines and time.monotonic() < end:  # until the two have found one another
                logger.step(run.clock.now())
                time.sleep(0.05)
                lines += process.stdout.readlines()
            idle = min(used_by(lambda: None) for _ in range(3))
            share = min(used_by(lambda: logger.step(run.clock.now())) for _ in range(3)) - idle
            while len(lines) < 3 * NUMBER and time.monotonic() < end:
                time.sleep(0.05)
                lines += process.stdout.readlines()
    assert len(lines) >= 3 * NUMBER
    assert view.dropped == 0
    print(f"{100 * share:.1f} % of a core")
    assert share < 0.05
    data = bytes.fromhex(lines[-1])
    read: Any = JAZZY.deserialize_cdr(data, JOINT_STATE)
    assert len(read.name) == 35
    assert bytes(JAZZY.serialize_cdr(read, JOINT_STATE)) == data
    assert dict(zip(read.name, read.position, strict=True))["RHP"] == pytest.approx(0.0, abs=0.01)


@pytest.mark.slow
def test_a_second_writer_of_another_process_is_refused() -> None:
    """While the first one's trajectory is under way; when that ends, the other's commands are carried out."""
    stage = Stage()
    try:
        stage.trajectory(trajectory(["HIP"], point(590.0, [0.5])))
        stage.wait(0.1)
        with peer(stage.view.dds.domain, WAIT_S, "command", "HIP", "-0.5"):
            end = time.monotonic() + WAIT_S
            while not stage.said and time.monotonic() < end:
                stage.wait(0.05)
                time.sleep(0.02)
            assert "another writer commands; its motion must end first" in stage.said[0]
            stage.wait(0.5)
            assert stage.commands.taken == 1
            assert stage.position("HIP") > -0.01
            stage.trajectory(trajectory([]))
            while stage.position("HIP") > -0.49 and time.monotonic() < end:
                stage.wait(0.02)
                time.sleep(0.02)
            assert stage.position("HIP") == pytest.approx(-0.5, abs=0.01)
    finally:
        stage.close()


@pytest.mark.slow
def test_sniff_publishes_what_it_decodes(tmp_path: Path) -> None:
    """`aces sniff --ros2` end to end: another process has the newest record of a bus among the diagnostics."""
    domain = next(DOMAINS)
    bus = "unix:" + str(tmp_path / "can.sock")
    aces = [sys.executable, "-m", "aces_tools"]
    words = [
        "sniff",
        "-i",
        "aces",
        "-c",
        bus,
        "-p",
        "hubo:D12@hubo2plus",
        "-q",
        "--ros2",
        "--domain",
        str(domain),
    ]
    kind = "diagnostic_msgs/msg/DiagnosticArray"
    with ExitStack() as stack:

        def begin(*more: str) -> None:
            process = subprocess.Popen([*aces, *more], stdout=subprocess.DEVNULL)
            stack.callback(process.wait)
            stack.callback(process.kill)

        begin("bus", "serve", "can0", "--unix", str(tmp_path / "can.sock"))
        end = time.monotonic() + WAIT_S
        while not (tmp_path / "can.sock").exists() and time.monotonic() < end:
            time.sleep(0.05)
        begin(*words)
        process = stack.enter_context(peer(domain, WAIT_S, "/diagnostics", kind))
        assert process.stdout is not None
        found: list[Any] = []
        with can.Bus(interface="aces", channel=bus) as ours:
            os.set_blocking(process.stdout.fileno(), False)
            while not found and time.monotonic() < end:
                ours.send(
                    can.Message(
                        arbitration_id=0x063, data=bytes.fromhex("78000000FCFFFFFF"), is_extended_id=False
                    )
                )
                time.sleep(0.05)
                for line in process.stdout.readlines():
                    message: Any = JAZZY.deserialize_cdr(bytes.fromhex(line), kind)
                    found += [status for status in message.status if "Encoder 063" in status.name]
    status = found[0]
    assert {pair.key: pair.value for pair in status.values} == {"board": "3", "position": "(120, -4)"}
    assert "received" in status.message


@pytest.mark.slow
def test_nothing_is_seen_on_other_interfaces(tmp_path: Path) -> None:
    """Whatever CYCLONEDDS_URI says: not a packet leaves by another interface than loopback."""
    try:
        listener = socket.socket(socket.AF_PACKET, socket.SOCK_RAW, socket.htons(0x0003))
    except PermissionError:
        pytest.skip("this user may not look at packets")
    domain = next(DOMAINS)
    ports = range(7400 + 250 * domain, 7650 + 250 * domain)
    seen: list[str] = []
    inside = 0
    with listener:
        listener.settimeout(0.2)
        process = subprocess.Popen(
            [
                *(sys.executable, "-m", "aces_tools", "run", "-r", "minihubo_1", "--virtual", "--real-time"),
                *("--for", "3s", "-q", "--ros2", "--ros2-commands", "--domain", str(domain)),
            ],
            env={**os.environ, "CYCLONEDDS_URI": EVERYONE},
            cwd=tmp_path,
            stderr=subprocess.DEVNULL,
        )
        try:
            while process.poll() is None:
                try:
                    data, (interface, *_) = listener.recvfrom(4096)
                except TimeoutError:
                    continue
                if len(data) > 38 and data[12:14] == b"\x08\x00" and data[23] == 17:
                    at = 14 + 4 * (data[14] & 15)
                    port = int.from_bytes(data[at + 2 : at + 4])
                    if port in ports and interface != "lo":
                        seen.append(f"{interface}: {socket.inet_ntoa(data[30:34])}:{port}")
                    inside += port in ports
        finally:
            process.kill()
            process.wait()
    assert process.returncode == 0
    assert inside > 0
    assert seen == []


def test_other_machines_are_kept_out(monkeypatch: pytest.MonkeyPatch) -> None:
    """Sockets that are bound to all addresses receive from loopback alone; no group is joined."""
    monkeypatch.setenv("CYCLONEDDS_URI", EVERYONE)
    groups = Path("/proc/self/net/igmp").read_text()
    number = next(DOMAINS)
    ports = range(7400 + 250 * number, 7650 + 250 * number)
    domain = DdsDomain(number)
    found = []
    try:
        for file in os.listdir("/proc/self/fd"):
            try:
                with socket.socket(fileno=os.dup(int(file))) as one:
                    address = one.getsockname()
                    if one.family == socket.AF_INET and address[1] in ports:
                        device = one.getsockopt(socket.SOL_SOCKET, socket.SO_BINDTODEVICE, 16)
                        found.append((address[0], device.rstrip(b"\0")))
            except OSError:
                continue
        assert Path("/proc/self/net/igmp").read_text() == groups
    finally:
        domain.close()
    assert found == 2 * [("0.0.0.0", b"lo")]


def test_a_domain_whose_sockets_cannot_be_bound_is_not_opened(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where the system does not allow it, nothing is opened."""
    monkeypatch.setattr("aces_lab.ros2.dds._sockets", lambda: iter(()))
    with pytest.raises(CallerError, match="cannot be bound to lo"):
        DdsDomain(next(DOMAINS))


def test_another_interface_is_used_when_it_is_named() -> None:
    """With its peers, and no multicast either; names cannot smuggle anything in."""
    text = configuration("eth0", ["10.0.0.2", "robot.local"])
    assert '<NetworkInterface name="eth0" multicast="false"/>' in text
    assert '<Peer address="10.0.0.2"/><Peer address="robot.local"/>' in text
    assert "127.0.0.1" not in text
    assert "<b" not in configuration("<b", ["<b"]).replace("&lt;b", "")


def test_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where cyclonedds is missing."""
    monkeypatch.setitem(sys.modules, "cyclonedds.core", None)
    with pytest.raises(CallerError, match=r"pip install 'aces-bus\[ros2\]'"):
        DdsDomain(0)
