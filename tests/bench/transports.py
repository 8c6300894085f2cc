"""Packets as columns, beside loops in Python that put frames together and unpack their values.

1. The frames of eight senders are interleaved. Every contender ends with values in hand, from frames in memory.
2. The loops are the shortest that are right on a recording without fault: no accounts, no time-outs, one channel.
3. The live scanner, and a loop for ISO-TP, have what columns have: each frame in one bin, time-outs, losses with their
   reason. Before anything is measured, all give the same counts on frames of which some are lost and some come twice.
4. Figures are of processor time, which other programs on the machine hardly move.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from construct import Array, Byte, Const, Int16ub, Int16ul, Int32sl, Struct
from msgspec.structs import replace

from aces_bus import Frame, FrameTable, make_column_scanner
from aces_bus.frames import message_to_frame
from aces_bus.protocol import (
    FastPacket,
    IdField,
    IsoTp,
    J1939Transport,
    Protocol,
    Quantity,
    TailByte,
    Variant,
)

from .rows import BenchRow, fastest, optional

#: Senders whose packets are under way at the same time, and packets of each before they repeat.
SENDERS, PACKETS = 8, 20
#: Frames a column scanner is given at once, as `aces decode` joins them.
BATCH = 1 << 18


def isotp() -> tuple[Protocol, list[list[Frame]]]:
    """Answers of eight ECUs: 16 numbers in 6 frames."""
    protocol = Protocol("diagnostics", link="can")
    uds = IsoTp(from_device=0x7E8 + IdField("ecu", range(8)))
    payload = Struct(Const(0x62, Byte), "did" / Int16ub, "values" / Array(16, Quantity(Int16ub, scale=0.1)))
    protocol.message("Data", transport=uds, direction="from device", payload=payload)
    return protocol, _senders(
        protocol,
        "Data",
        [{"ecu": k, "did": k, "values": [0.1 * j for j in range(16)]} for k in range(SENDERS)],
    )


def fast_packets() -> tuple[Protocol, list[list[Frame]]]:
    """Positions of eight boats: 43 bytes in 7 frames."""
    protocol = Protocol("boats", link="can")
    payload = Struct(
        "sid" / Byte, "date" / Int16ul, "where" / Array(10, Quantity(Int32sl, unit="°", scale=1e-7))
    )
    identifier = 3 << 26 | 129029 << 8 | IdField("source", range(8))
    protocol.message("Position", transport=FastPacket(), id=identifier, extended=True, payload=payload)
    return protocol, _senders(
        protocol,
        "Position",
        [{"source": k, "sid": k, "date": k, "where": [1.5] * 10} for k in range(SENDERS)],
    )


def parameter_groups() -> tuple[Protocol, list[list[Frame]]]:
    """Faults of eight control units, to all: 40 bytes in 7 frames."""
    protocol = Protocol("vehicle", link="can")
    payload = Struct("lamps" / Int16ul, "counts" / Array(19, Quantity(Int16ul, scale=0.1)))
    identifier = IdField("priority", range(8)) << 26 | 0xFECA << 8 | IdField("source", range(8))
    protocol.message("Faults", transport=J1939Transport(), id=identifier, extended=True, payload=payload)
    fields = [{"priority": 6, "source": k, "lamps": k, "counts": [0.1 * k] * 19} for k in range(SENDERS)]
    return protocol, _senders(protocol, "Faults", fields)


def transfers() -> tuple[Protocol, list[list[Frame]]]:
    """What eight motor controllers measure, with a check: 38 bytes in 6 frames."""
    protocol = Protocol("drone", link="can")
    payload = Struct("errors" / Int16ul, "values" / Array(18, Quantity(Int16ul, scale=0.1)))
    identifier = 16 << 24 | 1034 << 8 | IdField("node", range(1, 9))
    protocol.message(
        "Status",
        transport=TailByte(version=0),
        id=identifier,
        extended=True,
        payload=payload,
        check_extra=bytes(range(8)),
    )
    fields = [{"node": 1 + k, "errors": k, "values": [0.1 * k] * 18} for k in range(SENDERS)]
    return protocol, _senders(protocol, "Status", fields)


def _senders(protocol: Protocol, message: str, fields: list[dict[str, Any]]) -> list[list[Frame]]:
    encoder = protocol.variant().encoder
    return [
        [message_to_frame(frame) for _ in range(PACKETS) for frame in encoder.next(message, **one)]
        for one in fields
    ]


def isotp_loop(frames: list[Frame]) -> list[Any]:
    """ISO-TP by hand."""
    unpack = struct.Struct(">xH16H").unpack
    under_way: dict[int, list[Any]] = {}
    out: list[Any] = []
    for frame in frames:
        data, sender = frame.data, frame.arbitration_id
        kind = data[0] >> 4
        if kind == 2:
            mine = under_way.get(sender)
            if mine is not None and data[0] & 15 == mine[1] & 15:
                mine[1] += 1
                mine[2] += data[1:]
                if len(mine[2]) >= mine[0]:
                    did, *values = unpack(mine[2][: mine[0]])
                    out.append((sender, did, [value * 0.1 for value in values]))
                    del under_way[sender]
        elif kind == 1:
            under_way[sender] = [(data[0] & 15) << 8 | data[1], 1, bytearray(data[2:])]
    return out


class IsoTpAccounts:
    """ISO-TP by hand with what columns have, too: each frame in one bin, losses with their reason, time-outs."""

    def __init__(self) -> None:
        self.total = self.decoded = self.control = self.malformed = self.records = 0
        self.losses: list[tuple[Frame, str]] = []
        #: By sender: bytes of the packet, those so far, number of the next frame, its frames.
        self.under_way: dict[int, list[Any]] = {}

    def lose(self, frames: list[Frame], reason: str) -> None:
        """Count frames that are in no packet."""
        self.malformed += len(frames)
        self.losses += [(frame, reason) for frame in frames]

    def feed(self, frames: list[Frame]) -> list[Any]:
        """The values of the packets that frames complete."""
        unpack = struct.Struct(">xH16H").unpack
        under_way, out = self.under_way, list[Any]()
        for frame in frames:
            data, sender, time = frame.data, frame.arbitration_id, frame.timestamp or 0.0
            self.total += 1
            kind = data[0] >> 4 if data else 4
            if kind == 3:
                self.control += 1
                continue
            mine = under_way.get(sender)
            if mine is not None and kind < 3 and time - (mine[3][-1].timestamp or 0.0) > 1.0:
                del under_way[sender]
                self.lose(mine[3], "timed out")
                mine = None
            if kind == 2:
                if mine is None:
                    self.lose([frame], "no first frame")
                    continue
                size, so_far, number, its = mine
                if data[0] & 15 != number & 15:
                    if number > 1 and data == its[-1].data:
                        self.lose([frame], "repeated")
                    else:
                        del under_way[sender]
                        self.lose([*its, frame], f"frame {number + 1} missing")
                    continue
                its.append(frame)
                so_far += data[1:]
                mine[2] = number + 1
                if len(so_far) < size and len(data) == 8:
                    continue
                del under_way[sender]
                if len(so_far) < size:
                    self.lose(its, f"frame {number + 1} is short")
                elif size == 35 and so_far[0] == 0x62:
                    self.decoded += len(its)
                    self.records += 1
                    did, *values = unpack(so_far[:size])
                    out.append((sender, time, did, [value * 0.1 for value in values]))
                else:
                    self.lose(its, "no message")
            elif kind < 2:
                if mine is not None:
                    del under_way[sender]
                    self.lose(mine[3], "restarted")
                size = (data[0] & 15) << 8 | data[1] if kind and len(data) > 1 else 0
                if size > 7 and len(data) == 8:
                    under_way[sender] = [size, bytearray(data[2:]), 1, [frame]]
                else:
                    self.lose([frame], "no message")
            else:
                self.lose([frame], "no frame of ISO-TP")
        return out


def fast_packet_loop(frames: list[Frame]) -> list[Any]:
    """Fast packets by hand."""
    unpack = struct.Struct("<BH10i").unpack
    under_way: dict[tuple[int, int], list[Any]] = {}
    out: list[Any] = []
    for frame in frames:
        data = frame.data
        sender, number = (frame.arbitration_id, data[0] >> 5), data[0] & 31
        if number == 0:
            under_way[sender] = [data[1], 1, bytearray(data[2:])]
        else:
            mine = under_way.get(sender)
            if mine is not None and number == mine[1]:
                mine[1] += 1
                mine[2] += data[1:]
                if len(mine[2]) >= mine[0]:
                    sid, date, *values = unpack(mine[2][: mine[0]])
                    out.append((sender, sid, date, [value * 1e-7 for value in values]))
                    del under_way[sender]
    return out


def parameter_group_loop(frames: list[Frame]) -> list[Any]:
    """J1939's broadcasts by hand."""
    unpack = struct.Struct("<20H").unpack
    under_way: dict[int, list[Any]] = {}
    out: list[Any] = []
    for frame in frames:
        data, identifier = frame.data, frame.arbitration_id
        sender, group = identifier & 0xFF, identifier >> 16 & 0xFF
        if group == 0xEB:
            mine = under_way.get(sender)
            if mine is not None and data[0] == mine[1]:
                mine[1] += 1
                mine[2] += data[1:]
                if len(mine[2]) >= mine[0]:
                    lamps, *counts = unpack(mine[2][: mine[0]])
                    out.append((sender, lamps, [value * 0.1 for value in counts]))
                    del under_way[sender]
        elif group == 0xEC and data[0] == 32:
            under_way[sender] = [data[1] | data[2] << 8, 1, bytearray()]
    return out


def transfer_loop(frames: list[Frame]) -> list[Any]:
    """DroneCAN's transfers by hand, their check not looked at."""
    unpack = struct.Struct("<19H").unpack
    under_way: dict[int, list[Any]] = {}
    out: list[Any] = []
    for frame in frames:
        data, sender = frame.data, frame.arbitration_id
        tail = data[-1]
        if tail & 0x80:
            under_way[sender] = [tail & 0x1F, 1, bytearray(data[2:-1])]
            continue
        mine = under_way.get(sender)
        if mine is not None and tail & 0x1F == mine[0] and tail >> 5 & 1 == mine[1]:
            mine[1] ^= 1
            mine[2] += data[:-1]
            if tail & 0x40:
                errors, *values = unpack(mine[2])
                out.append((sender, errors, [value * 0.1 for value in values]))
                del under_way[sender]
    return out


def can_isotp(isotp: Any, frames: list[Frame]) -> int:
    """ISO-TP by python-can-isotp, one receiver a sender, without unpacking; how many packets."""
    waiting: dict[int, list[Any]] = {0x7E8 + k: [] for k in range(SENDERS)}
    receivers = {
        number: isotp.TransportLayerLogic(
            rxfn=lambda timeout, mine=mine: mine.pop() if mine else None,
            txfn=lambda message: None,
            address=isotp.Address(rxid=number, txid=number - 8),
            params={"listen_mode": True},
        )
        for number, mine in waiting.items()
    }
    count, message = 0, isotp.CanMessage
    for frame in frames:
        number, receiver = frame.arbitration_id, receivers[frame.arbitration_id]
        waiting[number].append(message(number, len(frame.data), bytearray(frame.data)))
        receiver.process()
        if receiver.available():
            receiver.recv()
            count += 1
    return count


def columns(variant: Variant, tables: list[FrameTable]) -> int:
    """Every column of every packet; how many packets."""
    scanner = make_column_scanner([variant])
    count = 0
    for frames in tables:
        for table in scanner.feed(frames):
            count += len(table)
            for column in table.columns():
                assert len(column.values) == len(table)
    return count


def taking_turns(senders: list[list[Frame]]) -> list[Frame]:
    """A frame of each sender in turn, 0.2 ms apart."""
    frames = [frame for together in zip(*senders, strict=True) for frame in together]
    return [replace(frame, timestamp=number * 2e-4) for number, frame in enumerate(frames)]


def accounts(protocol: Protocol, block: list[Frame], peers: list[Any]) -> None:
    """Check that columns and peers account alike for frames of which some are lost, some late and some come twice."""
    faulty = [
        frame if number < len(block) // 2 + 20 else replace(frame, timestamp=(frame.timestamp or 0.0) + 2.0)
        for number, frame in enumerate(block)
        for _ in range(0 if number % 53 == 7 else 2 if number % 41 == 3 else 1)
    ]
    whole = make_column_scanner([protocol.variant()])
    whole.feed(FrameTable.from_frames(faulty))
    bins = ("total", "decoded", "control", "malformed", "records")
    expected = [getattr(whole.counts, name) for name in bins]
    for peer in peers:
        peer.feed(faulty)
        counts = getattr(peer, "counts", peer)
        assert [getattr(counts, name) for name in bins] == expected, (peer, expected)


def frame_by_frame(scanner: Any, frames: list[Frame]) -> int:
    """Every record of the live scanner, as frames come; how many."""
    feed = scanner.feed
    return sum([len(feed((frame,))) for frame in frames])


def run(*, quick: bool) -> list[BenchRow]:
    """Four transports."""
    found: list[BenchRow] = []
    for subject, (protocol, senders), loop in (
        ("ISO-TP → values", isotp(), isotp_loop),
        ("fast packets → values", fast_packets(), fast_packet_loop),
        ("J1939 packets → values", parameter_groups(), parameter_group_loop),
        ("DroneCAN transfers → values", transfers(), transfer_loop),
    ):
        block = taking_turns(senders)
        careful = [IsoTpAccounts] if loop is isotp_loop else []
        accounts(protocol, block, [protocol.scanner(), *(make() for make in careful)])
        count = max(1, (2 if quick else 4) * BATCH // len(block))
        some = block * max(1, count // 8)
        whole = FrameTable.concat([FrameTable.from_frames(block)] * count)
        time = np.arange(len(whole)) * 200_000
        whole = FrameTable(
            time, whole.channel, whole.id, whole.flags, whole.length, whole.data, whole.channels
        )
        tables = [whole.take(slice(at, at + BATCH)) for at in range(0, len(whole), BATCH)]
        variant = protocol.variant()
        scanner: Any = protocol.scanner()
        packets = len(loop(block))
        assert columns(variant, tables) == packets * count
        assert len(scanner.feed(block)) == packets
        # What is slow has a part of the frames.
        contenders: dict[str, tuple[int, Callable[[], object]]] = {
            "columns": (len(whole), partial(columns, variant, tables)),
            "a loop in Python": (len(some), partial(loop, some)),
            "live scanner, the same accounts": (len(block), partial(frame_by_frame, scanner, block)),
        }
        for make in careful:
            contenders["a loop with the same accounts"] = (len(some), partial(make().feed, some))
        library = optional("isotp") if loop is isotp_loop else None
        if library is not None:
            contenders["python-can-isotp"] = (len(block), partial(can_isotp, library, block))
        best = fastest(
            {name: run for name, (_, run) in contenders.items()},
            rounds=3 if quick else 5,
            one_thread=True,
        )
        rates = {name: contenders[name][0] / seconds for name, seconds in best.items()}
        found.append(BenchRow(subject, "columns", rates["columns"], "frames/s"))
        found += [
            BenchRow(subject, name, rates[name], "frames/s", rates["columns"] / rates[name])
            for name in rates
            if name != "columns"
        ]
    return found
