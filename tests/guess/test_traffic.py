"""Frames of a bus that no protocol reads, guessed and drafted."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np
import pytest
from construct import GreedyBytes, Struct

from aces_bus import Frame, FrameTable
from aces_bus.protocol import Crc, FastPacket, IdField, IsoTp, J1939Transport, Protocol, TailByte, Transport
from aces_bus.protocol.files import load_file
from aces_bus.protocol.lint import check_protocol
from aces_lab.guess import Traffic, TrafficGuess, draft_source


def guessed(frames: Iterable[Frame], *, known: bool = False) -> TrafficGuess:
    """The guess of frames, in the order of time."""
    traffic = Traffic()
    traffic.add(FrameTable.from_frames(sorted(frames, key=lambda one: one.timestamp or 0.0)))
    return traffic.guess(known=known)


def drafted(guess: TrafficGuess, folder: Path) -> Protocol:
    """The draft of a guess, loaded and checked: nothing but notes."""
    path = folder / "draft.py"
    path.write_text(draft_source(guess, "draft", ["drive.log"]), encoding="utf-8")
    protocol = load_file(str(path)).draft
    assert isinstance(protocol, Protocol)
    assert [str(one) for one in check_protocol(protocol) if one.level != "note"] == []
    return protocol


def accounted(protocol: Protocol, frames: Iterable[Frame]) -> str:
    """The counts of a scanner of a draft over the frames it was guessed from."""
    scanner = protocol.scanner(include_unknown=True)
    scanner.feed(sorted(frames, key=lambda one: one.timestamp or 0.0))
    scanner.close()
    return str(scanner.counts)


def periodic(
    identifier: int, count: int, seed: int, *, period: float = 0.01, extended: bool = False
) -> Iterator[Frame]:
    """A counter, a number with the high byte first, constants, and a check over the identifier's low byte and all else."""
    check = Crc("CRC8-SAE-J1850")
    noise = np.random.default_rng(seed).integers(-3, 4, count)
    for number in range(count):
        value = int(20000 + 9000 * np.sin(number / 30 + seed)) + int(noise[number])
        body = bytes([number & 15]) + value.to_bytes(2, "big") + b"\x00\xff\x10"
        data = body + bytes([check.compute(bytes([identifier & 0xFF]) + body)])
        time = 100 + seed / 1000 + number * period
        yield Frame(identifier, data, time, "can0", extended)


def test_a_message_is_drafted_with_its_counter_check_and_numbers(tmp_path: Path) -> None:
    """The draft decodes what it was guessed from, all of it."""
    frames = [*periodic(0x123, 400, 1), *periodic(0x2A0, 200, 2, period=0.02)]
    guess = guessed(frames)
    first, second = guess.messages
    assert (first.shown, first.lengths, first.frames) == ("123", (7,), 400)
    assert first.timing is not None
    assert first.timing.is_regular
    assert first.timing.period_ns == pytest.approx(10e6, rel=0.01)
    assert [one.kind for one in second.fields] == ["counter", "constant", "number", "constant", "check"]
    protocol = drafted(guess, tmp_path)
    assert accounted(protocol, frames) == "total=600 decoded=600 records=600"
    record = protocol.scanner().feed([frames[0]])[0]
    assert (record.counter_0_0, record.number_1) == (0, int.from_bytes(frames[0].data[1:3], "big"))
    flipped = Frame(0x123, frames[0].data[:6] + bytes([frames[0].data[6] ^ 1]))
    assert "malformed: check" in str(protocol.scanner(include_unknown=True).feed([flipped])[0])


def test_an_enumeration_is_drafted_with_its_values(tmp_path: Path) -> None:
    """Named by their numbers; one that did not occur decodes to its number, and is kept."""
    states = np.array([0, 5, 3, 6])[np.arange(600) // 25 % 4].tolist()
    frames = [
        Frame(0x155, bytes([state | n // 140 % 2 << 6, n & 255]), n / 100) for n, state in enumerate(states)
    ]
    protocol = drafted(guessed(frames), tmp_path)
    assert accounted(protocol, frames) == "total=600 decoded=600 records=600"
    assert (
        "Enumeration(bits(3, 0), value_0=0, value_3=3, value_5=5, value_6=6)"
        in (tmp_path / "draft.py").read_text()
    )
    first, other = protocol.scanner().feed([frames[30], Frame(0x155, b"\x47\x00")])
    assert (first.enumeration_0_0, other.enumeration_0_0) == ("value_5", 7)


def test_a_node_number_inside_identifiers_is_a_field(tmp_path: Path) -> None:
    """Frames of one kind of device, at neighbouring identifiers; another message between them stays by itself."""
    frames = [frame for node in (1, 2, 3, 5) for frame in periodic(0x200 + node, 150, node)]
    frames += [Frame(0x204, bytes([number & 1, 7]), 100 + number * 0.01, "can0") for number in range(150)]
    guess = guessed(frames)
    assert [one.shown for one in guess.messages] == ["201…203, 205", "204"]
    node = guess.messages[0].node
    assert node is not None
    assert (node.base, node.shift, node.numbers) == (0x200, 0, (1, 2, 3, 5))
    protocol = drafted(guess, tmp_path)
    assert accounted(protocol, frames) == "total=750 decoded=750 records=750"
    assert protocol.scanner().feed([frames[200]])[0].node == 2


def test_lengths_are_messages_and_channels_are_one(tmp_path: Path) -> None:
    """An identifier with two lengths, on two channels that differ in what changes; remote frames; many lengths."""
    frames = [Frame(0x10, bytes([number, 1]), number / 100, "can0") for number in range(30)]
    frames += [Frame(0x10, bytes([1, number, 3]), number / 100 + 0.001, "can1") for number in range(20)]
    frames += [Frame(0x20, b"", 1.0, "can0", False, True, dlc=2)]
    frames += [Frame(0x30, bytes(range(number % 7 + 1)), number / 50, "can0") for number in range(40)]
    guess = guessed(frames)
    assert [(one.name, one.frames) for one in guess.messages] == [
        ("Id010Length2", 30),
        ("Id010Length3", 20),
        ("Id030", 40),
        ("Id020Remote", 1),
    ]
    assert accounted(drafted(guess, tmp_path), frames) == "total=91 decoded=91 records=91"


def test_requests_and_replies_by_order_and_by_what_comes_back() -> None:
    """Asked at no fixed rate, with clocked frames between; what is only sent one after the other is not a pair."""
    drawn = np.random.default_rng(4)
    frames = list(periodic(0x100, 500, 1)) + list(periodic(0x101, 500, 2))
    time = 100.0
    for _ in range(60):
        time += float(drawn.uniform(0.02, 0.12))
        what = int(drawn.integers(0, 9))
        frames.append(Frame(0x641, bytes([what, 0]), time, "can0"))
        frames.append(Frame(0x642, bytes([9, what + 0x40, int(drawn.integers(256))]), time + 0.0004, "can0"))
    time = 107.0  # another pair, behind the first
    for _ in range(40):
        time += float(drawn.uniform(0.02, 0.12))
        what = int(drawn.integers(0, 9))
        frames.append(Frame(0x651, bytes([what]), time, "can0"))
        frames.append(Frame(0x652, bytes([what, 1, int(drawn.integers(256))]), time + 0.0008, "can0"))
    frames += [
        Frame(0x645, bytes([number]), 130 + number**1.5, "can0") for number in range(9)
    ]  # between them, no pair
    pair, second = sorted(guessed(frames).pairs, key=lambda found: found.request)
    assert (second.request, second.reply, second.count) == (0x651, 0x652, 40)
    assert (pair.request, pair.reply, pair.count) == (0x641, 0x642, 60)
    assert "its byte 1 is byte 0 of the request + 0x40" in pair.evidence
    assert pair.delay_ns == pytest.approx(400_000, rel=0.01)


def test_packets_are_recognised_and_drafted_with_their_transport(tmp_path: Path) -> None:
    """ISO-TP both ways, with flow control, and fast packets of three parameter groups."""
    Ecu = IdField("ecu", range(8))
    talk = Protocol("talk", link="can")
    uds = IsoTp(to_device=0x7E0 + Ecu, from_device=0x7E8 + Ecu)
    talk.message("Ask", transport=uds, direction="to device", payload=Struct("data" / GreedyBytes))
    talk.message("Answer", transport=uds, direction="from device", payload=Struct("data" / GreedyBytes))
    for group in (0x1F805, 0x1FA04, 0x1F801):
        talk.message(
            f"Group{group:X}", transport=FastPacket(), id=6 << 26 | group << 8 | 7, extended=True,
            payload=Struct("data" / GreedyBytes),
        )  # fmt: skip
    encoder = talk.variant().encoder
    frames: list[Frame] = []

    def send(name: str, data: bytes, **captures: int) -> None:
        for one in encoder.encode(name, data=data, **captures):
            frames.append(
                Frame(one.arbitration_id, bytes(one.data), len(frames) / 1000, "can0", one.is_extended_id)
            )
            if one.data[0] >> 4 == 1 and not one.is_extended_id:
                frames.append(Frame(0x7E0, b"\x30\0\0", len(frames) / 1000, "can0"))

    for number in range(12):
        send("Ask", bytes([0x22, number]), ecu=0)
        send("Answer", bytes([0x62, number] * 15), ecu=0)
        for name in ("Group1F805", "Group1FA04", "Group1F801"):
            send(name, bytes([number] * 20))
    guess = guessed(frames)
    assert [one.name for one in guess.protocols] == ["NMEA 2000", "ISO-TP", "fast packet"]
    assert {one.transport for one in guess.messages} == {"IsoTp()", "FastPacket()"}
    counts = accounted(drafted(guess, tmp_path), frames)
    assert counts == f"total={len(frames)} decoded={len(frames) - 12} control=12 records=60"


def sent_by(transport: Transport, identifiers: Iterable[int], damaged: int = 0) -> list[Frame]:
    """Packets of 20, 5 and 100 bytes by turns, and a plain frame behind each round; every `damaged`-th frame is lost."""
    spoken = Protocol("spoken", link="can")
    for identifier in identifiers:
        payload = Struct("data" / GreedyBytes)
        spoken.message(f"M{identifier:X}", transport=transport, id=identifier, extended=True, payload=payload)
    encoder = spoken.variant().encoder
    frames: list[Frame] = []
    for number in range(15):
        made = [Frame(0x18F00401, bytes([number, 7 * number & 255, 3]), is_extended_id=True)]
        for size, identifier in zip((20, 5, 100), identifiers, strict=True):
            data = bytes((number * 7 + at * 3) & 255 for at in range(size))
            sent = encoder.next(f"M{identifier:X}", data=data)
            made += sent if isinstance(sent, list) else [sent]
        frames += made
    return [
        Frame(one.arbitration_id, bytes(one.data), at / 1000, "can0", True)
        for at, one in enumerate(frames)
        if not damaged or at % damaged
    ]


def test_sessions_of_j1939_are_drafted_with_their_transport(tmp_path: Path) -> None:
    """Packets have the identifiers of their parameter groups; the frames of sessions are not messages."""
    frames = sent_by(J1939Transport(), (0x1CFEEC01, 0x18FEE002, 0x1CEF0503))
    guess = guessed(frames)
    assert [one.name for one in guess.protocols] == ["J1939", "J1939 transport"]
    carried = [(one.shown, one.transport) for one in guess.messages if one.transport]
    assert carried == [("1CEF0503", "J1939Transport()"), ("1CFEEC01", "J1939Transport()")]
    protocol = drafted(guess, tmp_path)
    assert accounted(protocol, frames) == f"total={len(frames)} decoded={len(frames)} records=60"
    assert guess.as_dict()["messages"][-1]["frames"] == 60


def test_transfers_of_cyphal_are_drafted_with_their_tail_byte(tmp_path: Path) -> None:
    """Those of several frames have a CRC that holds; a subject with single frames only counts by its tail byte."""
    frames = sent_by(TailByte(), (0x107D552A, 0x107D5530, 0x1013372A))
    guess = guessed(frames)
    assert [one.name for one in guess.protocols] == ["Cyphal"]
    assert len([one for one in guess.messages if one.transport == "TailByte()"]) == 3
    protocol = drafted(guess, tmp_path)
    assert accounted(protocol, frames) == f"total={len(frames)} decoded={len(frames)} records=60"


@pytest.mark.parametrize("transport", [J1939Transport(), TailByte()])
def test_packets_that_are_not_whole_stay_frames(transport: Transport, tmp_path: Path) -> None:
    """Where every third frame is missing the evidence is not complete, and nothing is said."""
    frames = sent_by(transport, (0x1CFEEC01, 0x18FEE002, 0x1CEF0503), damaged=3)
    guess = guessed(frames)
    assert not any(one.transport for one in guess.messages)
    assert accounted(drafted(guess, tmp_path), frames).startswith(
        f"total={len(frames)} decoded={len(frames)} "
    )


def test_canopen_is_recognised_by_heartbeats_and_sdo() -> None:
    """And its other frames by their nodes."""
    frames = [Frame(0x705, b"\x05", number / 10, "can0") for number in range(20)]
    frames += [Frame(0x185, bytes([number, 0]), number / 10 + 0.01, "can0") for number in range(20)]
    for number in range(10):
        frames.append(Frame(0x605, bytes([0x40, number, 0x20, 0, 0, 0, 0, 0]), number / 10 + 0.02, "can0"))
        frames.append(Frame(0x585, bytes([0x4B, number, 0x20, 0, 7, 0, 0, 0]), number / 10 + 0.021, "can0"))
    guess = guessed(frames)
    (standard,) = guess.protocols
    assert (standard.name, standard.keys) == ("CANopen", (0x185, 0x585, 0x605, 0x705))
    assert [(one.request, one.reply) for one in guess.pairs] == [(0x605, 0x585)]


def test_what_an_installed_protocol_decodes_is_not_guessed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Unless it is asked for."""
    monkeypatch.setattr("aces_tools.reading.fitting.list_protocols", lambda: ["hubo"])
    hubo = pytest.importorskip("aces_protocols.hubo.spec").hubo
    encoder = hubo.variant().encoder
    frames = [
        Frame(made.arbitration_id, bytes(made.data), number / 100, "can0")
        for number in range(60)
        for made in [encoder.encode("Encoder", board=3, position=[number, -number])]
    ]
    frames += [Frame(0x7AB, bytes([number]), number / 100, "can0") for number in range(5)]
    guess = guessed(frames, known=True)
    assert guess.known[0].name.startswith("hubo")
    assert guess.decoded == 60
    assert [one.shown for one in guess.messages] == ["7AB"]
    assert len(guessed(frames).messages) == 2


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2))
def test_any_frames_make_a_draft_that_accounts_for_them(seed: int, tmp_path: Path) -> None:
    """Noise of all kinds of frames and lengths, few and many."""
    drawn = np.random.default_rng(seed)
    frames: list[Frame] = []
    for number in range(200):
        fd = bool(drawn.integers(2))
        length = int(drawn.choice([0, 1, 8, 12] if fd else [0, 1, 5, 8]))
        extended = bool(drawn.integers(2))
        data = drawn.integers(0, 4 if seed else 256, length, np.uint8).tobytes()
        frames.append(Frame(int(drawn.integers(3)), data, number / 1000, "can0", extended, is_fd=fd))
    counts = accounted(drafted(guessed(frames), tmp_path), frames)
    assert counts == "total=200 decoded=200 records=200"


def test_no_frames_are_no_messages() -> None:
    """Of an empty recording nothing is said."""
    assert guessed([]).as_dict()["messages"] == []


def test_work_is_bounded_by_bytes_not_by_identifiers(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Beyond them messages are declared, and their bytes are left alone."""
    monkeypatch.setattr("aces_lab.guess.traffic.BYTES", 20)
    frames = [
        Frame(0x100 + one * 0x111, bytes([number] * 8), number / 100, "can0")
        for one in range(5)
        for number in range(9)
    ]
    guess = guessed(frames)
    assert [len(one.fields) > 0 for one in guess.messages] == [True, True, True, False, False]
    assert accounted(drafted(guess, tmp_path), frames) == "total=45 decoded=45 records=45"


def test_identifiers_alone_are_no_protocol(monkeypatch: pytest.MonkeyPatch) -> None:
    """ODrive and CANopen take most of all identifiers; noise at any of them is neither, and real values are."""
    monkeypatch.setattr("aces_tools.reading.fitting.list_protocols", lambda: ["canopen", "odrive"])
    odrive = pytest.importorskip("aces_protocols.odrive.spec").odrive
    drawn = np.random.default_rng(4)
    ids = drawn.choice(2048, 30, replace=False).tolist()
    noise = [Frame(ids[n % 30], drawn.bytes(8), n / 1000, "can0") for n in range(600)]
    assert guessed(noise, known=True).known == ()
    encoder = odrive.variant().encoder
    real: list[Frame] = []
    for n in range(300):
        made = encoder.encode("EncoderEstimates", node=n % 3, position=np.sin(n / 50), velocity=n / 100)
        real.append(Frame(made.arbitration_id, bytes(made.data), n / 100, "can0"))
    (known,) = guessed(real, known=True).known
    assert known.name.startswith("odrive")


def test_a_car_is_no_odrive(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two identifiers whose contents any bytes can be say nothing for a protocol that takes most identifiers."""
    monkeypatch.setattr("aces_tools.reading.fitting.list_protocols", lambda: ["odrive"])
    frames = [*periodic(0x220, 300, 1), *periodic(0x386, 300, 2)]
    frames = [Frame(frame.arbitration_id, bytes(frame.data) + b"\0", frame.timestamp) for frame in frames]
    guess = guessed(frames, known=True)
    assert (guess.known, [message.shown for message in guess.messages]) == ((), ["220", "386"])


def test_what_is_bytes_alone_is_guessed_beside_its_protocol(monkeypatch: pytest.MonkeyPatch) -> None:
    """CANopen does not know what a PDO carries: it is left to be guessed, and says nothing for CANopen."""
    monkeypatch.setattr("aces_tools.reading.fitting.list_protocols", lambda: ["canopen"])
    frames = [Frame(0x701, b"\x05", n / 10, "can0") for n in range(90)]
    frames += [Frame(0x181, bytes([n, 7]), n / 10, "can0") for n in range(10)]
    guess = guessed(frames, known=True)
    (known,) = guess.known
    assert (known.name.partition(":")[0], round(known.share, 2)) == ("canopen", 0.9)
    assert guess.decoded == 90
    assert [one.shown for one in guess.messages] == ["181"]
    assert guessed([*frames[:10], *frames[90:]], known=True).known == ()


def test_kinds_of_frames_of_one_identifier_are_told_apart() -> None:
    """Classic, FD and remote frames."""
    frames = [Frame(0x123, bytes(12), n / 10, "can0", is_fd=True) for n in range(2)]
    frames += [Frame(0x123, b"", n / 10, "can0", is_remote_frame=True) for n in range(2)]
    frames += [Frame(0x123, b"\x01", n / 10, "can0") for n in range(2)]
    assert sorted(one.shown for one in guessed(frames).messages) == ["123", "123 FD", "123 remote"]
