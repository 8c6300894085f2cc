"""Slips that authors of specs make, one at a time in three specs, and the recordings that the sound specs' devices give.

1. A slip is a change of a spec's text; everything else stays. The list is that of an audit of real sheets.
2. Recordings are made by the sound specs' encoders: quantities move smoothly and pass zero, states and flags change, each
   message goes the way that it is declared to go.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import Any

from aces_bus import Frame
from aces_bus.protocol import Protocol
from aces_bus.protocol.files import protocol_of_file
from aces_bus.recordings.base import Chunk

FOLDER = Path(__file__).resolve().parents[1] / "specs" / "slips"
#: Messages of each kind in a recording.
LENGTH = 240
_COUNT = count()


@dataclass(frozen=True)
class Slip:
    """A change of a spec's text: `old` becomes `new`, where it is there once."""

    number: int
    what: str
    spec: str
    old: str
    new: str

    def written(self, folder: Path) -> Path:
        """The spec with the slip, as a file of its own."""
        text = (FOLDER / f"{self.spec}.py").read_text(encoding="utf-8")
        assert text.count(self.old) == 1, f"{self.number}: {self.old!r} is there {text.count(self.old)} times"
        path = folder / f"slip_{self.number}_{next(_COUNT)}.py"
        path.write_text("from construct import *\n" + text.replace(self.old, self.new).replace(
            "from __future__ import annotations\n", ""), encoding="utf-8")  # fmt: skip
        return path


def sound(spec: str) -> Protocol:
    """A spec without a slip."""
    return protocol_of_file(str(FOLDER / f"{spec}.py"))[0]


# fmt: off
SLIPS = [
    Slip(1, "byte order of a number in an example", "imu",
         'Quantity(Int16ub, unit="ms", scale=0.1)),\n', 'Quantity(Int16ul, unit="ms", scale=0.1)),\n'),
    Slip(2, "byte order of a 32-bit number, no example", "imu", 'Quantity(Int32ub, unit="s"', 'Quantity(Int32ul, unit="s"'),
    Slip(3, "byte order of a 16-bit number, no example", "imu",
         'Quantity(Int16sb, unit="m/s²"', 'Quantity(Int16sl, unit="m/s²"'),
    Slip(4, "scale with the wrong sign, no example", "imu", 'unit="m/s²", scale=0.001', 'unit="m/s²", scale=-0.001'),
    Slip(5, "scale off by 10, in an example", "imu", '"angle" / Quantity(Int16sb, unit="°", scale=0.01)',
         '"angle" / Quantity(Int16sb, unit="°", scale=0.1)'),
    Slip(6, "packet length one too short", "imu", "size=this.length + 5", "size=this.length + 4"),
    Slip(7, "packet length one too long", "imu", "size=this.length + 5", "size=this.length + 6"),
    Slip(8, "checksum leaves out a byte", "imu", "max_size=100,\n    gap=0.1,\n    check=Sum(over=slice(2, -1))",
         "max_size=100,\n    gap=0.1,\n    check=Sum(over=slice(3, -1))"),
    Slip(9, "checksum covers the sync byte", "imu", "max_size=100,\n    gap=0.1,\n    check=Sum(over=slice(2, -1))",
         "max_size=100,\n    gap=0.1,\n    check=Sum(over=slice(1, -1))"),
    Slip(10, "checksum of the extended framing starts late", "imu",
         "max_size=600,\n    gap=0.1,\n    check=Sum(over=slice(2, -1))",
         "max_size=600,\n    gap=0.1,\n    check=Sum(over=slice(3, -1))"),
    Slip(11, "two messages with one opcode", "servo", "at(0x0A)", "at(0x09)"),
    Slip(12, "opcode off by one, no example", "imu", '"opcode": 0x32', '"opcode": 0x31'),
    Slip(13, "a field left out inside an item", "imu", ', "status" / Byte))', "))"),
    Slip(14, "a valid but wrong unit", "imu", 'unit="m/s²"', 'unit="m/s"'),
    Slip(15, "an invalid unit inside an item", "imu", 'unit="Pa"', 'unit="pascals"'),
    Slip(16, "enumeration values swapped, no example", "imu", "align=0, navigate=1", "align=1, navigate=0"),
    Slip(17, "enumeration values swapped, in an example", "imu", "slow=1, fast=2", "slow=2, fast=1"),
    Slip(18, "two names for one value", "imu", "navigate=1, fault=2", "navigate=1, fault=1"),
    Slip(19, "signed read as unsigned", "servo", '"fine" / Int16sl', '"fine" / Int16ul'),
    Slip(20, "signed read as unsigned, scaled", "marine", '"pitch" / Quantity(Int16sl', '"pitch" / Quantity(Int16ul'),
    Slip(21, "halves of a 48-bit number swapped", "imu", "Split((16, 32), (0, 16)", "Split((0, 32), (32, 16)"),
    Slip(22, "max_size too small", "imu", "max_size=600", "max_size=60"),
    Slip(23, "direction of a message wrong", "imu", 'match={"opcode": 0x32},\n    direction="from device"',
         'match={"opcode": 0x32},\n    direction="to device"'),
    Slip(24, "one flag bit declared twice", "imu", "clipped=1", "clipped=0"),
    Slip(25, "two flag bits swapped, not compared", "marine", "pump=0, light=1", "pump=1, light=0"),
    Slip(26, "length prefix counts itself", "imu", '"status" / Byte)', '"status" / Byte), includelength=True'),
    Slip(27, "range of a captured node too short", "servo", "range(1, 16)", "range(1, 3)"),
    Slip(28, "range of a captured source longer than its bits", "marine", "range(256)", "range(300)"),
    Slip(29, "shift of the captured node off by one", "servo", "Node << 5", "Node << 6"),
    Slip(30, "identifier of another message", "servo", "at(0x0C)", "at(0x0D)"),
    Slip(31, "two fields swapped", "servo",
         '"position" / Quantity(Float32l, unit="turn"),\n        "feedforward"',
         '"feedforward" / Quantity(Float32l, unit="turn"),\n        "position"'),
    Slip(32, "remote forgotten", "servo", "remote=True, ", ""),
    Slip(33, "a 15-bit field for 16", "imu", '"level" / bits(16)', '"level" / bits(15)'),
    Slip(34, "identifier bits shifted by one", "marine", "id=group(0x1F801)",
         "id=Priority << 26 | 0x1F801 << 9 | Source"),
    Slip(35, "extended forgotten", "marine", "id=group(0x1FD02),\n    extended=True,", "id=group(0x1FD02),"),
    Slip(36, "byte order, a servo without examples", "servo", '"target" / Quantity(Int16sl', '"target" / Quantity(Int16sb'),
    Slip(37, "signedness, a servo without examples", "servo",
         '"measured" / Quantity(Int16sl', '"measured" / Quantity(Int16ul'),
    Slip(38, "last field missing, a servo without examples", "servo",
         '\n        "temperature" / Quantity(Int16sl, unit="°C", scale=0.1, range=(-40, 150)),', ""),
    Slip(39, "nonsense unit, a servo without examples", "servo", 'unit="°C"', 'unit="blips"'),
]
# fmt: on

# ---------------------------------------------------------------------- recordings


def _wave(n: int, amplitude: float, period: float = 97.0, phase: float = 0.0) -> float:
    return amplitude * math.sin(2 * math.pi * n / period + phase)


def _imu(n: int) -> Iterator[tuple[str, dict[str, Any]]]:
    if n % 24 == 0:
        yield "Configure", {"period": 100.0 + n / 24, "mode": ("off", "slow", "fast")[n // 24 % 3]}
        yield "Configured", {"period": 100.0 + n / 24}
        yield "Version", {"major": 4, "minor": 2}
    state = "align" if n < 30 else "fault" if n > 220 else "navigate"
    yield (
        "Motion",
        {
            "time": 0.01 * n,
            "acceleration": _wave(n, 9.0),
            "temperature": 20 + _wave(n, 25.0, 211),
            "state": state,
        },
    )
    yield (
        "Tilt",
        {"angle": _wave(n, 40.0), "offset": round(_wave(n, 3)), "status": ["valid"] if n > 9 else []},
    )
    yield "Position", {"latitude": 0.3 + _wave(n, 40.0, 300)}
    yield "Level", {"level": 40_000 + round(_wave(n, 20_000))}
    items = [
        {"kind": kind, "data": {"value": [_wave(n, 2.0), 101_325.0, 1.0], "status": n % 3}}
        for kind in range(n % 7)
    ]
    yield "Items", {"items": items}


def _servo(n: int) -> Iterator[tuple[str, dict[str, Any]]]:
    for node in (1, 3, 5):
        yield (
            "Heartbeat",
            {
                "node": node,
                "errors": ["voltage"] if n > 200 else [],
                "state": "idle" if n < 9 else "calibrate" if n < 30 else "closed_loop",
                "life": n % 256,
            },
        )
        place = _wave(n, 3.0, phase=node)
        yield "Ask", {"node": node}
        yield "Estimates", {"node": node, "position": place, "velocity": _wave(n, 19.0, phase=node + 1.57)}
        yield (
            "Counts",
            {"node": node, "count": round(8192 * place), "fine": round(120 * place), "rest": 900 + n},
        )
        yield (
            "Current",
            {
                "node": node,
                "target": _wave(n, 20.0, phase=node),
                "measured": _wave(n, 19.0, phase=node + 0.1),
                "temperature": 30 + n / 20,
            },
        )
        yield "SetPosition", {"node": node, "position": place, "feedforward": _wave(n, 8.0, phase=node)}


def _marine(n: int) -> Iterator[tuple[str, dict[str, Any]]]:
    whom = {"priority": 2, "source": 0x23}
    yield (
        "Engine",
        {
            **whom,
            "instance": n % 2,
            "speed": 2000 + _wave(n, 700),
            "boost": 1000 + n,
            "trim": round(_wave(n, 9)),
        },
    )
    yield (
        "Attitude",
        {
            **whom,
            "sequence": n % 250,
            "yaw": _wave(n, 1.5, 300),
            "pitch": _wave(n, 0.1, 31),
            "roll": _wave(n, 0.3, 41),
        },
    )
    reference = "apparent" if n > 100 else "true"
    yield "Wind", {
        **whom, "sequence": n % 250, "speed": 9 + _wave(n, 4), "angle": 3 + _wave(n, 1), "reference": reference,
    }  # fmt: skip
    yield "Place", {**whom, "latitude": 48 + n * 1e-5, "longitude": _wave(n, 0.01)}
    yield "Depth", {**whom, "sequence": n % 250, "depth": 30 + _wave(n, 12), "offset": -0.5}
    if n % 10 == 0:
        yield (
            "Switches",
            {"priority": 6, "source": 5, "instance": 1, "on": ["pump"] if n % 20 else ["light", "horn"]},
        )


_SCENES: dict[str, Callable[[int], Iterator[tuple[str, dict[str, Any]]]]] = {
    "imu": _imu,
    "servo": _servo,
    "marine": _marine,
}


def recording(spec: str) -> list[Any]:
    """What a recorder on the host's side has of a device: frames with their way, or chunks of one direction each."""
    protocol = sound(spec)
    found: list[Any] = []
    for n in range(LENGTH):
        for index, (name, fields) in enumerate(_SCENES[spec](n)):
            packet = protocol.encode(name, **fields)
            direction = protocol[name].direction
            assert direction is not None
            time = n * 0.01 + index * 0.0002
            if protocol.link == "can":
                found.append(
                    Frame(
                        packet.arbitration_id,
                        bytes(packet.data),
                        time,
                        "can0",
                        packet.is_extended_id,
                        packet.is_remote_frame,
                        is_rx=direction == "from device",
                    )
                )
            else:
                found.append(Chunk(packet, time, direction))
    return found
