"""The printed Wireshark dissector shows what the scanner decodes: tshark reads our captures with it, value for value.

1. Wireshark itself is the oracle of its own Lua; without tshark on the machine these tests skip.
2. Compared are raw numbers as they are, floats to the digits that tshark prints.
"""

from __future__ import annotations

import math
import random
import re
import shutil
import struct
import subprocess
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest
from construct import (
    Byte,
    Default,
    Float32b,
    GreedyBytes,
    GreedyRange,
    Int16sb,
    Int16ub,
    PrefixedArray,
    Struct,
    VarInt,
    this,
)
from hypothesis import settings
from msgspec.structs import replace

from aces_bus import Frame, FrameTable, Unknown, make_scanner
from aces_bus.protocol import (
    BitLayout,
    CanScanner,
    Crc,
    DataIds,
    Enumeration,
    Items,
    Protocol,
    Quantity,
    Split,
    Sum,
    Text,
    Variant,
    bits,
)
from aces_bus.protocol.live.stream import StreamScanner
from aces_bus.protocol.plan import nodes as p
from aces_bus.protocol.plan.flatten import fixed_leaves, flatten
from aces_bus.testing.packets import UndrawableError
from aces_lab.exchange import print_dissector
from aces_lab.formats.pcap.writer import PcapngWriter
from aces_protocols.hubo.spec import hubo
from aces_protocols.nmea0183.spec import nmea0183
from aces_protocols.robotis.spec import robotis
from tests.laws.corners import CORNERS
from tests.laws.drawn import drawn_packet
from tests.specs.catalogue import SPECS as CATALOGUE

TSHARK = shutil.which("tshark")
needs_tshark = pytest.mark.skipif(TSHARK is None, reason="tshark is not installed")

#: In the long profile all protocols, variants and directions; each run of tshark takes half a second.
IS_LONG = settings().max_examples > 100
SEEDS = 20 if IS_LONG else 3
SPECS = {**CATALOGUE, **CORNERS}
CAN = [n for n, one in SPECS.items() if one.link == "can"] if IS_LONG else ["automotive"]
ALL_STREAMS = ["robotis", *(n for n, one in SPECS.items() if one.link != "can")]
STREAMS = ALL_STREAMS if IS_LONG else ["robotis", "nmea0183"]

#: A message as tshark shows it: field without the protocol's name → what it shows, once for each time it is there.
Shown = dict[str, list[str]]


def tshark(folder: Path, source: str, capture: Path, *more: str) -> list[list[Shown]]:
    """What the dissector shows of each packet of a capture: the messages in it."""
    assert TSHARK is not None
    script = folder / "dissector.lua"
    script.write_text(source, encoding="utf-8")
    command = [TSHARK, "-X", f"lua_script:{script}", "-r", str(capture), "-T", "pdml", *more]
    run = subprocess.run(command, capture_output=True, encoding="utf-8", errors="replace", timeout=60)
    assert "Lua" not in run.stderr, run.stderr
    assert run.returncode == 0, run.stderr
    found = []
    for packet in ElementTree.fromstring(run.stdout).iter("packet"):
        assert packet.find(".//field[@name='_ws.lua.error']") is None, ElementTree.tostring(packet)
        assert packet.find(".//proto[@name='_ws.lua.error']") is None, ElementTree.tostring(packet)
        found.append([shown for proto in packet.iter("proto") for shown in _messages(proto)])
    return found


def _messages(proto: ElementTree.Element) -> Iterable[Shown]:
    """A message is whatever has a field `….message` or `….problem` as its child."""
    for parent in proto.iter():
        names = [str(child.get("name")) for child in parent]
        if any(name.endswith((".message", ".problem")) and name.count(".") == 1 for name in names):
            shown: Shown = {}
            for field in parent.iter("field"):
                name = str(field.get("name"))
                if not name.startswith("_ws"):  # a line of text
                    shown.setdefault(name.partition(".")[2], []).append(str(field.get("show")))
            yield shown


def record(folder: Path, frames: Sequence[Frame]) -> Path:
    """Frames as a pcapng file of our own."""
    path = folder / "frames.pcapng"
    with path.open("wb") as file:
        writer = PcapngWriter(file, "frames.pcapng")
        writer.write(FrameTable.from_frames(frames))
        writer.close()
    return path


def pcap_file(folder: Path, packets: Sequence[bytes], link: int = 147) -> Path:
    """Packets of a user's link type, in a pcap file."""
    path = folder / "packets.pcap"
    with path.open("wb") as file:
        file.write(struct.pack("<IHHIIII", 0xA1B2C3D4, 2, 4, 0, 0, 1 << 18, link))
        for number, packet in enumerate(packets):
            file.write(
                struct.pack("<IIII", number // 1000, number % 1000 * 1000, len(packet), len(packet)) + packet
            )
    return path


def value_at(record: Any, path: str) -> Any:
    value = record
    for part in path.split("."):
        if value is None:
            return None
        value = value[int(part)] if part.isdigit() else getattr(value, part)
    return value


def compare(variant: Variant, record: Any, physical: Any, shown: Shown) -> int:
    """Assert that a message is shown as it is decoded; how many values were compared."""
    name = record.meta.message
    assert shown["message"] == [name], (shown, record)
    own = next((key.partition(".")[0] for key in shown if "." in key), "")
    count = 0
    for leaf in fixed_leaves(variant[name])[0]:
        node = leaf.node
        key = f"{own}.{leaf.identifier}"
        if isinstance(node, p.Opaque):
            continue
        if isinstance(node, p.DelimitedField):
            found = shown.get(key, [""])[0]
            text = getattr(record, leaf.path)
            assert found == (text or "") or not _is_plain(text), (leaf, found, text)
            count += 1
        elif isinstance(node, p.MoreCells):
            texts = list(getattr(record, leaf.path))
            assert shown.get(key, []) == texts or not all(map(_is_plain, texts))
            count += 1
        elif isinstance(node, p.ListNode):
            raw, meant = ((value_at(one, leaf.path) or ()) for one in (record, physical))
            assert len(shown.get(key, [])) == len(raw), (leaf, shown, raw)
            count += compare_items(node, key, list(raw), list(meant), shown)
        else:
            count += compare_values(
                leaf.node, key, [value_at(record, leaf.path)], [value_at(physical, leaf.path)], shown
            )
    return count


def compare_items(node: p.ListNode, key: str, raw: list[Any], meant: list[Any], shown: Shown) -> int:
    """As `compare`, of the items of a list: those of one kind have their values under one name, in their order."""
    count = 0
    if isinstance(node, p.Repeated):
        alike = [(f"{key}.each", node.plan, raw, meant)]
    else:
        assert isinstance(node, p.TaggedItems)
        alike = []
        for kind in node.kinds:
            both = [
                (a.data, b.data)
                for a, b in zip(raw, meant, strict=True)
                if a.kind in (kind.name, kind.number) and not a.reason
            ]
            alike.append((f"{key}.{kind.name}", kind.plan, [a for a, _ in both], [b for _, b in both]))
    for start, plan, some, others in alike:
        for leaf in plan.leaves:
            inside = leaf.path.partition(".")[2]
            values, meanings = (
                [value_at(one, inside) if inside else one for one in these] for these in (some, others)
            )
            count += compare_values(leaf.node, f"{start}{leaf.path[4:]}", values, meanings, shown)
    return count


def compare_values(node: p.Node, key: str, values: list[Any], meanings: list[Any], shown: Shown) -> int:
    """As `compare`, of the values under one name, raw and as they are meant."""
    there = [(value, meant) for value, meant in zip(values, meanings, strict=True) if value is not None]
    if (isinstance(node, p.Rest) and node.size > 8) or (isinstance(node, p.Scalar) and len(node.bits) > 64):
        return 0
    scale = node.scale if isinstance(node, (p.Scalar, p.FromIdentifier)) else None
    is_scaled = scale is not None and (scale.scale != 1 or bool(scale.offset))
    if isinstance(node, p.Scalar) and node.is_bytes:
        if node.kind == "bytes":
            wanted = [value.hex() for value, _ in there if value]
            assert [text.replace(":", "") for text in shown.get(key, [])] == wanted, (key, shown, there)
        return len(there)
    texts = shown.get(f"{key}.raw" if f"{key}.raw" in shown else key, [])
    assert len(texts) == len(there), (key, shown, there)
    for index, (text, (value, meant)) in enumerate(zip(texts, there, strict=True)):
        if isinstance(node, p.Scalar) and node.kind == "float":
            assert _near(float(text), value), (key, text, value)
            continue
        assert int(text, 0) == int(value), (key, text, value)
        if is_scaled and isinstance(meant, (int, float)):
            assert _near(float(shown[key][index]), meant), (key, shown, meant)
    return len(there)


def _is_plain(text: str) -> bool:
    """Whether tshark prints a text as it is."""
    return text.isascii() and text.isprintable() and "\\" not in text


def _near(one: float, other: float) -> bool:
    if math.isnan(other) or math.isinf(other):
        return True  # tshark's packets for them differ between versions
    return math.isclose(one, other, rel_tol=1e-5, abs_tol=1e-30)


def drawn(variant: Variant, seeds: Iterable[int], direction: Any = None) -> list[Any]:
    """Packets of every message of a variant, each behind the request that it answers."""
    packets: list[Any] = []
    for seed in seeds:
        for message in variant.messages_for(direction):
            try:
                packet = drawn_packet(message, seed, variant)
            except UndrawableError:
                continue
            if packet.request is not None:
                packets += packet.request.as_sent
            packets += packet.as_sent
    return packets


def check_can(folder: Path, variant: Variant, packets: Sequence[Frame]) -> set[str]:
    """Assert that tshark shows of each frame what a scanner decodes; names of the messages that were among them."""
    frames = [Frame(w.arbitration_id, w.data, is_extended_id=w.is_extended_id, is_remote_frame=w.is_remote_frame,
                    is_fd=w.is_fd, timestamp=0.001 * n) for n, w in enumerate(packets)]  # fmt: skip
    raw = make_scanner([variant], include_unknown=True, raw=True).feed(frames)
    physical = make_scanner([variant], include_unknown=True).feed(frames)
    source, _ = print_dissector(variant)
    shown = tshark(folder, source, record(folder, frames))
    assert len(shown) == len(raw) == len(frames)
    seen = set()
    compared = 0
    for frame, one, meant, messages in zip(frames, raw, physical, shown, strict=True):
        if isinstance(one, Unknown):
            assert all("message" not in message for message in messages), (frame, one, messages)
            continue
        assert len(messages) == 1, (frame, one, messages)
        compared += compare(variant, one, meant, messages[0])
        seen.add(type(one).__name__)
    assert compared
    return seen


@pytest.mark.slow
@needs_tshark
@pytest.mark.parametrize("dialect", ["D12", "D08"])
def test_every_message_of_hubo_is_shown_as_it_is_decoded(dialect: str, tmp_path: Path) -> None:
    """Also replies that only their request tells, sign and magnitude, split fields, captured boards and opcodes."""
    short = ("hubo2plus",) if dialect == "D12" else ("hubo2",)
    for configuration in hubo.configurations if IS_LONG else short:
        variant = hubo.variant(dialect, configuration)
        seen = check_can(tmp_path, variant, drawn(variant, range(SEEDS)))
        assert seen == set(variant.messages)


@needs_tshark
@pytest.mark.parametrize("name", CAN)
def test_every_message_of_other_protocols_on_can(name: str, tmp_path: Path) -> None:
    """29-bit patterns, CAN FD, remote frames, checks over the identifier, multiplexers, floats, registers."""
    variants = SPECS[name].variants()
    for variant in variants if IS_LONG else variants[-1:]:
        seen = check_can(tmp_path, variant, drawn(variant, range(SEEDS)))
        assert seen, variant


#: Protocols whose transports are tables of their frames' kinds.
CARRIED = ["uds_like", "nmea2000_like", "dronecan_like", "cyphal_like"]


def disturbed(frames: Sequence[Frame], rng: random.Random) -> list[Frame]:
    """Some of the frames lost, doubled, swapped or cut, at their times."""
    found: list[Frame] = []
    for frame in frames:
        chance = rng.random()
        if chance < 0.1:
            continue
        found.append(frame if chance < 0.9 else replace(frame, data=frame.data[: rng.randrange(9)]))
        if chance > 0.97 and len(found) > 1:
            found[-1], found[-2] = found[-2], found[-1]
        if 0.8 < chance < 0.9:
            found.append(found[-1])
    return [replace(frame, timestamp=0.01 * n + (5.0 if n > 60 else 0.0)) for n, frame in enumerate(found)]


@pytest.mark.slow
@needs_tshark
@pytest.mark.parametrize("name", CARRIED)
def test_packets_of_several_frames(name: str, tmp_path: Path) -> None:
    """As the scanner has them: a message at its last frame, parts at the others, the reason where frames are malformed."""
    variant = SPECS[name].variants()[-1]
    frames = drawn(variant, range(SEEDS))
    frames += disturbed(frames * 3, random.Random(name))
    frames = [replace(frame, timestamp=frame.timestamp or 0.0) for frame in frames]
    source, _ = print_dissector(variant)
    shown = tshark(tmp_path, source, record(tmp_path, frames), "-2", "-R", "frame")
    wanted: dict[int, list[Any]] = {}
    for raw in (True, False):
        found, origins = CanScanner([variant], include_unknown=True, raw=raw).feed_numbered(
            frames, range(len(frames))
        )
        for one, origin in zip(found, origins, strict=True):
            wanted.setdefault(origin, []).append(one)
    reasons = set()
    for number, messages in enumerate(shown):
        both = wanted.get(number)
        if both is None:  # a part of a packet, or pending
            assert all("message" not in one and "problem" not in one for one in messages)
        elif isinstance(both[0], Unknown):
            reason = both[0].reason.partition(",")[0]  # the dissector gives no lengths that would do
            reasons.add(reason)
            if not reason.startswith("control"):
                assert [one.get("problem") for one in messages] == [[reason]], (number, both[0])
        else:
            compare(variant, both[0], both[1], messages[0])
    assert any(reason.startswith("malformed: frame") for reason in reasons), reasons


def check_stream(folder: Path, variant: Variant, direction: Any, packets: Sequence[bytes]) -> set[str]:
    """As `check_can`, for packets of a stream."""
    scanners = [
        StreamScanner([variant], direction=direction, include_unknown=True, raw=raw) for raw in (True, False)
    ]
    wanted: list[list[Any]] = []
    for packet in packets:
        raw, physical = (scanner.datagram(packet) for scanner in scanners)
        wanted.append([(a, b) for a, b in zip(raw, physical, strict=True) if not isinstance(a, Unknown)])
    source, _ = print_dissector(variant, direction=direction)
    shown = tshark(folder, source, pcap_file(folder, packets))
    seen = set()
    is_sure = not any(flatten(message).opaque for message in variant.messages.values())
    for packet, records, messages in zip(packets, wanted, shown, strict=True):
        told = [message for message in messages if "message" in message]
        names = [message["message"][0] for message in told] + [raw.meta.message for raw, _ in records]
        if not is_sure and names[: len(told)] != names[len(told) :]:
            continue  # some are told by their head alone, as the losses say
        assert names[: len(told)] == [a.meta.message for a, _ in records], (packet.hex(), records, messages)
        for (raw, physical), message in zip(records, told, strict=True):
            compare(variant, raw, physical, message)
            seen.add(raw.meta.message)
    return seen


@needs_tshark
@pytest.mark.parametrize("name", STREAMS)
def test_streams(name: str, tmp_path: Path) -> None:
    """Lengths, ends, silence, stuffing, checks, characters: packets whole, cut, behind junk and several at once."""
    protocol = {"robotis": robotis, "nmea0183": nmea0183, **SPECS}[name]
    for variant in protocol.variants():
        for direction in ("to device", "from device", "both") if IS_LONG else ("both",):
            if not variant.messages_for(direction):
                continue
            packets = drawn(variant, range(SEEDS), direction)
            rng = random.Random(name)
            packets += [rng.randbytes(3) + packet for packet in packets[:6]]
            packets += [packet[: rng.randrange(1, len(packet) + 1)] for packet in packets[:6]]
            packets.append(b"".join(packets[:8]))
            assert check_stream(tmp_path, variant, direction, packets), variant


def segments(folder: Path, packets: Sequence[bytes]) -> Path:
    """Packets as segments of one TCP connection to port 5000: raw IPv4 in a pcap file."""
    path = folder / "segments.pcap"
    sent = 1
    with path.open("wb") as file:
        file.write(struct.pack("<IHHIIII", 0xA1B2C3D4, 2, 4, 0, 0, 1 << 18, 101))
        for number, packet in enumerate(packets):
            ip = struct.pack(
                ">BBHHHBBH4s4s", 0x45, 0, 40 + len(packet), number, 0, 64, 6, 0, b"\n\0\0\1", b"\n\0\0\2"
            )
            tcp = struct.pack(">HHIIBBHHH", 4000, 5000, sent, 1, 0x50, 0x18, 8192, 0, 0)
            data = ip + tcp + packet
            file.write(struct.pack("<IIII", number, 0, len(data), len(data)) + data)
            sent += len(packet)
    return path


tlv = Protocol("tlv", link="serial", baud=115_200)
_packet = tlv.framing(
    sync=b"\xfa\xff",
    header=Struct("mid" / Byte, "length" / Byte),
    size=this.length + 5,
    max_size=200,
    check=Sum(negated=True, over=slice(1, -1)),
)
_kinds: dict[str, tuple[int, Any]] = {
    "speed": (1, Quantity(Int16sb, unit="m/s", scale=0.1)),
    "state": (0x203, Struct("mode" / Enumeration(Byte, off=0, on=1), "height" / Float32b)),
    "flags": (9, BitLayout(2, "a" / bits(3), "b" / bits(9, signed=True))),
    "text": (10, Struct("text" / Text(4), "rest" / GreedyBytes)),
}
_packet(
    "Data",
    match={"mid": 0x36},
    payload=Struct("time" / Byte, "items" / Items(tag=Int16ub, size=Byte, kinds=_kinds)),
)
_packet(
    "Pairs", match={"mid": 0x37}, payload=Struct("pairs" / GreedyRange(Struct("a" / Byte, "b" / Int16sb)))
)
_packet(
    "Levels",
    match={"mid": 0x38},
    payload=Struct("levels" / PrefixedArray(Byte, Quantity(Int16ub, unit="V", scale=0.5))),
)
_packet(
    "Fixed",
    match={"mid": 0x39},
    payload=Struct("place" / Quantity(Split((16, 32), (0, 16), signed=True), scale=2.0**-32)),
)


@pytest.mark.slow
@needs_tshark
def test_lists_of_items(tmp_path: Path) -> None:
    """Tagged items, known, unknown and malformed; groups up to the end and counted; behind sums that are negated."""
    variant = tlv.variant()
    packets = drawn(variant, range(40))
    known = {"kind": "speed", "data": -3.5}, {"kind": "state", "data": {"mode": "on", "height": 0.5}}
    short = {"kind": 0x203, "data": b"\x01", "reason": "size 1"}  # one byte of five
    packets.append(tlv.encode("Data", time=1, items=[*known, {"kind": 77, "data": b"xyz"}, short, known[0]]))
    packets += [packet[:-1] + bytes([packet[-1] ^ 1]) for packet in packets[:4]]
    assert check_stream(tmp_path, variant, "both", packets) == {"Data", "Pairs", "Levels", "Fixed"}


@needs_tshark
def test_sizes_of_a_multiple(tmp_path: Path) -> None:
    """Packets of a multiple of four bytes are shown; those of another size, with a check that holds, are not."""
    padded = Protocol("padded", link="serial")
    framing = padded.framing(
        sync=b"\xaa",
        header=Struct("length" / Byte),
        size=this.length + 0,
        multiple=4,
        max_size=64,
        check=Sum(),
    )
    framing("Line", payload=Struct("value" / Byte, "padding" / Default(GreedyBytes, b"")))
    packets = [padded.encode("Line", value=n, padding=bytes(n)) for n in range(9)]
    for size in range(4, 13):
        body = bytes([size, 7, *range(size - 4)])
        packets.append(b"\xaa" + body + bytes([sum(body) & 0xFF]))
    assert check_stream(tmp_path, padded.variant(), "both", packets) == {"Line"}
    shown = tshark(tmp_path, print_dissector(padded.variant())[0], pcap_file(tmp_path, packets[9:]))
    assert [any("message" in one for one in messages) for messages in shown] == [
        size % 4 == 0 for size in range(4, 13)
    ]


@needs_tshark
def test_checks_over_a_data_id_that_a_counter_chooses(tmp_path: Path) -> None:
    """AUTOSAR's profile 2: each of sixteen ids belongs to one count; with another id's check a frame is malformed."""
    ids = bytes(range(0x31, 0x41))
    protected = Protocol("protected", link="can")
    over = (slice(1, None), DataIds("count", ids))
    layout = BitLayout(8, "crc" / bits(8), "count" / bits(4), "mode" / bits(4), "speed" / bits(16))
    protected.message(
        "State", id=0x200, payload=layout, check=Crc("CRC8-AUTOSAR", field="crc", over=over), length=8
    )
    frames = [
        protected.encode("State", count=n % 16, mode=n % 3, speed=1000 * n, reserved=n << 32)
        for n in range(32)
    ]
    wrong = [replace(frame, data=bytes([frame.data[0] ^ 1]) + frame.data[1:]) for frame in frames[:16]]
    assert check_can(tmp_path, protected.variant(), [*frames, *wrong]) == {"State"}


@needs_tshark
def test_packets_go_on_from_segment_to_segment(tmp_path: Path) -> None:
    """Over TCP a packet may be cut anywhere; who speaks is told by the port."""
    ping, read = robotis.encode("Ping", id=1), robotis.encode("Read", id=2, start=36, count=2)
    stream = b"junk" + ping + read + ping
    source, _ = print_dissector(robotis.variant(), port=5000)
    shown = tshark(tmp_path, source, segments(tmp_path, [stream[:7], stream[7:8], stream[8:17], stream[17:]]))
    told = [(m["message"][0], m) for messages in shown for m in messages if "message" in m]
    assert [name for name, _ in told] == ["Ping", "Read", "Ping"]
    assert (told[1][1]["read.id"], told[1][1]["read.start"]) == (["2"], ["36"])


def test_text_of_a_spec_is_never_code() -> None:
    """Names of values, units and documents are literals of printable ASCII; remarks stay remarks."""
    nasty = 'a"b\\" ]] } os.execute("x")\n--[[ os.execute() \0\u2028é'
    protocol = Protocol("nasty", link="can", doc=nasty)
    payload = Struct(
        "mode" / Enumeration(Byte, {nasty: 1}),
        "x" / Quantity(Byte, unit=nasty, doc=nasty, scale=0.5, names={nasty: 2}),
        "rest" / GreedyRange(Struct("y" / VarInt)),
    )
    protocol.message("Only", id=1, payload=payload, doc=nasty, source=nasty)
    text, losses = print_dissector(protocol.variant())
    assert (losses[0].message, losses[0].field) == ("Only", "")
    table = text.partition("\n-- What follows")[0]
    assert all(line.isprintable() for line in table.split("\n"))
    bare = re.sub(r'"(?:[^"\\\n]|\\\d\d\d)*"', '""', table)
    assert not [line for line in bare.split("\n") if "execute" in line and not line.startswith("-- ")]
    assert '\\\\"' not in bare
