"""pysbf2: drawn blocks are the same numbers to it and to us, in both directions; so are our worked examples.

1. Numbers are compared raw, as they are on the wire: it shows do-not-use values as numbers.
2. It knows no revisions: it writes 0, and reads every block as one of the latest. Blocks that differ are restamped here.
"""

from __future__ import annotations

import io
import struct
from collections.abc import Iterator, Mapping
from random import Random
from typing import Any

import pytest

from aces_bus import as_dict
from aces_protocols.sbf.spec import sbf
from tests.oracles.foreign import oracle

pysbf2: Any = oracle("pysbf2", "pysbf2")
helpers: Any = oracle("pysbf2.sbfhelpers", "pysbf2")

#: Drawn blocks of each kind.
DRAWN = 40
MODE = {"mode.solution": "Type", "mode.auto_base": "AutoSet", "mode.is_2d": "2D", "error": "Error"}
PVT = {
    **MODE, "undulation": "Undulation", "course": "COG", "clock_bias": "RxClkBias", "clock_drift": "RxClkDrift",
    "time_system": "TimeSystem", "datum": "Datum", "satellites": "NrSV", "corrections.orbit_clock": "Corr_OrbClkUsed",
    "corrections.range": "Corr_RngUsed", "corrections.ionosphere": "Corr_IonoUsed",
    "corrections.orbit_accuracy": "Corr_OrbAccUsed", "corrections.precision_approach": "Corr_DO229Active",
    "corrections.rtk": "Corr_RTKType", "reference": "ReferenceID", "correction_age": "MeanCorrAge", "signals": "SignalInfo",
    "alerts.raim": "RAIMIntegrity", "alerts.hpca_failed": "GalHPCAFail", "alerts.ionospheric_storm": "GalIonStorm",
    "alerts.signal_authentication": "SigAuth", "alerts.message_authentication": "NavMsgAuth", "bases": "NrBases",
    "ppp.seed_age": "PPPSeedAge", "ppp.seed": "PPPSeedType", "latency": "Latency", "horizontal_accuracy": "HAccuracy",
    "vertical_accuracy": "VAccuracy", "misc.base_arp": "BaseARP", "misc.phase_centre": "PhaseCtrOffset",
    "misc.arp_offset": "ARPOffset",
}  # fmt: skip


def covariances(ours: tuple[str, ...], theirs: tuple[str, ...], odd: Mapping[str, str]) -> dict[str, str]:
    """Names of a covariance block's numbers."""
    pairs = [(at, at) for at in range(4)] + [(a, b) for a in range(4) for b in range(a + 1, 4)]
    names = {f"{ours[a]}_{ours[b]}": f"Cov_{theirs[a]}{theirs[b]}" for a, b in pairs}
    return {**MODE, **{name: odd.get(other, other) for name, other in names.items()}}


#: Block → our field → its attribute; `{}` is the number of the sub-block, from 1.
SAME: dict[str, dict[str, str]] = {
    "PVTCartesian": {**PVT, "x": "X", "y": "Y", "z": "Z", "vx": "Vx", "vy": "Vy", "vz": "Vz"},
    "PVTGeodetic": {
        **PVT, "latitude": "Latitude", "longitude": "Longitude", "height": "Height", "v_north": "Vn", "v_east": "Ve",
        "v_up": "Vu",
    },
    "PosCovCartesian": covariances(("x", "y", "z", "b"), ("x", "y", "z", "b"), {}),
    "PosCovGeodetic": covariances(
        ("lat", "lon", "height", "b"), ("lat", "lon", "hgt", "b"), {"Cov_hgtb": "Cov_hb"}
    ),
    "VelCovCartesian": covariances(("vx", "vy", "vz", "dt"), ("Vx", "Vy", "Vz", "Dt"), {}),
    "VelCovGeodetic": covariances(("vn", "ve", "vu", "dt"), ("Vn", "Ve", "Vu", "Dt"), {}),
    "DOP": {
        "satellites": "NrSV", "pdop": "PDOP", "tdop": "TDOP", "hdop": "HDOP", "vdop": "VDOP", "hpl": "HPL", "vpl": "VPL"
    },
    "EndOfPVT": {},
    "EndOfAtt": {},
    "EndOfMeas": {},
    "BaseVectorCart": {
        f"vectors.#.{ours}": theirs
        for ours, theirs in {
            **MODE, "satellites": "nrSv", "dx": "DeltaX", "dy": "DeltaY", "dz": "DeltaZ", "v_dx": "DeltaVx",
            "v_dy": "DeltaVy", "v_dz": "DeltaYz", "azimuth": "Azimuth", "elevation": "Elevation", "reference": "ReferenceID",
            "correction_age": "CorrAge", "signals": "SignalInfo",
        }.items()
    },
    "BaseVectorGeod": {
        f"vectors.#.{ours}": theirs
        for ours, theirs in {
            **MODE, "satellites": "NrSV", "east": "DeltaEast", "north": "DeltaNorth", "up": "DeltaUp", "v_east": "DeltaVe",
            "v_north": "DeltaVn", "v_up": "DeltaVu", "azimuth": "Azimuth", "elevation": "Elevation",
            "reference": "ReferenceID", "correction_age": "CorrAge", "signals": "SignalInfo",
        }.items()
    },
    "AttEuler": {
        "satellites": "NrSV", "mode": "Mode", "info": "Info", "heading": "Heading", "pitch": "Pitch", "roll": "Roll",
        "pitch_rate": "PitchDot", "roll_rate": "RollDot", "heading_rate": "HeadingDot",
    },
    "AttCovEuler": {
        "heading_heading": "Cov_HeadHead", "pitch_pitch": "Cov_PitchPitch", "roll_roll": "Cov_RollRoll",
        "heading_pitch": "Cov_HeadPitch", "heading_roll": "Cov_HeadRoll", "pitch_roll": "Cov_PitchRoll",
    },
    "MeasEpoch": {
        "clock_jumps": "CumClkJumps",
        **{
            f"satellites.#.{ours}": theirs
            for ours, theirs in {
                "channel": "RxChannel", "signal.number": "SigIdxLo", "signal.antenna": "AntennaID", "satellite": "SVID",
                "doppler": "Doppler", "cn0": "CN0", "lock_time": "LockTime", "info.smoothed": "PRSmoothed",
                "info.half_cycle": "HalfCycleAmbiguity", "info.more": "SigIdxHi", "count": "N2",
            }.items()
        },
    },
    "ChannelStatus": {
        f"channels.#.{ours}": theirs
        for ours, theirs in {
            "satellite": "SVID", "frequency": "FreqNr", "sky.azimuth": "Azimuth", "sky.course": "RiseSet",
            "health": "HealthStatus", "elevation": "Elevation", "channel": "RxChannel", "count": "N2",
        }.items()
    },
    "QualityInd": {
        "indicators.#.kind": "QualityType", "indicators.#.value": "QualityValue"
    },
    "ReceiverStatus": {
        "cpu_load": "CPULoad", "uptime": "UpTime", "commands": "CmdCount", "temperature": "Temperature",
        "front_ends.#.gain": "Gain", "front_ends.#.variance": "SampleVar", "front_ends.#.blanking": "BlankingStat",
    },
    "InputLink": {
        f"links.#.{ours}": theirs
        for ours, theirs in {
            "connection": "CD", "type": "Type", "age": "AgeOfLastMessage", "bytes_received": "NrBytesReceived",
            "bytes_accepted": "NrBytesAccepted", "messages_received": "NrMsgReceived", "messages_accepted": "NrMsgAccepted",
        }.items()
    },
    "NTRIPClientStatus": {
        f"clients.#.{ours}": theirs
        for ours, theirs in {
            "connection": "CDIndex", "status": "Status", "error": "ErrorCode", "info": "Info"
        }.items()
    },
    "xPPSOffset": {"sync_age": "SyncAge", "time_scale": "TimeScale", "offset": "Offset"},
    "ExtEvent": {
        "pin": "Source", "polarity": "Polarity", "offset": "Offset", "clock_bias": "RxClkBias", "position_age": "PVTAge",
    },
    "ReceiverTime": {
        "year": "UTCYear", "month": "UTCMonth", "day": "UTCDay", "hour": "UTCHour", "minute": "UTCMin", "second": "UTCSec",
        "leap_seconds": "DeltaLS", "sync": "SyncLevel",
    },
}  # fmt: skip
#: Bytes behind the time stamp: before sub-blocks, of a sub-block, of one inside it; where their sizes stand.
SHAPES: dict[str, tuple[int, int, int, bytes]] = {
    "BaseVectorCart": (2, 52, 0, b"\x34"),
    "BaseVectorGeod": (2, 52, 0, b"\x34"),
    "MeasEpoch": (6, 20, 12, b"\x14\x0c"),
    "ChannelStatus": (6, 12, 8, b"\x0c\x08"),
    "QualityInd": (2, 2, 0, b""),
    "InputLink": (2, 20, 0, b"\x14"),
    "NTRIPClientStatus": (2, 4, 0, b"\x04"),
    "ReceiverStatus": (18, 4, 0, b"\x04"),
}
SIZES = {
    name: len(sbf[name].examples[0].packet.data) - 14 for name in SAME if name not in SHAPES
}  # with their padding
#: Blocks of receivers whose groups have more bytes than ours: their name, and the bytes of a group as drawn.
LONGER = {
    "BaseVectorCart": 60,
    "BaseVectorGeod": 56,
    "InputLink": 24,
    "NTRIPClientStatus": 12,
    "SatVisibility": 12,
}
SATELLITES = {
    f"satellites.#.{ours}": theirs
    for ours, theirs in {
        "satellite": "SVID", "frequency": "FreqNr", "azimuth": "Azimuth", "elevation": "Elevation", "course": "RiseSet",
        "source": "SatelliteInfo",
    }.items()
}  # fmt: skip
#: Where the counts stand: from the body's first byte, and in a sub-block.
COUNTS = {"ReceiverStatus": 14}
INSIDE = {"MeasEpoch": 19, "ChannelStatus": 9}


def stamped(number: int, revision: int, body: bytes) -> bytes:
    """A block, its CRC by pysbf2."""
    rest = struct.pack("<HH", number | revision << 13, 8 + len(body)) + body
    return b"$@" + struct.pack("<H", helpers.calc_crc(rest)) + rest


def drawn(name: str, dice: Random) -> bytes:
    """A block of drawn bytes whose counts are true."""
    number = next(number for number, (known, _) in pysbf2.SBF_MSGIDS.items() if known == name)
    revision = dice.randrange(2 if name.startswith("PVT") else 1 if name == "ExtEvent" else 0, 8)
    body = bytearray(dice.randbytes(6))
    if name not in SHAPES:
        return stamped(number, revision, bytes(body) + dice.randbytes(SIZES[name]))
    first, size, inner, sizes = SHAPES[name]
    head, count = bytearray(dice.randbytes(first)), dice.randrange(6)
    at = COUNTS.get(name, 0)
    head[at] = count
    head[at + 1 : at + 1 + len(sizes)] = sizes
    body += head
    for _ in range(count):
        group = bytearray(dice.randbytes(size))
        if inner:
            group[INSIDE[name]] = dice.randrange(4)
            group += dice.randbytes(inner * group[INSIDE[name]])
        body += group
    return stamped(number, revision, bytes(body) + dice.randbytes(-(8 + len(body)) % 4))


def inside(values: Any, path: str) -> Any:
    for name in path.split("."):
        values = values[int(name)] if name.isdigit() else values[name]
    return values


def pairs(name: str, values: Any, theirs: Any) -> Iterator[tuple[str, Any, Any]]:
    """Our numbers of a block and its, by name."""
    same = SATELLITES if name == "SatVisibility" else SAME[name]
    for ours, other in {"tow": "TOW", "week": "WNc", **same}.items():
        if "#" not in ours:
            yield ours, inside(values, ours), getattr(theirs, other)
            continue
        head, _, tail = ours.partition(".#.")
        for at in range(len(values[head])):
            yield (
                f"{head}.{at}.{tail}",
                inside(values[head][at], tail),
                getattr(theirs, f"{other}_{at + 1:02d}"),
            )
    if name == "MeasEpoch" and not theirs._scaling:
        yield from measured(values, theirs)


def signed(value: int, bits: int) -> int:
    return value - (1 << bits) if value >> bits - 1 else value


def measured(values: Any, theirs: Any) -> Iterator[tuple[str, Any, Any]]:
    """Numbers in two places, which it has as two."""
    for at, first in enumerate(values["satellites"]):
        tag = f"_{at + 1:02d}"
        get = theirs.__dict__.__getitem__
        yield "range", first["code"]["range"], get("CodeMSB" + tag) << 32 | get("CodeLSB" + tag)
        yield "carrier", first["carrier"], (get("CarrierMSB" + tag) << 16) + get("CarrierLSB" + tag)
        for number, other in enumerate(first["others"]):
            both = f"{tag}_{number + 1:02d}"
            offsets = other["offsets"]
            code = signed(get("CodeOffsetMSB" + both), 3) * 65_536 + get("CodeOffsetLSB" + both)
            doppler = signed(get("DopplerOffsetMSB" + both), 5) * 65_536 + get("DopplerOffsetLSB" + both)
            yield "code offset", offsets["code"], code
            yield "doppler offset", offsets["doppler"], doppler
            yield "carrier", offsets["carrier"], (get("CarrierMSB" + both) << 16) + get("CarrierLSB" + both)
            yield "cn0", other["cn0"], get("CN0" + both)
            yield "lock time", other["lock_time"], get("LockTime" + both)


def same(one: Any, other: Any) -> bool:
    return bool(one == other or (one != one and other != other))


def ours_of(packet: bytes) -> Any:
    (record,) = sbf.scanner(raw=True, include_unknown=True).feed(packet)
    return record


@pytest.mark.parametrize("name", SAME)
def test_drawn_blocks_are_the_same_numbers_both_ways(name: str) -> None:
    """It reads ours as we do; what it writes of these numbers we read as them; and we write the same bytes again."""
    dice = Random(name)
    compared = 0
    for _ in range(DRAWN):
        packet = drawn(name, dice)
        record = ours_of(packet)
        assert type(record).__name__ == name
        theirs = pysbf2.SBFReader.parse(packet, scaling=False)
        for field, mine, its in pairs(name, as_dict(record), theirs):
            assert same(mine, its), (field, mine, its)
            compared += 1
        again = sbf.variant().encoder.build(sbf.variant()[name], as_dict(record), raw=True)
        assert again == packet or any(value != value for _, value, _ in pairs(name, as_dict(record), theirs))
        given = {key: value for key, value in vars(theirs).items() if not key.startswith("_")}
        written = pysbf2.SBFMessage(name, scaling=False, **given).serialize()
        if name in SHAPES and name != "QualityInd" and name != "ReceiverStatus":
            continue  # it writes no padding of sub-blocks, and leaves out counts inside them
        back = ours_of(stamped(struct.unpack_from("<H", written, 4)[0], 2, written[8:]))
        for field, mine, its in pairs(name, as_dict(back), theirs):
            assert same(mine, its), (field, mine, its)
            compared += 1
    assert compared >= 2 * DRAWN


@pytest.mark.parametrize("name", LONGER)
def test_groups_that_are_longer_than_ours_are_read_as_it_reads_them(name: str) -> None:
    """By the size that the block states; what is behind our fields is kept, and written again."""
    dice, size = Random(name), LONGER[name]
    number = next(number for number, (known, _) in pysbf2.SBF_MSGIDS.items() if known == name)
    compared = 0
    for count in (0, 1, 2, 5) * 5:
        body = dice.randbytes(6) + bytes([count, size]) + dice.randbytes(count * size)
        packet = stamped(number, dice.randrange(8), body + dice.randbytes(-(8 + len(body)) % 4))
        record = ours_of(packet)
        assert type(record).__name__ == f"{name}Longer"
        theirs = pysbf2.SBFReader.parse(packet, scaling=False)
        for field, mine, its in pairs(name, as_dict(record), theirs):
            assert same(mine, its), (field, mine, its)
            compared += 1
        assert (
            sbf.variant().encoder.build(sbf.variant()[f"{name}Longer"], as_dict(record), raw=True) == packet
        )
    assert compared > 150


#: Of ReceiverSetup, its names of our fields, and the bytes behind the header at each revision's end.
SETUP = {
    "marker": "MarkerName", "marker_number": "MarkerNumber", "observer": "Observer", "agency": "Agency",
    "serial_number": "RxName", "firmware": "RxVersion", "antenna_serial_number": "AntSerialNbr", "antenna": "AntType",
    "offset_up": "deltaH", "offset_east": "deltaE", "offset_north": "deltaN", "marker_type": "MarkerType",
    "gnss_firmware": "GNSSFWVersion", "product": "ProductName", "latitude": "Latitude", "longitude": "Longitude",
    "height": "Height", "station": "StationCode", "monument": "MonumentIdx", "receiver": "ReceiverIdx",
    "country": "CountryCode",
}  # fmt: skip
ENDS = (240, 260, 300, 340, 396)


@pytest.mark.parametrize("revision", range(8))
def test_a_block_of_each_revision_has_its_fields(revision: int) -> None:
    """ReceiverSetup, as it builds it, cut off where the revision ends: its fields are what was given, and no others."""
    dice = Random(revision)
    sizes = {
        "reserved": 2,
        **dict.fromkeys(("marker",), 60),
        "agency": 40,
        "gnss_firmware": 40,
        "product": 40,
    }
    sizes |= {"station": 10, "country": 3}
    for _ in range(50):
        given: dict[str, Any] = {"TOW": dice.randrange(1 << 29), "WNc": dice.randrange(9999)}
        for ours, theirs in SETUP.items():
            if ours[:6] == "offset" or ours in ("latitude", "longitude", "height"):
                given[theirs] = dice.randrange(-4000, 4000) / 64
            elif ours in ("monument", "receiver"):
                given[theirs] = dice.randrange(256)
            else:
                size = sizes.get(ours, 20)
                given[theirs] = dice.randbytes(dice.randrange(size)).hex()[:size].encode().ljust(size, b"\0")
        whole = pysbf2.SBFMessage("ReceiverSetup", scaling=False, Reserved=0, Reserved1=bytes(21), **given)
        packet = stamped(5902, revision, whole.serialize()[8 : 8 + ENDS[min(revision, 4)]])
        (record,) = sbf.scanner(include_unknown=True).feed(packet)
        assert type(record).__name__ == "ReceiverSetup" + (f"Revision{revision}" if revision < 4 else "")
        found = {ours: value for ours, value in as_dict(record).items() if ours in SETUP}
        assert len(found) == (11, 12, 13, 14, 21)[min(revision, 4)]
        for ours, value in found.items():
            wanted = given[SETUP[ours]]
            assert value == (wanted.rstrip(b"\0").decode() if isinstance(wanted, bytes) else wanted)
        assert sbf.encode(type(record).__name__, **as_dict(record)) == packet


@pytest.mark.parametrize("name", SAME)
def test_it_reads_our_worked_examples_alike(name: str) -> None:
    """Scaled, where the value is to be used. The age of corrections in BaseVectorCart it leaves in units of 0.01 s; the
    offset of a pulse, ns here, is s there.
    """
    for example in sbf[name].examples:
        packet = example.packet.data
        (record,) = sbf.scanner().feed(packet)
        theirs = pysbf2.SBFReader.parse(packet)
        for field, mine, its in pairs(name, as_dict(record), theirs):
            if isinstance(mine, float) and (name, field) != ("BaseVectorCart", "vectors.0.correction_age"):
                its = its * 1e9 if name == "xPPSOffset" else its - 100 if field == "temperature" else its
                assert mine == pytest.approx(its, abs=1e-9), field


def test_it_finds_our_blocks_in_a_stream() -> None:
    """The same blocks at the same places, with sentences and noise between them. Of earlier revisions it refuses those that
    are shorter than the latest by fixed fields of text."""
    packets = [
        example.packet.data
        for message in sbf.declared
        if message.name != "ReceiverSetupRevision0"
        for example in message.examples
    ]
    known = [p for p in packets if struct.unpack_from("<H", p, 4)[0] & 0x1FFF in pysbf2.SBF_MSGIDS]
    stream = b"".join(packet + b"$GPGGA,1*00\r\n" for packet in known)
    reader = pysbf2.SBFReader(io.BytesIO(stream), protfilter=pysbf2.SBF_PROTOCOL, quitonerror=0)
    theirs = [raw for raw, _ in reader]
    ours = [record.meta.raw for record in sbf.scanner().feed(stream)]
    assert ours == known
    assert theirs == known
