"""Nothing beyond this machine unasked: the sockets that every verb opens, as the system has them.

1. Each verb that can open anything runs as a process. An audit hook notes every bind, connect and sendto of Python code,
   also of what lasts a moment; what libraries open by themselves (foxglove-sdk, zenoh) is found under /proc meanwhile.
2. Allowed without being asked for: loopback addresses, and Unix sockets that only their owner reaches.
"""

from __future__ import annotations

import ipaddress
import json
import os
import re
import signal
import socket
import stat
import subprocess
import sys
import threading
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import pytest

from tests.access.viewing import WAIT_S, free_port

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(sys.platform != "linux", reason="reads /proc"),
]

HUBO = str(Path(__file__).parents[2] / "examples" / "captures" / "hubo2plus.log")
#: What Python code does with sockets is noted in the file of this variable.
NOTE = "ACES_TEST_SOCKETS"
HOOK = f"""
import os, sys
path = os.environ.get({NOTE!r})
if path:
    def note(event, arguments):
        if event in ("socket.bind", "socket.connect", "socket.sendto"):
            place = arguments[1]
            with open(path, "a") as file:
                file.write(repr((event, list(place) if isinstance(place, tuple) else os.fsdecode(place))) + "\\n")
    sys.addaudithook(note)
"""


@dataclass(frozen=True)
class Case:
    """A call of `aces`, and the line after which it is looked at; "": it ends by itself. `program`: Python code instead."""

    words: tuple[str, ...]
    ready: str = ""
    program: str = ""


PORT = "{port}"
BUS = ("-i", "aces", "-c", "unix:audit")
CASES = {
    "bus serve": Case(("bus", "serve", "other"), "other"),
    "bus serve --socketcand": Case(("bus", "serve", "other", "--socketcand", "127.0.0.1:" + PORT), "other"),
    "bus list": Case(("bus", "list")),
    "bus load": Case(("bus", "load", "audit", "--once")),
    "sniff": Case(("sniff", *BUS), "runs until"),
    "sniff --foxglove": Case(("sniff", *BUS, "-p", "hubo", "--foxglove", PORT), "runs until"),
    "sniff --udp": Case(("sniff", "--udp", PORT, "-p", "hubovia"), "runs until"),
    "sim, CAN": Case(("sim", "-r", "hubo2plus", "--foxglove", PORT), "devices are there"),
    "sim, serial": Case(("sim", "-r", "minihubo_1"), "devices are there"),
    "sim, datagrams": Case(("sim", "-r", "hubovia"), "devices are there"),
    "sim --foxglove": Case(("sim", "-r", "minihubo_1", "--foxglove", PORT), "devices are there"),
    "run --virtual": Case(
        ("run", "-r", "minihubo_1", "--virtual", "--log", "{folder}/a.csv:LKP", "--for", "1s")
    ),
    "run --virtual --foxglove": Case(
        ("run", "-r", "minihubo_1", "--virtual", "--real-time", "--foxglove", PORT), "runs until its"
    ),
    "run, a bus": Case(
        (
            "run",
            "-r",
            "hubo2plus",
            "--bus",
            "lower=unix:audit",
            "--bus",
            "upper=unix:audit2",
            "--foxglove",
            PORT,
        ),
        "runs until its",
    ),
    "run, datagrams": Case(("run", "-r", "hubovia", "--foxglove", PORT), "runs until its"),
    "play --tx": Case(("play", HUBO, *BUS, "--tx", "--speed", "max")),
    "play --foxglove": Case(("play", HUBO, "-p", "hubo", "--foxglove", PORT, "--loop", "0"), "live view"),
    "send": Case(("send", "123#00", *BUS, "--tx")),
    "bridge": Case(("bridge", "unix:audit", "unix:audit2", "--tx", "--for", "1s")),
    "discover": Case(("discover", "--bus", "unix:audit", "-p", "hubo", "-q")),
    "device": Case(
        (
            "device",
            "JMC3",
            "get",
            "-r",
            "hubo2plus",
            "--bus",
            "lower=unix:audit",
            "--bus",
            "upper=unix:audit2",
        )
    ),
    "fuzz": Case(("fuzz", "hubovia", "--examples", "20", "--jobs", "2")),
    "decode --jobs": Case(("decode", HUBO, "-p", "hubo", "--jobs", "2", "-o", "{folder}/a.parquet")),
    "demo": Case(("demo",)),
    "UdpStates": Case(
        (),
        "ready",
        """
from aces_bus.access import UdpStates
from aces_bus.runtime import VirtualClock
from aces_bus.state import State
clock = VirtualClock()
with UdpStates({"RHY": State("RHY", clock=clock)}, ["RHY"], clock=clock):
    print("ready", flush=True)
    input()
""",
    ),
    "zenoh": Case(
        (),
        "ready",
        """
from aces_lab.zenoh import Publisher
from aces_bus.runtime import RealClock
from aces_bus.state import State
one = Publisher(["RHY"], 100, "tcp/127.0.0.1:{port}", robot="audit", clock=RealClock())
one.bind({{"RHY": State("RHY", clock=RealClock())}})
with one:
    print("ready", flush=True)
    input()
""",
    ),
}


@pytest.fixture(scope="module")
def surroundings(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, str]]:
    """The environment of the verbs: a folder for sockets of theirs, the hook, and two buses that are served."""
    folder = tmp_path_factory.mktemp("audit")
    (folder / "sitecustomize.py").write_text(HOOK)
    (folder / "run").mkdir(mode=0o700)
    given = {
        **os.environ,
        "PYTHONPATH": os.pathsep.join([str(folder), os.environ.get("PYTHONPATH", "")]),
        "XDG_RUNTIME_DIR": str(folder / "run"),
    }
    words = [sys.executable, "-m", "aces_tools", "bus", "serve", "audit", "audit2", "-b", "1000000"]
    server = subprocess.Popen(words, env=given, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        waited(server, "audit")
        yield given
    finally:
        server.send_signal(signal.SIGINT)
        server.wait(WAIT_S)  # the threads of `waited` read what it says


def waited(process: subprocess.Popen[str], ready: str) -> list[str]:
    """Read both outputs on threads; returns when a line matches, with what was said so far."""
    said: list[str] = []
    is_ready = threading.Event()

    def read(stream: object) -> None:
        for line in stream:  # type: ignore[attr-defined]
            said.append(line)
            if re.search(ready, line):
                is_ready.set()

    threads = [
        threading.Thread(target=read, args=(s,), daemon=True) for s in (process.stdout, process.stderr)
    ]
    for thread in threads:
        thread.start()
    for _ in range(600):
        if is_ready.wait(0.1):
            return said
        assert process.poll() is None, said
    raise AssertionError(said)


# ---------------------------------------------------------------------- what the system knows


def family_of(pid: int) -> list[int]:
    """A process and its children, and theirs."""
    found = [pid]
    for one in found:
        for task in Path(f"/proc/{one}/task").glob("*/children"):
            found += map(int, task.read_text().split())
    return found


def sockets_of(pids: Sequence[int]) -> set[int]:
    """The inodes of the sockets that processes have."""
    found: set[int] = set()
    for pid in pids:
        for file in Path(f"/proc/{pid}/fd").iterdir():
            try:
                name = os.readlink(file)
            except OSError:
                continue
            if name.startswith("socket:["):
                found.add(int(name[8:-1]))
    return found


def address(text: str) -> tuple[str, int]:
    """`0100007F:2242` as 127.0.0.1, 8770; IPv6 likewise, by words of the machine's order."""
    host, _, port = text.partition(":")
    words = [bytes.fromhex(host[at : at + 8])[::-1] for at in range(0, len(host), 8)]
    return str(ipaddress.ip_address(b"".join(words))), int(port, 16)


def is_ours(host: str) -> bool:
    """Whether an address is of this machine alone."""
    if host in ("localhost", ""):
        return host == "localhost"
    found = ipaddress.ip_address(host.partition("%")[0])
    mapped = getattr(found, "ipv4_mapped", None)
    return (mapped or found).is_loopback


def faults_of(pid: int) -> list[str]:
    """What a process and its children have open beyond this machine, or for others on it."""
    mine = sockets_of(family_of(pid))
    faults: list[str] = []
    known: set[int] = set()
    for kind in ("tcp", "tcp6", "udp", "udp6"):
        for line in Path(f"/proc/{pid}/net/{kind}").read_text().splitlines()[1:]:
            parts = line.split()
            if int(parts[9]) not in mine:
                continue
            known.add(int(parts[9]))
            (host, port), (far, _) = address(parts[1]), address(parts[2])
            is_connected = not ipaddress.ip_address(far).is_unspecified
            if (port and not is_ours(host)) or (is_connected and not is_ours(far)):
                faults.append(f"{kind} {host}:{port} to {far}")
    for line in Path(f"/proc/{pid}/net/unix").read_text().splitlines()[1:]:
        parts = line.split(None, 7)
        if int(parts[6]) not in mine:
            continue
        known.add(int(parts[6]))
        path = parts[7] if len(parts) > 7 else ""
        if path.startswith("@"):
            faults.append(f"the abstract Unix socket {path}, which everybody reaches")
        elif path:
            faults += faults_of_path(path)
    for kind in ("raw", "raw6", "packet"):
        for line in Path(f"/proc/{pid}/net/{kind}").read_text().splitlines()[1:]:
            faults += [
                f"a socket of kind {kind}" for word in line.split() if word.isdecimal() and int(word) in mine
            ]
    return faults


def faults_of_path(path: str) -> list[str]:
    """Whether others than its owner reach a Unix socket: by its own mode, or that of a folder above it."""
    there = Path(path)
    if not there.exists() or not stat.S_IMODE(there.stat().st_mode) & 0o077:
        return []
    if not stat.S_IMODE(there.parent.stat().st_mode) & 0o077:
        return []
    return [f"the Unix socket {path} of mode {stat.S_IMODE(there.stat().st_mode):o}"]


def memberships() -> set[str]:
    """The multicast groups that this machine's programs have joined, IPv4 and IPv6."""
    found = {
        line.split()[0]
        for line in Path("/proc/net/igmp").read_text().splitlines()[1:]
        if line.startswith("\t")
    }
    igmp6 = Path("/proc/net/igmp6")
    return found | {line.split()[2] for line in igmp6.read_text().splitlines()} if igmp6.exists() else found


def faults_of_notes(path: Path) -> list[str]:
    """What Python code bound, or sent to, beyond this machine."""
    faults: list[str] = []
    for line in path.read_text().splitlines() if path.exists() else ():
        event, place = eval(line)
        if isinstance(place, str):
            if event == "socket.bind" and (not place or place.startswith("\0")):
                faults.append(f"{event} {place!r}")
        elif not is_ours(str(place[0])):
            faults.append(f"{event} {place}")
    return faults


# ---------------------------------------------------------------------- the tests


def test_the_audit_finds_what_it_is_for(surroundings: dict[str, str], tmp_path: Path) -> None:
    """A socket at 0.0.0.0, a multicast group, a Unix socket of everybody: each is found."""
    program = f"""
import os, socket
one = socket.create_server(("0.0.0.0", 0))
os.umask(0)
two = socket.socket(socket.AF_UNIX); two.bind({str(tmp_path / "all")!r})
three = socket.socket(socket.AF_UNIX); three.bind("\\0aces-{os.getpid()}")
print("ready", flush=True)
input()
"""
    tmp_path.chmod(0o755)
    note = tmp_path / "note"
    process = start([sys.executable, "-c", program], {**surroundings, NOTE: str(note)})
    try:
        waited(process, "ready")
        found = " ".join(faults_of(process.pid))
    finally:
        process.kill()
    assert "tcp 0.0.0.0:" in found
    assert "of mode 777" in found
    assert "abstract" in found
    assert len(faults_of_notes(note)) == 2


def start(
    words: Sequence[str], environment: dict[str, str], folder: Path | None = None
) -> subprocess.Popen[str]:
    """A process whose input stays open."""
    pipe = subprocess.PIPE
    return subprocess.Popen(
        words, env=environment, cwd=folder, stdin=pipe, stdout=pipe, stderr=pipe, text=True
    )


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_nothing_beyond_this_machine(name: str, surroundings: dict[str, str], tmp_path: Path) -> None:
    """Neither listening nor sending, no group joined, no Unix socket that others reach."""
    case = CASES[name]
    if "--foxglove" in case.words:
        pytest.importorskip("foxglove")
    if name == "zenoh":
        pytest.importorskip("zenoh")
    port = str(free_port())
    words = [word.replace(PORT, port).replace("{folder}", str(tmp_path)) for word in case.words]
    note, before = tmp_path / "note", memberships()
    command = ["-c", case.program.format(port=port)] if name == "zenoh" else ["-c", case.program]
    process = start(
        [sys.executable, *(command if case.program else ["-m", "aces_tools", *words])],
        {**surroundings, NOTE: str(note)},
        tmp_path,
    )
    said: object = None
    try:
        if case.ready:
            said = waited(process, case.ready)
            faults = faults_of(process.pid)
            if "--foxglove" in words:  # the gate, and the server behind it
                assert len([one for one in json.loads(listening(process.pid)) if one]) >= 2
            assert memberships() <= before
            process.send_signal(signal.SIGINT)
            process.wait(WAIT_S)
        else:
            said = process.communicate(timeout=2 * WAIT_S)
            faults = []
    finally:
        process.kill()
        process.wait()
    assert faults + faults_of_notes(note) == [], said
    if not case.program:
        assert process.returncode in (0, 1, 130), said


def listening(pid: int) -> str:
    """The addresses at which a process listens, as JSON."""
    mine = sockets_of(family_of(pid))
    lines = [line.split() for line in Path(f"/proc/{pid}/net/tcp").read_text().splitlines()[1:]]
    return json.dumps([address(one[1])[0] for one in lines if one[3] == "0A" and int(one[9]) in mine])


def test_addresses_are_read_as_the_system_writes_them() -> None:
    """Both families; little and big ends by words."""
    if sys.byteorder == "little":
        assert address("0100007F:223D") == ("127.0.0.1", 8765)
        assert address("00000000000000000000000001000000:0050") == ("::1", 80)
    assert is_ours("127.9.8.7")
    assert is_ours("::ffff:127.0.0.1")
    assert not is_ours("0.0.0.0")
    assert not is_ours("::")
    assert not is_ours(socket.inet_ntoa(b"\xe0\0\0\x01"))
