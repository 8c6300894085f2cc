"""`aces send`: what is sent is what the spec says, only with --tx, at the pace that was asked for."""

from __future__ import annotations

import os
import socket
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import can
import pytest

from aces_bus import Frame
from aces_bus.errors import AcesError, CallerError
from aces_tools.live import SendQueue
from aces_tools.live_text import notation
from aces_tools.patience import Patience
from aces_tools.protocols_arg import parse_protocols
from aces_tools.send import raw_packet
from aces_tools.values import parse_fields
from tests.tools.live import WAIT_S, Node, Opened, interrupt

Aces = Callable[..., Any]

COUNTED = """
from construct import Byte, Int16ul, Struct
from aces_bus.protocol import Counter, Protocol, Sum

drive = Protocol("drive", link="can")
Go = drive.message("Go", id=0x200, direction="to device", payload=Struct("speed" / Int16ul, "alive" / Counter(Byte, 4),
    "sum" / Byte), check=Sum(field="sum"))
"""


@pytest.fixture
def counted(tmp_path: Path) -> str:
    """A protocol whose message has a rolling counter and a check of its own."""
    path = tmp_path / "drive.py"
    path.write_text(COUNTED, encoding="utf-8")
    return str(path)


def data(messages: list[can.Message]) -> list[str]:
    return [f"{m.arbitration_id:03X}#{bytes(m.data).hex().upper()}" for m in messages]


# ---------------------------------------------------------------------- without --tx


def test_without_tx_nothing_is_opened(
    aces: Aces, node: Node, arm: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It shows the frame and what a receiver would make of it, and says how to send it."""

    def never(*_: Any, **__: Any) -> Any:
        raise AssertionError("a bus was opened")

    monkeypatch.setattr(can, "Bus", never)
    found = aces("send", "Stop", "board=2", "-p", arm, *node.options)
    assert found.status == 0
    assert found.out.splitlines()[0] == f"{node.channel}  001#020F"
    assert "001 → Stop  board=2" in found.out
    assert found.messages == ["nothing was sent: add --tx"]
    assert node.received() == []


def test_without_a_bus_it_shows_the_frame_too(aces: Aces, arm: str) -> None:
    """The dry run needs no bus; the layout can be drawn beside."""
    found = aces("send", "Stop", "board=2", "-p", arm, "--bits")
    assert found.status == 0
    assert found.messages == ["nothing was sent: add --tx and a bus"]
    assert "0 │ board" in found.out
    found = aces("send", "Stop", "board=2", "-p", arm, "--format", "jsonl")
    assert [one["fields"] for one in found.objects] == [{"board": 2}]


def test_packets_of_a_line_are_shown_in_hexadecimal(aces: Aces) -> None:
    """Sync, length and check are the protocol's."""
    found = aces("send", "Write", "id=1", "start=30", "data=0002", "-p", "robotis")
    assert found.out.splitlines()[0] == "line  FF FF 01 05 03 1E 00 02 D6"
    assert "Write  id=1  start=30  data=00 02" in found.out


# ---------------------------------------------------------------------- values


@pytest.mark.parametrize(
    ("message", "texts", "fields"),
    [
        ("Encoder", ["board=3", "position=[120,-4]"], {"board": 3, "position": [120, -4]}),
        ("Encoder", ["position.1=-4", "position.0=0x78"], {"position": [120, -4]}),
        ("State", ["mode=torque", "angle=-1.5"], {"mode": "torque", "angle": -1.5}),
        ("State", ["error=hot|cold"], {"error": ["hot", "cold"]}),
        ("State", ["mode=2", "error=9", "load=1e3"], {"mode": 2, "error": 9, "load": 1000.0}),
        ("State", ["error={hot}"], {"error": ["hot"]}),
        ("Raw", ["data=0a00"], {"data": b"\x0a\0"}),
        ("Raw", ["data="], {"data": b""}),
        ("Name", ["name=left arm"], {"name": "left arm"}),
        ("Name", ['name="12"'], {"name": "12"}),
        ("Pages", ["low=none"], {"low": None}),
    ],
)  # fmt: skip
def test_values_are_read_as_the_spec_has_them(
    arm: str, message: str, texts: list[str], fields: dict[str, Any]
) -> None:
    """Numbers, names, flags, lists in both ways, bytes, texts, no value."""
    (variant,) = parse_protocols([arm])
    known = {**variant.messages, **{m.name: m for m in variant.protocol.declared}}
    assert parse_fields(known[message], texts) == fields


def test_nested_records_are_read() -> None:
    """Records in lists, written as a whole or by their paths."""
    (variant,) = parse_protocols(["robotis"])
    message = variant.messages["SyncWrite"]
    expected = {"servos": [{"id": 1, "data": b"\x0a\0"}, {"id": 2, "data": b"\0\0"}]}
    assert parse_fields(message, ["servos=[{id=1,data=hex:0a00}, {id=2, data=hex:0000}]"]) == expected
    texts = ["servos.0.id=1", "servos.0.data=hex:0a00", "servos.1.id=2", "servos.1.data=hex:0000"]
    assert parse_fields(message, texts) == expected


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["Stop", "bord=2"], "no field of Stop named 'bord'; did you mean 'board'?"),
        (["Stopp", "board=2"], "no message named 'Stopp'; did you mean 'Stop'?"),
        (["Stop"], "Stop: board: no value given for 'board'"),
        (["Stop", "board=300"], "Stop"),
        (["Stop", "board=two"], "'two' is not a number"),
        (["Stop", "board=1", "board=2"], "board is given twice"),
        (["Stop", "board"], "'board' is not a value of Stop; write field=value"),
        (["State", "board=1", "mode=tork", "error=0", "angle=0", "load=0"], "did you mean 'torque'?"),
        (["State", "board=1", "mode=off", "error=warm", "angle=0", "load=0"], "no flag named 'warm' (there are: hot, cold)"),
        (["State", "board=1", "mode=off", "error=0", "angle=101", "load=0"], "101 ° is outside -100…100 °"),
        (["State", "board=1", "mode=off", "error=0", "angle=lots", "load=0"], "write one in °"),
        (["Encoder", "board=1", "position=3"], "this is a list; write position=[1,2]"),
        (["Encoder", "board=1", "position=[1,2"], "this is a list"),
        (["Encoder", "board=1", "position=[1,[2]"], "is not closed"),
        (["Encoder", "board=1", "position.1=3"], "position.0 is not given, and position.1 is"),
        (["Encoder", "board=1", "position=[1,2]", "position.1=3"], "as a whole, and a part of it"),
        (["Raw", "data=0a0"], "bytes are written as hexadecimal digits"),
        (["123#F"], "odd number of hexadecimal digits"),
        (["12#00"], "3 or 8"),
        (["800#00"], "outside"),
        (["20000004#0004000000000000"], "error frames are made by controllers"),
        (["123#00", "Stop"], "not a raw frame as the first one is"),
        (["123#00", "#00"], "do not go to one bus"),
        (["#0"], "hexadecimal digits, two a byte"),
        (["#"], "no bytes to send"),
        (["Stop", "board=1", "--count", "3"], "say how often: --every 10ms"),
        (["Stop", "board=1", "--every", "0.5ms"], "is 2000 frames/s, and at most 1000 are allowed"),
        (["Stop", "board=1", "--every", "1s", "--count", "0"], "is not a whole number from 1 on"),
        (["Stop", "board=1", "--rate", "0"], "is not a number above 0"),
        (["Stop", "board=1", "--reply"], "without --tx nothing is sent"),
        (["Stop", "board=1", "--serial", "x"], "arm is spoken on CAN"),
        (["#00", "-i", "aces", "-c", "x"], "is a CAN bus"),
        (["Stop", "board=1", "--tx"], "no bus is named"),
    ],
)  # fmt: skip
def test_wrong_calls(
    aces: Aces, arm: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, arguments: list[str], said: str
) -> None:
    """One line says what is wrong, where, and what would fit; nothing is opened."""
    monkeypatch.setenv("HOME", str(tmp_path))
    for name in ("CAN_INTERFACE", "CAN_CHANNEL"):
        monkeypatch.delenv(name, raising=False)
    found = aces("send", *arguments, "-p", arm)
    assert found.status == 2
    assert said in found.err
    assert len(found.err.splitlines()) == 1


def test_a_message_needs_its_protocol(aces: Aces) -> None:
    """Without -p it is said what to name, and how a raw frame is written."""
    found = aces("send", "Stop", "board=1")
    assert found.status == 2
    assert (
        "name the protocol that has this message: -p NAME; a raw frame is written 123#DEADBEEF" in found.err
    )


@pytest.mark.parametrize(
    "text", ["123#DEADBEEF", "12345678#00", "123##1AABB", "123##3AA", "123#R8", "7FF#R", "001#"]
)
def test_raw_frames_are_written_as_they_are_read(text: str) -> None:
    """The notation of a frame, read again, is the frame."""
    packet = raw_packet(text)
    assert isinstance(packet, Frame)
    assert notation(packet) == text


@pytest.mark.parametrize(
    "text", ["#", "##", "1#", "123#R9", "123##", "FFFFFFFF#", "123#é", "\0#", "123#00 X", "x#y", "123#00_9"]
)
def test_what_is_no_raw_frame(text: str) -> None:
    """Whatever is typed is a frame, bytes, or one clear complaint."""
    with pytest.raises(CallerError) as raised:
        raw_packet(text)
    assert len(str(raised.value).splitlines()) == 1


# ---------------------------------------------------------------------- with --tx


def test_with_tx_it_is_sent(aces: Aces, node: Node, arm: str) -> None:
    """The frame that was shown is on the bus, once."""
    found = aces(
        "send",
        "State",
        "board=1",
        "mode=torque",
        "error=cold",
        "angle=1",
        "load=0",
        "-p",
        arm,
        *node.options,
        "--tx",
    )
    assert found.status == 0
    assert data(node.received(WAIT_S)) == ["301#0208006400000000"]
    assert found.summary == {"sent": 1, "failed": 0, "late": 0}
    assert found.out == ""


def test_raw_frames_keep_their_order(aces: Aces, node: Node) -> None:
    """Several frames go out as they are named, whatever their identifiers."""
    found = aces("send", "700#01", "123#", "12345678#00", "400#R3", *node.options, "--tx")
    messages = node.received(WAIT_S)
    assert [m.arbitration_id for m in messages] == [0x700, 0x123, 0x12345678, 0x400]
    assert (messages[3].is_remote_frame, messages[3].dlc) == (True, 3)
    assert found.summary["sent"] == 4


def test_counters_and_checks_are_made_anew_each_time(aces: Aces, node: Node, counted: str) -> None:
    """`--every` sends so many times; the counter rolls, and the check is of what is sent."""
    found = aces(
        "send", "Go", "speed=258", "-p", counted, *node.options, "--tx", "--every", "2ms", "--count", 6
    )
    assert found.summary["sent"] == 6
    assert [bytes(m.data)[:4] for m in node.received(WAIT_S)] == [
        bytes([2, 1, n % 4, (3 + n % 4) & 0xFF]) for n in range(6)
    ]


def test_a_counter_that_is_given_stays(aces: Aces, node: Node, counted: str) -> None:
    """What the caller says is not overruled."""
    aces(
        "send",
        "Go",
        "speed=0",
        "alive=3",
        "-p",
        counted,
        *node.options,
        "--tx",
        "--every",
        "2ms",
        "--count",
        2,
    )
    assert data(node.received(WAIT_S)) == ["200#00000303"] * 2


def test_deadlines_are_absolute(aces: Aces, node: Node, monkeypatch: pytest.MonkeyPatch) -> None:
    """The n-th frame is due n periods after the first; a period that was missed is counted and not made up for."""
    now = [1_000_000_000]
    due: list[int] = []
    from aces_tools import send

    original = Patience.wait_until

    def wait_until(patience: Patience, instant: int) -> bool:
        if instant < 10**12:  # a deadline of the test's clock
            due.append(instant - 1_000_000_000)
            now[0] = max(now[0], instant) + (25_000_000 if len(due) == 3 else 1_000_000)
            return True
        return original(patience, instant)

    class Clock:
        """The module's clock; the others go on."""

        @staticmethod
        def monotonic_ns() -> int:
            return now[0]

        @staticmethod
        def time_ns() -> int:
            return now[0]

    monkeypatch.setattr(Patience, "wait_until", wait_until)
    monkeypatch.setattr(send, "time", Clock)
    monkeypatch.setattr(SendQueue, "pending", property(lambda _: 0))
    found = aces("send", "123#00", *node.options, "--tx", "--every", "10ms", "--count", 6)
    assert [instant // 1_000_000 for instant in due[:5]] == [10, 20, 30, 50, 60]
    assert found.summary["late"] == 1


def test_for_a_time(aces: Aces, node: Node) -> None:
    """`--for` bounds what `--every` sends."""
    found = aces("send", "123#00", *node.options, "--tx", "--every", "5ms", "--for", "52ms")
    assert found.summary["sent"] <= 11 <= found.summary["sent"] + found.summary["late"]
    assert len(node.received(WAIT_S)) == found.summary["sent"]


def test_ctrl_c_ends_it(aces: Aces, node: Node, opened: Opened) -> None:
    """Without a number it goes on until Ctrl-C, which is not a fault."""

    def work() -> None:
        assert node.bus.recv(WAIT_S) is not None
        assert node.bus.recv(WAIT_S) is not None
        interrupt()

    opened.then(work)
    found = aces("send", "123#00", *node.options, "--tx", "--every", "1ms")
    assert found.status == 0
    assert found.summary["sent"] >= 2


def test_what_cannot_be_sent_is_said_and_counted(aces: Aces, node: Node) -> None:
    """An FD frame on a bus without FD: the backend's reason, status 1."""
    found = aces("send", "123##1AA", *node.options, "--tx")
    assert found.status == 1
    assert "send failed: 0x123" in found.err
    assert found.summary["failed"] == 1


# ---------------------------------------------------------------------- replies


def answering(node: Node, *answers: tuple[int, str]) -> Callable[[], None]:
    """Waits for a frame and answers."""

    def work() -> None:
        assert node.bus.recv(WAIT_S) is not None
        for identifier, text in answers:
            node.send(identifier, text)

    return work


def test_a_reply_is_printed_decoded(aces: Aces, node: Node, opened: Opened, arm: str) -> None:
    """The message that answers this request, as its request says what it is; other traffic is not shown."""
    opened.then(answering(node, (0x300, "02090064000080BF"), (0x1C0, "0100FFFF")))
    found = aces(
        "send",
        "Get",
        "board=0",
        "selector=7",
        "-p",
        arm,
        *node.options,
        "--tx",
        "--reply",
        "20s",
        "--format",
        "jsonl",
    )
    assert found.status == 0
    (one,) = found.objects
    assert (one["message"], one["fields"]["kp"], one["fields"]["ki"]) == ("Gains", 1, -1)
    assert found.summary["replies"] == 1


def test_no_reply_is_status_1(aces: Aces, node: Node, arm: str) -> None:
    """That nobody answered is said, with how long it waited."""
    found = aces("send", "Get", "board=0", "selector=7", "-p", arm, *node.options, "--tx", "--reply", "20ms")
    assert found.status == 1
    assert any("no reply within 0.02 s" in said for said in found.messages)


def test_a_reply_to_a_raw_frame(aces: Aces, node: Node, opened: Opened) -> None:
    """Without a protocol it is whatever comes first, as candump shows it."""
    opened.then(answering(node, (0x321, "CAFE")))
    found = aces("send", "123#00", *node.options, "--tx", "--reply", "20s")
    assert found.status == 0
    assert found.out.endswith(f"  {node.channel}  321   [2]  CA FE\n")


# ---------------------------------------------------------------------- lines and datagrams


@pytest.mark.skipif(os.name != "posix", reason="pseudo-terminals")
def test_a_packet_and_its_reply_on_a_half_duplex_line(aces: Aces, opened: Opened) -> None:
    """The line's own echo is not a reply; the servo's status is."""
    import tty

    far, near = os.openpty()
    tty.setraw(near)
    asked = bytes.fromhex("FFFF0104022402D2")

    def work() -> None:
        heard = b""
        while len(heard) < len(asked):
            heard += os.read(far, 64)
        os.write(far, heard + bytes.fromhex("FFFF010400000AF0"))

    try:
        opened.then(work)
        found = aces(
            "send", "Read", "id=1", "start=36", "count=2", "-p", "robotis", "--serial", os.ttyname(near),
            "--half-duplex", "--tx", "--reply", "20s", "--format", "jsonl",
        )  # fmt: skip
    finally:
        opened.join()
        os.close(far)
        os.close(near)
    (one,) = found.objects
    assert (one["message"], one["fields"]["id"], one["size"]) == ("Status", 1, 8)
    assert found.summary == {"packets": 1, "sent": 8, "failed": 0, "late": 0, "replies": 1}


def test_a_datagram_and_its_reply(aces: Aces) -> None:
    """Bytes go to the address, and what comes back is shown."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as device:
        device.bind(("127.0.0.1", 0))
        device.settimeout(WAIT_S)

        def work() -> None:
            heard, who = device.recvfrom(100)
            device.sendto(heard[::-1], who)

        thread = threading.Thread(target=work)
        thread.start()
        found = aces("send", "#010203", "--udp", device.getsockname()[1], "--tx", "--reply", "20s")
        thread.join(WAIT_S)
    assert found.status == 0
    assert found.out.endswith("[3]  03 02 01\n")


@pytest.mark.parametrize(
    "text",
    [
        "servos=" + "[" * 99 + "]" * 99,
        "servos=[",
        "servos={",
        "servos={a}",
        "servos='",
        "servos.x.0=1",
        "servos.=1",
    ],
)
def test_every_complaint_is_of_the_tree(text: str) -> None:
    """What values cannot be is an `AcesError` of one line, however odd the text."""
    (variant,) = parse_protocols(["robotis"])
    with pytest.raises(AcesError) as raised:
        variant.encoder.encode(
            "SyncWrite", start=0, size=1, **parse_fields(variant.messages["SyncWrite"], [text])
        )
    assert len(str(raised.value).splitlines()) == 1
