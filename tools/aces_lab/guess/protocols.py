"""Open standards that frames follow, recognised by their form alone: ISO-TP, J1939, NMEA 2000 and its fast packets, CANopen.

1. Each is recognised by what its frames must be (headers, counts, orders), with how many of them were; facts are those of
   `aces_bus.protocol.declare` (ISO 15765-2, SAE J1939-21, NMEA 2000 fast packet) and of CiA 301.
2. A standard is named where enough frames could have spoken against it, and few did.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from aces_bus import FrameTable
from aces_bus._lazy import np
from aces_bus.frames import EXTENDED, FD, REMOTE
from aces_bus.protocol.record import PlainValue

from .carried import CarriedGuess, cyphal_packets, j1939_packets
from .fields import Array

#: Frames that must have spoken for a standard, and the share that may speak against it.
ENOUGH, AGAINST = 3, 0.05
#: Frames of one identifier that are looked at.
ROWS = 5000
#: Parameter groups: of J1939's transport protocol, requests and addresses (PDU formats); NMEA 2000's own are of data page 1.
STEERING = {
    0xE8: "acknowledgement",
    0xEA: "request",
    0xEB: "transport data",
    0xEC: "transport connection",
    0xEE: "address claim",
}
NMEA_2000 = (0x1ED00, 0x1FFFF)
#: CANopen's states of a node in its heartbeat (CiA 301, 7.2.8.3.2.2).
STATES = (0, 4, 5, 0x7F)


@dataclass(frozen=True)
class ProtocolGuess:
    """A standard, the keys of its frames, and what speaks for it. `name` is "ISO-TP", "J1939", "NMEA 2000", "CANopen" …"""

    name: str
    keys: tuple[int, ...]
    confidence: float
    evidence: str
    #: Packets under other identifiers than those of their frames.
    packets: tuple[CarriedGuess, ...] = ()

    def as_dict(self) -> dict[str, PlainValue]:
        """Return the guess in JSON's kinds."""
        return {
            "name": self.name,
            "identifiers": [key & 0x1FFF_FFFF for key in self.keys],
            "confidence": round(self.confidence, 2),
            "evidence": self.evidence,
        }


def recognised(frames: FrameTable) -> list[ProtocolGuess]:
    """Return the standards that frames follow, in the order of a recording."""
    order = np.argsort(frames.key, kind="stable")
    keys, starts = np.unique(frames.key[order], return_index=True)
    rows = (
        {int(key): part for key, part in zip(keys, np.split(order, starts[1:]), strict=True)}
        if len(keys)
        else {}
    )
    found = [
        *_j1939(rows),
        *_put_together(frames, rows),
        *_packets(frames, rows),
        *_canopen(frames, rows),
    ]
    return found


# ---------------------------------------------------------------------- extended identifiers


def group_of(key: int) -> int:
    """Return the parameter group of an identifier: without priority, source and, below PDU format 240, destination."""
    number = key >> 8 & 0x3FFFF
    return number if number >> 8 & 0xFF >= 0xF0 else number & ~0xFF


def _j1939(rows: dict[int, Array]) -> Iterator[ProtocolGuess]:
    keys = [key for key in rows if key & EXTENDED and not key & (FD | REMOTE)]
    if len(keys) < ENOUGH:
        return
    marine = [key for key in keys if NMEA_2000[0] <= group_of(key) <= NMEA_2000[1]]
    steering = sorted(
        {STEERING[key >> 16 & 0xFF] for key in keys if not key >> 24 & 3 and key >> 16 & 0xFF in STEERING}
    )
    broadcast = [key for key in keys if not key >> 24 & 3 and key >> 16 & 0xFF in (0xF0, 0xFE, 0xFD)]
    sources = len({key & 0xFF for key in keys})
    groups = len({group_of(key) for key in keys})
    usual = sum(key >> 26 & 7 in (2, 3, 6, 7) for key in keys) / len(keys)
    said = f"{groups} parameter groups of {sources} sources"
    if steering:
        said += f", among them {', '.join(steering)}"
    if len(marine) >= 2 and len(marine) + len(steering) >= 0.5 * len(keys):
        said += f"; {len(marine)} identifiers have parameter groups of NMEA 2000 (data page 1, from 0x{NMEA_2000[0]:X} on)"
        yield ProtocolGuess("NMEA 2000", tuple(keys), 0.9, said)
    elif usual >= 0.9 and len(broadcast) + len(steering) >= 0.6 * len(keys) and sources < len(keys):
        yield ProtocolGuess("J1939", tuple(keys), 0.8 if steering else 0.6, said)


# ---------------------------------------------------------------------- packets of several frames


def _put_together(frames: FrameTable, rows: dict[int, Array]) -> Iterator[ProtocolGuess]:
    keys, found = j1939_packets(frames, rows)
    if found:
        sizes = [size for transfer in found for size in transfer.sizes]
        said = f"{sum(transfer.count for transfer in found)} packets of {min(sizes)} to {max(sizes)} bytes are whole"
        yield ProtocolGuess("J1939 transport", keys, 0.95, said, tuple(found))
    keys, found = cyphal_packets(frames, rows)
    if found:
        said = f"{sum(transfer.count for transfer in found)} transfers are whole, those of several frames with their CRC"
        yield ProtocolGuess("Cyphal", keys, 0.95, said)


def _packets(frames: FrameTable, rows: dict[int, Array]) -> Iterator[ProtocolGuess]:
    tp: dict[int, str] = {}
    fast: dict[int, str] = {}
    for key, all_rows in rows.items():
        if key & REMOTE:
            continue
        some = all_rows[:ROWS]
        data, lengths = frames.data[some], frames.length[some]
        if (said := _iso_tp(data, lengths)) is not None:
            tp[key] = said
        elif key & EXTENDED and (said := _fast(data, lengths)) is not None:
            fast[key] = said
    for name, group in (("ISO-TP", tp), ("fast packet", fast)):
        if group:
            first = next(iter(group))
            yield ProtocolGuess(name, tuple(group), 0.9, f"{first & 0x1FFF_FFFF:X}: {group[first]}")


def _iso_tp(data: Array, lengths: Array) -> str | None:
    """Return what says that frames are those of ISO 15765-2; None where they are not, or only have single frames."""
    if (lengths < 2).any():
        return None
    kind, low = data[:, 0] >> 4, data[:, 0] & 15
    if (kind > 3).any():
        return None
    single, first, following, flow = (kind == kind_number for kind_number in range(4))
    if (single & ((low == 0) | (low >= lengths)) & (lengths <= 8)).mean() > AGAINST or (
        flow & (low > 2)
    ).any():
        return None
    if not (first | following).any() and flow.sum() >= ENOUGH and single.any():
        return f"{int(single.sum())} single frames, {int(flow.sum())} of flow control"
    size = (low.astype(np.int64) << 8) | data[:, 1]
    if first.sum() < 1 or following.sum() < ENOUGH or (first & (size < 8) & (size != 0)).any():
        return None
    # A number follows another, or a first frame begins anew with 1.
    relevant = np.flatnonzero(first | following)
    before, after = relevant[:-1], relevant[1:]
    expected = np.where(first[before], 1, (low[before] + 1) & 15)
    goes_on = following[after]
    right = (low[after] == expected)[goes_on]
    if not len(right) or right.mean() < 1 - 2 * AGAINST:
        return None
    return (
        f"{int(first.sum())} first frames, {_counted(right)} consecutive frames with the number that is due"
    )


def _fast(data: Array, lengths: Array) -> str | None:
    """Return what says that frames are those of fast packets; None where they are not."""
    if (lengths != 8).mean() > AGAINST:
        return None
    number, sequence = data[:, 0] & 31, data[:, 0] >> 5
    first = number == 0
    if first.sum() < 2 or (~first).sum() < ENOUGH:
        return None
    sizes = data[first, 1]
    before, after = number[:-1], number[1:]
    goes_on = after != 0
    right = (after == before + 1) & (sequence[1:] == sequence[:-1])
    longest = np.maximum.reduceat(number, np.flatnonzero(first)) if first.any() else number[:1]
    needed = sizes.astype(np.int64) // 7  # the first frame has six bytes, others seven
    fits = (longest <= needed + 1) & (sizes > 6) & (sizes <= 223)
    if right[goes_on].mean() < 1 - 2 * AGAINST or fits.mean() < 1 - 2 * AGAINST:
        return None
    sizes_said = f"sizes of {int(sizes.min())} to {int(sizes.max())} bytes"
    said = f"{int(first.sum())} first frames with {sizes_said}"
    return f"{said}, {_counted(right[goes_on])} frames with the number that is due"


def _counted(right: Array) -> str:
    return f"{int(right.sum())} of {len(right)}"


# ---------------------------------------------------------------------- CANopen


def _canopen(frames: FrameTable, rows: dict[int, Array]) -> Iterator[ProtocolGuess]:
    standard = {key: some[:ROWS] for key, some in rows.items() if key < 0x800}
    found: dict[int, None] = {}
    said: list[str] = []
    beats = [key for key, some in standard.items() if 0x701 <= key <= 0x77F and _is_heartbeat(frames, some)]
    if beats:
        found.update(dict.fromkeys(beats))
        said.append(f"heartbeats of {len(beats)} node{'s' if len(beats) > 1 else ''}")
    servers = [
        key
        for key in standard
        if 0x581 <= key <= 0x5FF
        and key + 0x80 in standard
        and _are_sdo(frames, standard[key + 0x80], standard[key])
    ]
    if servers:
        found.update(dict.fromkeys([*servers, *(key + 0x80 for key in servers)]))
        said.append(f"SDO transfers with {len(servers)} node{'s' if len(servers) > 1 else ''}")
    if not said:
        return
    for key, what, longest in ((0x000, "NMT commands", 2), (0x080, "SYNC", 1)):
        if key in standard and (frames.length[standard[key]] <= longest).all():
            found[key] = None
            said.append(what)
    nodes = {key & 0x7F for key in found if key & 0x7F}
    found.update(dict.fromkeys(key for key in standard if 0x080 < key < 0x580 and key & 0x7F in nodes))
    yield ProtocolGuess("CANopen", tuple(sorted(found)), min(0.95, 0.55 + 0.2 * len(said)), ", ".join(said))


def _is_heartbeat(frames: FrameTable, rows: Array) -> bool:
    return bool((frames.length[rows] == 1).all() and np.isin(frames.data[rows, 0] & 0x7F, STATES).all())


def _are_sdo(frames: FrameTable, asked: Array, answered: Array) -> bool:
    """Return whether all have eight bytes, with command specifiers that exist, and mostly speak of the same objects."""
    if (frames.length[asked] != 8).any() or (frames.length[answered] != 8).any():
        return False
    ways = (
        np.isin(frames.data[asked, 0] >> 5, range(7)).all()
        and np.isin(frames.data[answered, 0] >> 5, range(7)).all()
    )
    starts = frames.data[asked][np.isin(frames.data[asked, 0] >> 5, (1, 2))][:, 1:4]
    objects = {row.tobytes() for row in starts}
    replies = frames.data[answered][np.isin(frames.data[answered, 0] >> 5, (2, 3))][:, 1:4]
    return bool(
        ways
        and len(objects)
        and len(replies)
        and np.mean([row.tobytes() in objects for row in replies]) > 0.9
    )
