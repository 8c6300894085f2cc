"""A u-blox receiver by its own messages.

1. NavPvt has everything of one instant. It is taken as the receiver qualifies it: without `fix_ok`, or with
   `invalid_position`, there is no position, and a time counts when its date, time of day and second are certain.
2. Nothing is sent to it unless the file (`configure`) or somebody says so; what is set lasts until it is switched off.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from math import degrees, radians
from typing import Annotated, Any, ClassVar

from msgspec import Meta

from aces_bus.device import Driver, Job, Steps, Ticket, on
from aces_bus.device.config import DeviceConfig
from aces_bus.device.host import Host
from aces_bus.device.settings import described
from aces_bus.errors import DeviceError
from aces_bus.protocol import Record
from aces_protocols.nmea0183.spec import nmea0183

from .antenna import Epoch, ReceiverTwin
from .receiver import QUANTITIES, Receiver, ReceiverSettings
from .sentences import sentences

#: Group and number of messages that are set.
NAV_PVT, CFG_MSG, CFG_RATE = (0x01, 0x07), (0x06, 0x01), (0x06, 0x08)
#: An answer comes between two solutions, which keep the receiver busy (s).
ANSWER_S = 1.2


class UbxSettings(ReceiverSettings, frozen=True, kw_only=True):
    """The driver's own keys in a robot file."""

    configure: Annotated[
        bool,
        Meta(
            description="true: it is set to send NavPvt at `rate_hz` when the bus is opened; it must be wired both ways"
        ),
    ] = False


class UbxReceiver(Receiver):
    """Signals: see the README."""

    protocol = "ubx"
    settings_type: ClassVar = UbxSettings
    messages: ClassVar = {
        "NavPvt": tuple(name for name in QUANTITIES if name not in ("hdop", "north", "east", "up"))
    }
    actions: ClassVar = {
        "configure": "have it send NavPvt at the rate of the robot's file, until it is switched off",
        "version": "ask for its versions",
        "rate": "ask how often it measures",
    }
    asking: ClassVar = ("version", "rate")
    settings: UbxSettings

    def start(self) -> Job | None:
        """Set the receiver, where the file says so."""
        return self.configure() if self.settings.configure else None

    def received(self, record: Record, instant: int) -> None:
        """Take what NavPvt says."""
        if type(record).__name__ != "NavPvt":
            return
        flags = record.flags
        self.found(
            instant,
            fix=record.fix,
            quality=quality_of(record),
            satellites=record.satellites,
            pdop=record.pdop if record.pdop < 99 else None,
            time=_instant_of(record),
            time_accuracy=record.time_accuracy * 1e-9 if _instant_of(record) is not None else None,
        )
        if not flags.fix_ok or record.flags3.invalid_position or record.fix in ("none", "time_only"):
            self.lost()
            return
        self.found(
            instant,
            latitude=radians(record.lat),
            longitude=radians(record.lon),
            height=record.height * 1e-3,
            altitude=record.height_msl * 1e-3,
            velocity_north=record.velocity_north * 1e-3,
            velocity_east=record.velocity_east * 1e-3,
            velocity_down=record.velocity_down * 1e-3,
            speed=record.ground_speed * 1e-3,
            course=radians(record.heading_of_motion),
            horizontal_accuracy=record.horizontal_accuracy * 1e-3,
            vertical_accuracy=record.vertical_accuracy * 1e-3,
            speed_accuracy=record.speed_accuracy * 1e-3,
        )

    # ------------------------------------------------------------------ actions

    def configure(self) -> Job:
        """Have it send NavPvt at `rate_hz`. Fails with `DeviceError` when it refuses, `NoReplyError` when it is silent."""
        period = round(1000 / self.settings.rate_hz)
        group, number = NAV_PVT

        def steps(job: Job) -> Steps:
            yield from self._set("CfgRate", CFG_RATE, period=period, measurements=1, time_reference="utc")
            yield from self._set("CfgMsg", CFG_MSG, message_group=group, message_number=number, rate=1)

        return self.job("configure", steps)

    def _set(self, message: str, meant: tuple[int, int], **fields: Any) -> Steps:
        answer = yield self.ask(message, reply=("Ack", "Nak"), timeout_s=ANSWER_S, **fields)
        shown = ", ".join(f"{name} = {value}" for name, value in fields.items())
        if (answer.acked_group, answer.acked_number) != meant:
            raise DeviceError(f"{self.name}: {message} ({shown}): the receiver answered another setting")
        if type(answer).__name__ == "Nak":
            raise DeviceError(
                f"{self.name} refuses {message} ({shown}); newer receivers are set by CFG-VALSET alone"
            )

    def version(self) -> Ticket:
        """Ask for its versions: the record's `software`, `hardware`, `extensions`."""
        return self.ask("MonVerPoll", reply="MonVer", timeout_s=ANSWER_S)

    def rate(self) -> Ticket:
        """Ask how often it measures: the record's `period` (ms)."""
        return self.ask("CfgRatePoll", reply="CfgRate", timeout_s=ANSWER_S)


def quality_of(record: Record) -> str:
    """Return what kind of a fix NavPvt has, in the words of NMEA 0183's GGA."""
    if not record.flags.fix_ok or record.fix in ("none", "time_only"):
        return "none"
    if record.fix == "dead_reckoning":
        return "dead_reckoning"
    if record.flags.carrier in ("float", "fixed"):
        return f"rtk_{record.flags.carrier}"
    return "dgps" if record.flags.differential else "gps"


def _instant_of(record: Record) -> float | None:
    """Return NavPvt's time as seconds since 1970; None where the receiver is not certain of all of it."""
    valid = record.valid
    if not (valid.date and valid.time and valid.fully_resolved):
        return None
    try:
        day = datetime(record.year, record.month, record.day, tzinfo=UTC).timestamp()
    except ValueError:
        return None
    return day + float(3600 * record.hour + 60 * record.minute + record.second + record.nano * 1e-9)


# ---------------------------------------------------------------------- the twin

#: What unknown accuracies are, in mm and mm/s.
NEVER = 0xFFFF_FFFF


def _utc(epoch: Epoch) -> dict[str, Any]:
    at = epoch.time
    return {
        "itow": epoch.itow_ms,
        "time_accuracy": 25 if epoch.has_fix else NEVER,
        "nano": at.microsecond * 1000,
        "year": at.year,
        "month": at.month,
        "day": at.day,
        "hour": at.hour,
        "minute": at.minute,
        "second": at.second,
    }


def _place(epoch: Epoch) -> dict[str, Any]:
    if not epoch.has_fix:
        return {
            **dict.fromkeys(("lat", "lon", "height", "height_msl"), 0),
            "horizontal_accuracy": NEVER,
            "vertical_accuracy": NEVER,
        }
    return {
        "lat": degrees(epoch.latitude),
        "lon": degrees(epoch.longitude),
        "height": 1e3 * epoch.height,
        "height_msl": 1e3 * epoch.altitude,
        "horizontal_accuracy": 1e3 * epoch.horizontal_accuracy,
        "vertical_accuracy": 1e3 * epoch.vertical_accuracy,
    }


def _nav_pvt(epoch: Epoch) -> dict[str, Any]:
    known = 1e3 if epoch.has_fix else 0
    return {
        **_utc(epoch),
        **_place(epoch),
        "valid": ["date", "time", "fully_resolved"],
        "fix": "fix_3d" if epoch.has_fix else "none",
        "flags": {
            "fix_ok": int(epoch.has_fix),
            "differential": 0,
            "power_save": 0,
            "heading_valid": 0,
            "carrier": "none",
        },
        "flags2": ["confirmed_available", "confirmed_date", "confirmed_time"],
        "satellites": epoch.used,
        "velocity_north": known * epoch.velocity_north,
        "velocity_east": known * epoch.velocity_east,
        "velocity_down": known * epoch.velocity_down,
        "ground_speed": known * epoch.speed,
        "heading_of_motion": degrees(epoch.course) if epoch.has_fix else 0,
        "speed_accuracy": 1e3 * epoch.speed_accuracy if epoch.has_fix else NEVER,
        "heading_accuracy": 10 if epoch.has_fix else 180,
        "pdop": epoch.pdop if epoch.has_fix else 99.99,
        "flags3": {
            "invalid_position": int(not epoch.has_fix),
            "correction_age": 0,
            "authenticated_time": 0,
            "authenticated_message": 0,
        },
        "heading_of_vehicle": 0,
        "magnetic_declination": 0,
        "magnetic_accuracy": 0,
    }


def _nav_status(epoch: Epoch) -> dict[str, Any]:
    return {
        "itow": epoch.itow_ms,
        "fix": "fix_3d" if epoch.has_fix else "none",
        "flags": ["week_set", "time_of_week_set", *(["fix_ok"] if epoch.has_fix else [])],
        "fix_status": {"corrections": 0, "carrier_valid": 0, "map_matching": 0},
        "flags2": {"power_save": 0, "spoofing": "none", "carrier": "none"},
        "time_to_first_fix": 0,
        "uptime": epoch.uptime_ms,
    }


def _nav_vel_ned(epoch: Epoch) -> dict[str, Any]:
    velocity = (epoch.velocity_north, epoch.velocity_east, epoch.velocity_down)
    known = 1e2 if epoch.has_fix else 0
    return {
        "itow": epoch.itow_ms,
        "velocity": [known * value for value in velocity],
        "speed": known * sum(value * value for value in velocity) ** 0.5,
        "ground_speed": known * epoch.speed,
        "heading_of_motion": degrees(epoch.course) if epoch.has_fix else 0,
        "speed_accuracy": 1e2 * epoch.speed_accuracy if epoch.has_fix else NEVER,
        "heading_accuracy": 10 if epoch.has_fix else 180,
    }


def _nav_dop(epoch: Epoch) -> dict[str, Any]:
    names = ("gdop", "pdop", "tdop", "vdop", "hdop", "ndop", "edop")
    known = {"pdop": epoch.pdop, "vdop": epoch.vdop, "hdop": epoch.hdop} if epoch.has_fix else {}
    return {"itow": epoch.itow_ms, **{name: known.get(name, 99.99) for name in names}}


def _nav_sat(epoch: Epoch) -> dict[str, Any]:
    return {
        "itow": epoch.itow_ms,
        "version": 1,
        "satellites": [
            {
                "system": "gps",
                "satellite": satellite.number,
                "signal": satellite.signal,
                "elevation": satellite.elevation,
                "azimuth": satellite.azimuth,
                "residual": 0,
                "state": {
                    "quality": 7,
                    "used": int(satellite.used),
                    "health": "healthy",
                    "differential": 0,
                    "smoothed": 0,
                    "orbit_source": 1,
                },
            }
            for satellite in epoch.satellites
        ],
    }


Fields = Callable[[Epoch], dict[str, Any]]
#: What can be sent, by group and number: the message, and its fields.
MESSAGES: dict[tuple[int, int], tuple[str, Fields]] = {
    (0x01, 0x02): ("NavPosLlh", lambda epoch: {"itow": epoch.itow_ms, **_place(epoch)}),
    (0x01, 0x03): ("NavStatus", _nav_status),
    (0x01, 0x04): ("NavDop", _nav_dop),
    NAV_PVT: ("NavPvt", _nav_pvt),
    (0x01, 0x12): ("NavVelNed", _nav_vel_ned),
    (0x01, 0x21): (
        "NavTimeUtc",
        lambda epoch: {
            **_utc(epoch),
            "valid": {"time_of_week": 1, "week": 1, "utc": 1, "authenticated": 0, "standard": 3},
        },
    ),
    (0x01, 0x35): ("NavSat", _nav_sat),
}
#: NMEA sentences are of group F0 to a u-blox receiver.
SENTENCE_NUMBERS = {0: "GGA", 1: "GLL", 2: "GSA", 3: "GSV", 4: "RMC", 5: "VTG", 7: "GST", 8: "ZDA"}
NMEA = 0xF0
#: What it can measure at most: 40 times a second (ms).
SHORTEST_MS = 25


class UbxTwin(ReceiverTwin):
    """A u-blox receiver that sends NavPvt, and what it is set to send: by CFG-MSG of group F0 also sentences."""

    protocol = "ubx"
    settings_type: ClassVar = UbxSettings

    def setup(self) -> None:
        """Begin as it was set when it was switched on: NavPvt in each solution, at the rate of the file."""
        super().setup()
        self.rates: dict[tuple[int, int], int] = {NAV_PVT: 1}
        self.solutions = 0
        self._measure(round(1000 / self.settings.rate_hz))

    def _measure(self, period_ms: int) -> None:
        self.period_ms = period_ms
        self._end_timers()
        self.every(period_ms / 1000, self._solve)

    def _solve(self) -> None:
        """Compute a solution and send the messages that are due."""
        self.solutions += 1
        epoch = self.epoch()
        for key, rate in sorted(self.rates.items()):
            if rate and self.solutions % rate == 0:
                if key[0] == NMEA:
                    self._speak(epoch, SENTENCE_NUMBERS[key[1]])
                else:
                    self._send_message(key, epoch)

    def _send_message(self, key: tuple[int, int], epoch: Epoch) -> None:
        message, fields = MESSAGES[key]
        self.reply(message, delay_ns=0, **fields(epoch))

    def _speak(self, epoch: Epoch, name: str) -> None:
        if "silent" not in self.active_faults:
            for _, fields in sentences(epoch, name):
                self.send_raw(nmea0183.encode(name, **fields))

    def _is_known(self, key: tuple[int, int]) -> bool:
        return key in MESSAGES or (key[0] == NMEA and key[1] in SENTENCE_NUMBERS)

    # ------------------------------------------------------------------ asked

    @on(
        "NavPosLlhPoll",
        "NavStatusPoll",
        "NavDopPoll",
        "NavPvtPoll",
        "NavVelNedPoll",
        "NavTimeUtcPoll",
        "NavSatPoll",
    )
    def answer(self, request: Record) -> None:
        """Send one message, now."""
        wanted = type(request).__name__.removesuffix("Poll")
        self._send_message(next(key for key, (name, _) in MESSAGES.items() if name == wanted), self.epoch())

    @on("MonVerPoll")
    def answer_version(self, request: Record) -> None:
        """Send versions of a receiver that does not exist."""
        self.reply(
            "MonVer",
            software="EXT CORE 1.00 (aces)",
            hardware="00190000",
            extensions=["PROTVER=27.00", "MOD=TWIN"],
        )

    @on("CfgRatePoll")
    def answer_rate(self, request: Record) -> None:
        """Answer with the measuring rate."""
        self.reply("CfgRate", period=self.period_ms, measurements=1, time_reference="utc")

    @on("CfgMsgPoll")
    def answer_message_rate(self, request: Record) -> None:
        """Answer with the rate of a message."""
        key = request.message_group, request.message_number
        if not self._is_known(key):
            self._acknowledge(CFG_MSG, False)
            return
        self.reply("CfgMsg", message_group=key[0], message_number=key[1], rate=self.rates.get(key, 0))
        self._acknowledge(CFG_MSG, True)

    # ------------------------------------------------------------------ set

    @on("CfgRate")
    def set_rate(self, request: Record) -> None:
        """Measure so often from now on."""
        is_possible = request.period >= SHORTEST_MS and request.measurements == 1
        self._acknowledge(CFG_RATE, is_possible)
        if is_possible:
            self._measure(int(request.period))

    @on("CfgMsg", "CfgMsgPorts")
    def set_message_rate(self, request: Record) -> None:
        """Send a message in every so many solutions; of six ports this is the second, UART 1."""
        key = request.message_group, request.message_number
        rate = request.rates[1] if type(request).__name__ == "CfgMsgPorts" else request.rate
        if self._is_known(key):
            self.rates[key] = rate
        self._acknowledge(CFG_MSG, self._is_known(key))

    def not_understood(self, data: bytes, reason: str) -> None:
        """Refuse a setting that this receiver does not have."""
        if reason == "unknown" and len(data) > 4 and data[2] == CFG_MSG[0]:
            self._acknowledge((data[2], data[3]), False)

    def _acknowledge(self, setting: Sequence[int], is_taken: bool) -> None:
        self.reply("Ack" if is_taken else "Nak", acked_group=setting[0], acked_number=setting[1])


def _scan(host: Host, job: Job) -> Steps:
    """Ask for versions."""
    answer = yield from host.answers("ubx", {}, "MonVerPoll", reply="MonVer", timeout_s=ANSWER_S)
    if answer is None:
        return []
    model = next((text[4:] for text in answer.extensions if text.startswith("MOD=")), None)
    return [DeviceConfig(name="GNSS", driver="ubx", bus=host.name, model=model)]


EXAMPLE = """
name = "ubx_example"
rate_hz = 20

[buses]
gnss = { link = "serial", protocol = "ubx", baud = 38_400 }

[devices.GNSS]
driver = "ubx"
bus = "gnss"
settings = { rate_hz = 5, configure = true, origin = [48.0, 11.0, 520.0] }
"""

driver = Driver(
    "ubx",
    device=UbxReceiver,
    twin=UbxTwin,
    example=EXAMPLE,
    doc="A u-blox satellite receiver by its own messages: position, velocity, accuracy, time.",
    source="pyubx2",
    scan=_scan,
    settings=described(UbxSettings),
)
