"""What a simulated receiver knows, as the fields of NMEA 0183 sentences.

1. `SENTENCES` names each; what has no fix leaves its fields empty.
2. The talker is GN, as of receivers of several systems; satellites in view are GPS's.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from math import degrees
from typing import Any

from .antenna import Epoch

#: A knot in m/s; km/h in m/s.
KNOT = 1852 / 3600
KMH = 1 / 3.6
#: Satellites in view that a GSV sentence holds.
IN_ONE = 4

Fields = dict[str, Any]


def _time(epoch: Epoch) -> str:
    return f"{epoch.time:%H%M%S}.{epoch.time.microsecond // 10_000:02}"


def _position(epoch: Epoch) -> Fields:
    if not epoch.has_fix:
        return {"lat": None, "lat_sign": None, "lon": None, "lon_sign": None}
    return {
        "lat": abs(degrees(epoch.latitude)),
        "lat_sign": "north" if epoch.latitude >= 0 else "south",
        "lon": abs(degrees(epoch.longitude)),
        "lon_sign": "east" if epoch.longitude >= 0 else "west",
    }


def _known(epoch: Epoch, value: float) -> float | None:
    return value if epoch.has_fix else None


def _mode(epoch: Epoch) -> str:
    return "autonomous" if epoch.has_fix else "none"


def _status(epoch: Epoch) -> str:
    return "valid" if epoch.has_fix else "void"


def _gga(epoch: Epoch) -> Iterable[Fields]:
    yield {
        "time": _time(epoch),
        **_position(epoch),
        "quality": "gps" if epoch.has_fix else "none",
        "satellites": epoch.used,
        "hdop": epoch.hdop if epoch.has_fix else 99.99,
        "altitude": _known(epoch, epoch.altitude),
        "altitude_unit": "M",
        "separation": _known(epoch, epoch.height - epoch.altitude),
        "separation_unit": "M",
        "age": None,
        "station": None,
    }


def _rmc(epoch: Epoch) -> Iterable[Fields]:
    yield {
        "time": _time(epoch),
        "status": _status(epoch),
        **_position(epoch),
        "speed": _known(epoch, epoch.speed / KNOT),
        "course": _known(epoch, degrees(epoch.course)),
        "date": f"{epoch.time:%d%m%y}",
        "variation": None,
        "variation_sign": None,
        "mode": _mode(epoch),
        "navigation": "void",
    }


def _vtg(epoch: Epoch) -> Iterable[Fields]:
    yield {
        "course": _known(epoch, degrees(epoch.course)),
        "course_mark": "T",
        "course_magnetic": None,
        "course_magnetic_mark": "M",
        "speed": _known(epoch, epoch.speed / KNOT),
        "speed_mark": "N",
        "speed_kmh": _known(epoch, epoch.speed / KMH),
        "speed_kmh_mark": "K",
        "mode": _mode(epoch),
    }


def _gll(epoch: Epoch) -> Iterable[Fields]:
    yield {**_position(epoch), "time": _time(epoch), "status": _status(epoch), "mode": _mode(epoch)}


def _gsa(epoch: Epoch) -> Iterable[Fields]:
    used = [satellite.number for satellite in epoch.satellites if satellite.used][:12]
    used_or_not: list[int | None] = [*used, *[None] * (12 - len(used))]
    yield {
        "selection": "automatic",
        "fix": "fix_3d" if epoch.has_fix else "none",
        **{f"satellite{place}": number for place, number in enumerate(used_or_not, 1)},
        "pdop": epoch.pdop if epoch.has_fix else 99.99,
        "hdop": epoch.hdop if epoch.has_fix else 99.99,
        "vdop": epoch.vdop if epoch.has_fix else 99.99,
        "system": "1",
    }


def _gsv(epoch: Epoch) -> Iterable[Fields]:
    shown = epoch.satellites
    count = max(1, -(-len(shown) // IN_ONE))
    for number in range(count):
        texts: list[str] = []
        for satellite in shown[number * IN_ONE : (number + 1) * IN_ONE]:
            texts += [
                f"{satellite.number:02}",
                f"{satellite.elevation:02}",
                f"{satellite.azimuth:03}",
                f"{satellite.signal:02}",
            ]
        yield {
            "talker": "GP",
            "messages": count,
            "number": number + 1,
            "in_view": len(shown),
            "more": [*texts, "1"],
        }


def _gst(epoch: Epoch) -> Iterable[Fields]:
    across = _known(epoch, epoch.horizontal_accuracy / 2**0.5)
    yield {
        "time": _time(epoch),
        "rms": None,
        "major": None,
        "minor": None,
        "orientation": None,
        "lat_deviation": across,
        "lon_deviation": across,
        "alt_deviation": _known(epoch, epoch.vertical_accuracy),
    }


def _zda(epoch: Epoch) -> Iterable[Fields]:
    yield {
        "time": _time(epoch),
        "day": epoch.time.day,
        "month": epoch.time.month,
        "year": epoch.time.year,
        "zone_hours": 0,
        "zone_minutes": 0,
    }


#: Name → the fields of each such sentence (of GSV there are several).
SENTENCES: dict[str, Callable[[Epoch], Iterable[Fields]]] = {
    "GGA": _gga,
    "GLL": _gll,
    "GSA": _gsa,
    "GSV": _gsv,
    "GST": _gst,
    "RMC": _rmc,
    "VTG": _vtg,
    "ZDA": _zda,
}


def sentences(epoch: Epoch, *names: str) -> Iterable[tuple[str, Fields]]:
    """Yield the sentences of these names: name and fields of each."""
    for name in names:
        for fields in SENTENCES[name](epoch):
            yield name, {"talker": "GN", "more": [], **fields}
