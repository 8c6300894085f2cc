"""A virtual bus across processes: what joins it, what ends, and what bad clients can and cannot do."""

from __future__ import annotations

import os
import shutil
import socket
import stat
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import can
import pytest
from hypothesis import given
from hypothesis import strategies as st

from aces_bus.errors import CallerError
from aces_bus.frame import FD_LENGTHS, Frame
from aces_bus.hardware import served
from aces_bus.hardware.can import CanGate
from aces_bus.hardware.faults import Faults
from aces_bus.hardware.frame_time import INTERMISSION, frame_bits
from aces_bus.hardware.served import BusServer, ServedBus, ServedChannel, packets
from aces_bus.hardware.served import channel as channel_module
from aces_bus.hardware.served import server as server_module
from aces_bus.hardware.served.address import parse_address, parse_host
from aces_bus.hardware.served.stream import Stream

pytestmark = pytest.mark.skipif(not hasattr(socket, "AF_UNIX"), reason="no Unix sockets on this system")

#: How long anything may take here, in seconds; reached only when something is broken.
PATIENCE = 10.0


@pytest.fixture(autouse=True)
def runtime(monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A runtime folder of the test's own, with a short path."""
    folder = Path(tempfile.mkdtemp(prefix="aces"))
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(folder))
    yield folder
    shutil.rmtree(folder, ignore_errors=True)


Open = Callable[..., ServedBus]


@pytest.fixture
def opened() -> Iterator[Open]:
    """Opens clients and closes them at the end."""
    with ExitStack() as stack:

        def open_bus(channel: str = "unix:can0", **more: Any) -> ServedBus:
            bus = can.Bus(channel, "aces", **more)
            assert isinstance(bus, ServedBus)
            return stack.enter_context(bus)

        yield open_bus


def serve(*channels: ServedChannel, **more: Any) -> BusServer:
    """A server of these channels; by default one at 1 Mbit/s."""
    return BusServer(channels or [ServedChannel(bitrate=1_000_000)], **more)


def message(identifier: int, data: bytes = b"", **more: Any) -> can.Message:
    more.setdefault("is_extended_id", False)
    return can.Message(arbitration_id=identifier, data=data, **more)


def received(bus: can.BusABC, count: int = 1) -> list[can.Message]:
    """The next messages; fails when they do not come."""
    found = []
    for _ in range(count):
        got = bus.recv(PATIENCE)
        assert got is not None
        found.append(got)
    return found


def until(condition: Callable[[], bool]) -> None:
    """Ask until it holds."""
    end = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < end
        threading.Event().wait(0.002)


MESSAGES = [
    message(0x123, b"\x01\x02\x03"),
    message(0x1ABCDEF0, bytes(range(8)), is_extended_id=True),
    message(0x7FF),
    message(0x10, is_remote_frame=True, dlc=5),
    message(0x11, bytes(range(48)), is_fd=True, bitrate_switch=True),
    message(0x12, b"\x01", is_fd=True, error_state_indicator=True),
]


@pytest.mark.parametrize("physics", [True, False])
@pytest.mark.parametrize("link", [0, 1], ids=["unix", "tcp"])
def test_everything_that_a_message_carries_arrives(opened: Open, physics: bool, link: int) -> None:
    """Over either kind of socket, with and without physics, and every receiver has its own copy."""
    channel = ServedChannel("can0", bitrate=1_000_000, data_bitrate=4_000_000, fd=True, physics=physics)
    with serve(channel, unix="", tcp=("127.0.0.1", 0)) as server:
        address = server.addresses["can0"][link]
        sender, one, two = (opened(address, fd=True) for _ in range(3))
        for sent in MESSAGES:
            sender.send(sent)
            for receiver in (one, two):
                (got,) = received(receiver)
                assert got.equals(sent, timestamp_delta=None, check_channel=False, check_direction=False)
                assert (got.channel, got.is_rx) == (address, True)
                assert abs(got.timestamp - time.time()) < PATIENCE
        assert sender.recv(0) is None


def test_the_bus_decides_who_goes_first(opened: Open) -> None:
    """What waits is sent by identifier, and stamps are the frames' ends on the wire, to the bit."""
    with serve(ServedChannel(bitrate=1_000)):
        sender, receiver = opened(), opened()
        for identifier in (0, 5, 4, 3, 2, 1):  # the first one is on the wire for 50 ms
            sender.send(message(identifier))
        got = received(receiver, 6)
        assert [one.arbitration_id for one in got] == [0, 1, 2, 3, 4, 5]
        gap = got[2].timestamp - got[1].timestamp  # seconds since 1970 are floats, good to half a microsecond
        assert gap == pytest.approx((frame_bits(Frame(2)).total + INTERMISSION) / 1_000, abs=1e-6)


@pytest.mark.parametrize("physics", [True, False])
def test_own_messages_listeners_filters(opened: Open, physics: bool) -> None:
    """Own frames come back when asked for, marked as sent; who only listens cannot send; filters apply."""
    with serve(ServedChannel(physics=physics)):
        own, ear = opened(receive_own_messages=True), opened(listen_only=True)
        other = opened(can_filters=[{"can_id": 0x20, "can_mask": 0x7F0, "extended": False}])
        with pytest.raises(can.CanOperationError, match="listen only"):
            ear.send(message(1))
        for identifier in (0x10, 0x21):
            own.send(message(identifier, b"x"))
        assert [(one.arbitration_id, one.is_rx) for one in received(own, 2)] == [(0x10, False), (0x21, False)]
        assert [one.arbitration_id for one in received(ear, 2)] == [0x10, 0x21]
        assert [one.arbitration_id for one in received(other)] == [0x21]


@pytest.mark.parametrize("physics", [True, False])
def test_members_of_all_kinds_hear_each_other(opened: Open, physics: bool) -> None:
    """Unix, TCP and socketcand clients, whoever came first; a classic member gets no FD frame."""
    channel = ServedChannel(physics=physics, fd=not physics)
    with serve(channel, unix="", tcp=("127.0.0.1", 0), socketcand=("127.0.0.1", 0)) as server:
        buses: list[can.BusABC] = [opened("unix:can0"), opened(server.addresses["can0"][1])]
        host, port = parse_host(server.socketcand, None)
        with can.Bus("can0", "socketcand", host=host, port=port) as foreign:
            buses += [foreign, opened("unix:can0")]
            for number, sender in enumerate(buses):
                sender.send(message(0x100 + number, bytes([number])))
                for bus in buses:
                    if bus is not sender:
                        (got,) = received(bus)
                        assert (got.arbitration_id, got.data) == (0x100 + number, bytes([number]))
            if not physics:
                fd = opened("unix:can0", fd=True)
                fd.send(message(0x200, bytes(12), is_fd=True))
                fd.send(message(0x201))
                assert [received(bus)[0].arbitration_id for bus in buses[:2]] == [0x201, 0x201]


@pytest.mark.parametrize("physics", [True, False])
def test_a_server_that_goes_is_an_error_at_once(opened: Open, physics: bool) -> None:
    """A blocked `recv` is woken with an exception; every call after it says the same, without waiting."""
    running = ExitStack()
    running.enter_context(serve(ServedChannel(physics=physics)))
    blocked, idle = opened(), opened()
    errors: list[Exception] = []

    def wait() -> None:
        try:
            blocked.recv(PATIENCE)
        except can.CanOperationError as error:
            errors.append(error)

    reader = threading.Thread(target=wait)
    reader.start()
    running.close()
    reader.join(PATIENCE)
    assert "is gone" in str(errors[0])
    start = time.monotonic()
    for _ in range(3):
        for bus in (blocked, idle):
            with pytest.raises(can.CanOperationError, match="is gone"):
                bus.recv(PATIENCE)
    with pytest.raises(can.CanOperationError, match="is gone"):
        idle.send(message(1))
    assert time.monotonic() - start < PATIENCE / 2


def test_a_gate_finds_the_server_again() -> None:
    """To the gatekeeper a served bus is one that can be unplugged and comes back."""
    kinds: list[str] = []
    told = threading.Condition()

    def happened(event: Any) -> None:
        with told:
            kinds.append(event.kind)
            told.notify_all()

    gate = CanGate({"interface": "aces", "channel": "unix:can0"})
    with serve():
        gate.start()
        gate.events.add(happened)
        inbox = gate.subscribe()
    try:
        with told:
            assert told.wait_for(lambda: "lost" in kinds, PATIENCE)
        with serve():
            with told:
                assert told.wait_for(lambda: "reopened" in kinds, PATIENCE)
            with can.Bus("unix:can0", "aces") as bus:
                bus.send(message(0x42))
                assert [item.frame.arbitration_id for item in inbox.get(PATIENCE)] == [0x42]
    finally:
        gate.stop()


def test_waiting_costs_nothing(opened: Open) -> None:
    """`recv` with a time-out sleeps in the system, returns in time, and 0 does not wait."""
    with serve():
        bus = opened()
        start, busy = time.monotonic(), time.process_time()
        assert bus.recv(0.4) is None
        assert time.monotonic() - start >= 0.4
        assert time.process_time() - busy < 0.2
        assert bus.recv(0) is None


def test_closing_wakes_whoever_waits(opened: Open) -> None:
    """A thread in `recv` gets an exception when another closes the bus; closing twice is no harm."""
    with serve():
        bus = opened()
        errors: list[str] = []

        def wait() -> None:
            try:
                bus.recv(None)
            except can.CanOperationError as error:
                errors.append(str(error))

        reader = threading.Thread(target=wait)
        reader.start()
        bus.shutdown()
        bus.shutdown()
        reader.join(PATIENCE)
        assert "is closed" in errors[0]
        with pytest.raises(can.CanOperationError, match="closed"):
            bus.send(message(1))


def test_full_mailboxes(opened: Open) -> None:
    """With nobody to acknowledge, a sender hears of it after as many frames as it has mailboxes, and is passive."""
    with serve():
        bus = opened()
        with pytest.raises(can.CanOperationError, match="no free mailbox"):
            for _ in range(channel_module.MAILBOXES + 1):
                bus.send(message(1))
        until(lambda: bus.state is can.BusState.PASSIVE)
        assert {event.kind for event in bus.events} == {"no acknowledge", "error-passive"}
        bus.flush_tx_buffer()
        other = opened()
        until(lambda: bus.status()["channels"][0]["members"][0]["waiting"] <= 1)
        bus.send(message(2), timeout=PATIENCE)
        assert 2 in {one.arbitration_id for one in received(other, 2)}


def test_a_fast_sender_waits_for_the_bus(opened: Open) -> None:
    """With a time-out to wait in, more frames than mailboxes go through without a loss, in order."""
    count = 2 * channel_module.MAILBOXES
    with serve():
        sender, receiver = opened(), opened()
        for number in range(count):
            sender.send(message(1, number.to_bytes(2, "big")), timeout=PATIENCE)
        got = [int.from_bytes(one.data, "big") for one in received(receiver, count)]
        assert got == list(range(count))
        assert (receiver.dropped, sender.rejected) == (0, 0)


def test_bus_off_and_back(opened: Open) -> None:
    """Faults take a sender off; it is told, refused, and comes back when restarted."""
    with serve(ServedChannel(bitrate=1_000_000, faults=Faults(corrupt=1.0))):
        sender, witness = opened(), opened()
        sender.send(message(1))
        until(lambda: sender.state is can.BusState.ERROR)
        assert [event.kind for event in sender.events][-1] == "bus-off"
        with pytest.raises(can.CanOperationError, match="bus-off"):
            sender.send(message(2))
        sender.flush_tx_buffer()
        sender.restart()
        until(lambda: sender.state is can.BusState.ACTIVE)
        assert witness.recv(0) is None


def test_last_words_are_still_said(opened: Open) -> None:
    """Frames given to the bus are sent though their sender has left, as a controller would."""
    with serve(ServedChannel(bitrate=50_000)):
        receiver = opened()
        with can.Bus("unix:can0", "aces") as sender:
            for number in range(10):
                sender.send(message(number))
        assert len(received(receiver, 10)) == 10


# ---------------------------------------------------------------------- losses, bad clients


def plain(address: str = "unix:can0") -> Stream:
    """A client that speaks by hand and takes no shortcut."""
    return Stream(parse_address(address), packets.Hello())


def test_who_does_not_read_loses_the_oldest(opened: Open, monkeypatch: pytest.MonkeyPatch) -> None:
    """A member that does not read delays nobody; its losses are counted, and what is kept is the newest."""
    monkeypatch.setattr(channel_module, "QUEUE", 100)
    count = 20_000
    with serve(ServedChannel(physics=False)), ExitStack() as stack:
        slow = plain()
        stack.callback(slow.close)
        sender, reader = opened(), opened()
        total = 0
        for number in range(count):
            sender.send(message(1, number.to_bytes(4, "big")))
            while reader.recv(0) is not None:
                total += 1
        total += len(received(reader, count - total))
        assert (total, reader.dropped) == (count, 0)

        def lost() -> int:
            return int(sender.status()["channels"][0]["members"][0]["dropped"])

        until(lambda: lost() > 0)
        kept: list[int] = []
        dropped = 0
        while not kept or kept[-1] != count - 1:
            for kind, body in slow.read():
                if kind == packets.REPORT:
                    dropped = packets.read_report(body)[2]
                else:
                    kept += [int.from_bytes(one[-1][:4], "big") for one in packets.records(kind, body)]
        assert kept == sorted(kept)
        assert len(kept) + dropped == count


def test_a_neighbour_that_does_not_read(opened: Open, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without physics it costs its sender one short wait; then it loses frames, and hears how many."""
    monkeypatch.setattr("aces_bus.hardware.served.shortcut._BUFFER", 4096)
    count = 3_000
    with serve(ServedChannel(physics=False)):
        sender, slow = opened(), opened()
        start = time.monotonic()
        for number in range(count):
            sender.send(message(1, number.to_bytes(4, "big")))
        assert time.monotonic() - start < PATIENCE / 2
        got = 0
        while slow.recv(0) is not None:
            got += 1
        assert 0 < got < count
        sender.send(message(2))
        assert received(slow)[0].arbitration_id == 2
        assert got + slow.dropped == count


def test_many_members(opened: Open) -> None:
    """More than talk to each other directly: the others get theirs from the server, nobody twice."""
    with serve(ServedChannel(physics=False)):
        buses = [opened() for _ in range(20)]
        for number in (0, 19):
            buses[number].send(message(number))
        for place, bus in enumerate(buses):
            wanted = [number for number in (0, 19) if number != place]
            assert sorted(one.arbitration_id for one in received(bus, len(wanted))) == wanted
        buses.pop().shutdown()
        assert all(bus.recv(0) is None for bus in buses)
        assert buses[0].status()["channels"][0]["frames"] == 2


GARBAGE = [
    b"\x00\x00\xff\x00",
    packets.packet(packets.CLASSIC, bytes(24)),
    packets.packet(packets.HELLO, b"short"),
    packets.packet(packets.HELLO, bytes(20)),
    packets.Hello("nowhere").packet(),
    packets.Hello(bitrate=123).packet(),
    packets.Hello(flags=packets.TAKES_FD).packet(),
    packets.Hello().packet() * 2,
    packets.Hello().packet() + packets.packet(packets.CLASSIC, bytes(23)),
    packets.Hello().packet()
    + packets.packet(packets.CLASSIC, packets.CLASSIC_RECORD.pack(0, 0x800, 0, 0, b"")),
    packets.Hello().packet() + packets.packet(packets.CLASSIC, packets.CLASSIC_RECORD.pack(0, 1, 4, 0, b"")),
    packets.Hello().packet()
    + packets.packet(packets.CLASSIC, packets.CLASSIC_RECORD.pack(0, 1, 0, 200, b"")),
    packets.Hello().packet() + packets.packet(packets.LONG, packets.LONG_RECORD.pack(0, 1, 8, 63, b"")),
    packets.Hello().packet() + packets.packet(packets.EVENT, bytes(9)),
    packets.packet(packets.QUERY),
]


@pytest.mark.parametrize("garbage", GARBAGE, ids=range(len(GARBAGE)))
def test_a_bad_client_costs_only_itself(opened: Open, garbage: bytes) -> None:
    """What nobody may say ends the connection with a reason; the others do not notice."""
    said: list[str] = []
    with serve(said=said.append) as server:
        one, two = opened(), opened()
        bad = parse_address("unix:can0").connect(PATIENCE)
        bad.sendall(garbage)
        answer = b""
        while data := bad.recv(65536):
            answer += data
        bad.close()
        kinds = [kind for kind, _ in packets.split(answer)[0]]
        assert kinds[-1] == packets.REFUSED
        one.send(message(1, b"ok"))
        assert received(two)[0].data == b"ok"
        assert server.cut == len(said) == 1


def test_a_socketcand_client_that_never_ends_a_command(opened: Open) -> None:
    """A command has a length; who goes on is cut off."""
    with serve(socketcand=("127.0.0.1", 0)) as server:
        bad = socket.create_connection(parse_host(server.socketcand, None), PATIENCE)
        assert bad.recv(100) == b"< hi >"
        try:
            for _ in range(100):
                bad.sendall(b"< send " + b"1" * 1000)
            while bad.recv(100):
                pass
        except OSError:
            pass  # reset
        bad.close()
        until(lambda: server.cut == 1)


def test_too_many_clients_and_silent_ones(monkeypatch: pytest.MonkeyPatch, opened: Open) -> None:
    """Connections are bounded, and those that do not say who they are make room."""
    monkeypatch.setattr(server_module, "CLIENTS", 3)
    monkeypatch.setattr(server_module, "INTRODUCTION_S", 0.3)
    with serve() as server:
        silent = [parse_address("unix:can0").connect(PATIENCE) for _ in range(3)]
        with pytest.raises(can.CanInitializationError):
            opened(timeout=PATIENCE)
        assert server.refused == 1
        for one in silent:
            while one.recv(1000):
                pass
            one.close()
        opened()


def test_what_answers_is_no_server(runtime: Path) -> None:
    """A client that reaches something else, or something that never answers, says so."""
    path = str(runtime / "silent.sock")
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(path)
        listener.listen()
        with pytest.raises(can.CanInitializationError, match="in time"):
            can.Bus(f"unix:{path}", "aces", timeout=0.05)
    path = str(runtime / "other.sock")
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(path)
        listener.listen()
        greeter = threading.Thread(target=lambda: listener.accept()[0].sendall(b"220 mail.example\r\n"))
        greeter.start()
        with pytest.raises(can.CanInitializationError, match="no server|kind"):
            can.Bus(f"unix:{path}", "aces", timeout=PATIENCE)
        greeter.join()
    with pytest.raises(can.CanInitializationError, match="aces bus serve"):
        can.Bus("unix:nobody", "aces")


# ---------------------------------------------------------------------- addresses and files


def test_sockets_are_the_users_alone_and_go(runtime: Path) -> None:
    """Folder 0700, socket 0600, both without leftovers; a file that is not ours any more stays."""
    with serve() as server:
        folder = runtime / "aces"
        path = folder / "can0.sock"
        assert stat.S_IMODE(folder.stat().st_mode) == 0o700
        assert stat.S_IMODE(path.stat().st_mode) == 0o600
        assert server.addresses == {"can0": [f"unix:{path}"]}
    assert list(folder.iterdir()) == []
    with serve():
        path.unlink()
        path.write_text("another's")
    assert path.read_text() == "another's"


def test_dead_sockets_are_replaced_and_living_ones_not(runtime: Path) -> None:
    """A second server on a path is refused; what a killed one has left is no obstacle; a file is never removed."""
    path = str(runtime / "bus.sock")
    with socket.socket(socket.AF_UNIX) as dead:
        dead.bind(path)
    with serve(unix=path), pytest.raises(CallerError, match="is served already"):
        serve(unix=path)
    Path(path).write_text("a file")
    with pytest.raises(CallerError, match="is no socket"):
        serve(unix=path)
    with pytest.raises(CallerError, match="longer than"):
        serve(unix=str(runtime / ("x" * 120)))
    with pytest.raises(CallerError, match="cannot be served"):
        serve(unix=str(runtime / "no" / "such" / "folder.sock"))


def test_other_machines_are_not_let_in() -> None:
    """An address that others reach takes an explicit word."""
    for host in ("0.0.0.0", "::"):
        with pytest.raises(CallerError, match="--bind-anywhere"):
            serve(unix=None, tcp=(host, 0))
        with pytest.raises(CallerError, match="--bind-anywhere"):
            serve(unix=None, socketcand=(host, 0))
    with serve(unix=None, tcp=("0.0.0.0", 0), bind_anywhere=True):
        pass


def test_a_runtime_folder_of_somebody_else(runtime: Path) -> None:
    """A folder in which others may write is not used."""
    (runtime / "aces").mkdir()
    (runtime / "aces").chmod(0o777)
    with pytest.raises(CallerError, match="this user alone"):
        serve()


def test_servers_are_found(opened: Open, runtime: Path) -> None:
    """`detect_available_configs` lists served channels; the notes of dead servers are cleared."""
    note = runtime / "aces" / "server-dead.json"
    with serve(ServedChannel("left"), ServedChannel("right"), tcp=("127.0.0.1", 0)):
        note.write_text('{"pid": 999999999, "addresses": {"x": ["unix:/nowhere.sock"]}}')
        (runtime / "aces" / "server-bad.json").write_text("{")
        found = {config["channel"] for config in can.detect_available_configs("aces")}
        assert {f"unix:{runtime}/aces/{name}.sock" for name in ("left", "right")} <= found
        opened("unix:left"), opened("unix:right")
        (status,) = served.servers()
        assert [len(channel["members"]) for channel in status["channels"]] == [1, 1]
    assert not note.exists()
    assert served.servers() == []


def test_several_channels_on_one_port(opened: Open, runtime: Path) -> None:
    """The address says which; channels are apart; `--unix` with several names a folder."""
    folder = runtime / "both"
    with serve(ServedChannel("a"), ServedChannel("b"), unix=str(folder), tcp=("127.0.0.1", 0)) as server:
        assert sorted(path.name for path in folder.iterdir()) == ["a.sock", "b.sock"]
        one, same, other = (opened(server.addresses[name][1]) for name in "aab")
        one.send(message(7))
        assert received(same)[0].arbitration_id == 7
        assert other.recv(0.01) is None
        with pytest.raises(can.CanInitializationError, match="say which channel: a, b"):
            opened(server.addresses["a"][1].rpartition("/")[0])


@pytest.mark.parametrize(
    ("text", "again"),
    [
        ("unix:/run/x.sock", "unix:/run/x.sock"),
        ("tcp:127.0.0.1:29537/can0", "tcp:127.0.0.1:29537/can0"),
        ("tcp:[::1]:5/can1", "tcp:[::1]:5/can1"),
        ("tcp:localhost:5", "tcp:localhost:5"),
        ("tcp:localhost", None),
        ("tcp:localhost:65536", None),
        ("tcp:localhost:٣", None),
        ("udp:localhost:5", None),
        ("unix:", None),
    ],
)
def test_addresses(text: str, again: str | None) -> None:
    """An address reads as it is written; what is none is refused."""
    if again is None:
        with pytest.raises(CallerError):
            parse_address(text)
    else:
        assert str(parse_address(text)) == again


@pytest.mark.parametrize(
    "settings",
    [
        {"name": ""},
        {"name": "a/b"},
        {"name": "x" * 65},
        {"bitrate": 5},
        {"data_bitrate": 2_000_000},
        {"fd": True, "data_bitrate": 5},
        {"physics": False, "faults": Faults(drop=0.5)},
    ],
)
def test_impossible_channels_are_refused(settings: dict[str, Any]) -> None:
    """Before anything is opened."""
    with pytest.raises(CallerError):
        ServedChannel(**settings)


# ---------------------------------------------------------------------- packets

FRAMES = st.builds(
    lambda identifier, extended, data, remote: Frame(
        identifier if extended else identifier & 0x7FF,
        b"" if remote else data,
        is_extended_id=extended,
        is_remote_frame=remote,
        dlc=len(data) if remote else None,
    ),
    st.integers(0, 0x1FFF_FFFF),
    st.booleans(),
    st.binary(max_size=8),
    st.booleans(),
) | st.builds(
    lambda identifier, size, seed, brs, esi: Frame(
        identifier,
        bytes((seed + at) % 256 for at in range(size)),
        is_fd=True,
        bitrate_switch=brs,
        error_state_indicator=esi,
    ),
    st.integers(0, 0x7FF),
    st.sampled_from(FD_LENGTHS),
    st.integers(0, 255),
    st.booleans(),
    st.booleans(),
)


@given(st.lists(st.tuples(FRAMES, st.integers(0, 2**62)), max_size=60), st.data())
def test_frames_survive_packets(frames: list[tuple[Frame, int]], data: st.DataObject) -> None:
    """Frames come out of packets as they went in, in order, wherever the stream is cut."""
    stream = b"".join(packets.packed(packets.frame_record(frame, when) for frame, when in frames))
    cut = data.draw(st.integers(0, len(stream)))
    first, rest = packets.split(stream[:cut])
    second, rest = packets.split(rest + stream[cut:])
    assert rest == b""
    found = [
        (packets.to_frame(identifier, flags, length, padded), when)
        for kind, body in first + second
        for when, identifier, flags, length, padded in packets.records(kind, body)
    ]
    assert [(one, when) for one, when in found] == [
        (frame if frame.is_remote_frame else frame, when) for frame, when in frames
    ]


@given(st.binary(max_size=300))
def test_no_bytes_break_a_reader(data: bytes) -> None:
    """Whatever comes is packets or a `PacketError`; frames that come out can exist."""
    readers: dict[int, Callable[[bytes], object]] = {
        packets.HELLO: packets.read_hello,
        packets.WELCOME: packets.read_welcome,
        packets.REPORT: packets.read_report,
        packets.EVENT: packets.read_event,
    }
    for kind, read in readers.items():
        try:
            read(data)
        except packets.PacketError:
            pass
        assert kind
    for kind in (packets.CLASSIC, packets.LONG):
        try:
            for _, identifier, flags, length, padded in packets.records(kind, data):
                packets.to_frame(identifier, flags, length, padded)
        except packets.PacketError:
            pass
    try:
        packets.split(data)
    except packets.PacketError:
        pass


# ---------------------------------------------------------------------- socketcand, by hand


class Text:
    """A socketcand client by hand."""

    def __init__(self, server: BusServer) -> None:
        self._socket = socket.create_connection(parse_host(server.socketcand, None), PATIENCE)
        self._buffer = ""
        assert self.next() == "< hi >"

    def say(self, text: str) -> None:
        self._socket.sendall(text.encode())

    def next(self) -> str:
        """The next answer."""
        while ">" not in self._buffer:
            data = self._socket.recv(1000)
            assert data
            self._buffer += data.decode("ascii")
        found, _, self._buffer = self._buffer.partition(">")
        return found + ">"

    def __enter__(self) -> Text:
        return self

    def __exit__(self, *_: object) -> None:
        self._socket.close()


def test_socketcand_commands(opened: Open) -> None:
    """Each command of the protocol's documentation that is offered; and what is not, is answered as unknown."""
    with (
        serve(ServedChannel(fd=True, data_bitrate=2_000_000), unix="", socketcand=("127.0.0.1", 0)) as server,
        Text(server) as text,
    ):
        bus = opened(fd=True)
        text.say("< rawmode >< open can0")
        assert text.next() == "< error unknown command >"
        text.say(" >")
        assert text.next() == "< ok >"
        text.say("<echo>< subscribe 0 0 123 >< send 124 0  >< echo >")
        assert [text.next(), text.next()] == ["< echo >", "< echo >"]
        assert received(bus)[0].arbitration_id == 0x124
        for identifier in (0x122, 0x123):
            bus.send(message(identifier, b"\x11\x22"))
        word, identifier_text, stamp, data = text.next().strip("<> ").split()
        assert (word, identifier_text, data) == ("frame", "123", "1122")
        assert abs(float(stamp) - time.time()) < PATIENCE
        text.say("< rawmode >")
        assert text.next() == "< ok >"
        for sent, wanted in (
            (message(0x1ABCDEF0, b"\xff", is_extended_id=True), "frame 1ABCDEF0 FF"),
            (message(0x7, is_remote_frame=True, dlc=4), "rtr 007 4"),
            (message(0x8, bytes(12), is_fd=True, bitrate_switch=True), f"fdframe 008 01 {'00' * 12}"),
            (message(0x9), "frame 009"),
        ):
            bus.send(sent)
            words = text.next().strip("<> ").split()
            del words[3 if words[0] == "fdframe" else 2]  # the time
            assert " ".join(words) == wanted
        got = []
        for command in (
            "send 123 2 1 f1",
            "sendrtr 1AAAAAAA 2",
            "fdsend 5 1 12 0 1 2 3 4 5 6 7 8 9 a b",
            "send 7 0",
        ):
            text.say(f"< {command} >")
            got += received(bus)
        assert [bytes(one.data) for one in got] == [b"\x01\xf1", b"", bytes(range(12)), b""]
        assert (got[1].is_remote_frame, got[1].is_extended_id, got[1].dlc) == (True, True, 2)
        assert (got[2].is_fd, got[2].bitrate_switch) == (True, True)
        text.say("< isotpmode >")
        assert text.next() == "< error unknown command >"


def test_socketcand_nonsense_makes_no_frames(opened: Open) -> None:
    """Commands that cannot be understood are counted, and the connection goes on."""
    with serve(unix="", socketcand=("127.0.0.1", 0)) as server, Text(server) as text:
        bus = opened()
        text.say("< open can0 >< rawmode >")
        assert [text.next(), text.next()] == ["< ok >", "< ok >"]
        for nonsense in (
            "< send >", "< send 800 0 >", "< send xyz 0 >", "< send 1 9 >", "< send 1 2 1 >", "< send 1 1 100 >",
            "< send 1 -1 >", "< send 20000000 0 >", "< sendrtr 1 >", "< fdsend 1 0 9 1 2 3 4 5 6 7 8 9 >", "<>", "x>",
            "< send \xff 0 >",
        ):  # fmt: skip
            text.say(nonsense)
        text.say("< send 1 1 aa >")
        assert received(bus)[0].data == b"\xaa"
        assert bus.recv(0.01) is None


def test_socketcand_hears_of_errors() -> None:
    """A sender whom nobody acknowledges gets error frames, as python-can's client reads them."""
    with serve(unix="", socketcand=("127.0.0.1", 0)) as server:
        host, port = parse_host(server.socketcand, None)
        with can.Bus("can0", "socketcand", host=host, port=port) as bus:
            bus.send(message(1))
            first, second = received(bus, 2)
            assert (first.is_error_frame, first.arbitration_id) == (True, 0x20)
            assert (second.is_error_frame, second.arbitration_id) == (True, 0x04)


def test_socketcand_frames_do_not_run_into_the_handshake(opened: Open) -> None:
    """python-can's client takes all that comes with an answer for the answer; on a busy bus it can still join."""
    with serve(unix="", socketcand=("127.0.0.1", 0)) as server:
        sender, _ = opened(), opened()
        task = sender.send_periodic(message(0x55), 0.001)
        host, port = parse_host(server.socketcand, None)
        for _ in range(5):
            with can.Bus("can0", "socketcand", host=host, port=port) as bus:
                assert received(bus)[0].arbitration_id == 0x55
        task.stop()


def test_nothing_is_left_open(opened: Open) -> None:
    """Files of the process are as many after a server and its clients as before."""
    if not os.path.isdir("/proc/self/fd"):
        pytest.skip("no /proc to look at")
    before = len(os.listdir("/proc/self/fd"))
    for physics in (True, False):
        with serve(ServedChannel(physics=physics)):
            buses = [opened() for _ in range(4)]
            buses[0].send(message(1))
            received(buses[1])
            for bus in buses:
                bus.shutdown()
    assert len(os.listdir("/proc/self/fd")) == before
