"""Force/torque boards of feet and hands; those of the feet measure their tilt too.

1. D12: the board scales, in N·m, N, ° and g; a sensor with a matrix is asked for digits instead.
2. D08: digits only. With a matrix they are N·m and N as well; a sensor without one has digits alone, which have no unit.
3. SI outside: tilt in rad, vertical acceleration in m/s².
"""

from __future__ import annotations

from math import pi

from aces_bus.device import Driver, Job, Poll
from aces_bus.device.settings import described
from aces_bus.protocol import Record
from aces_bus.protocol.record import FieldValue

from ..hubo_sensors.board import SensorBoard, SensorSettings, scan_of
from .twin import ForceTorqueTwin

#: Standard gravity.
G = 9.80665
_AXES = (("mx", "N·m"), ("my", "N·m"), ("fz", "N"))
_DEGREE = pi / 180
#: What 16 bits reach: a reading there says no more than that the load is beyond the sensor.
_END = 32767


class ForceTorqueBoard(SensorBoard):
    """Signals: mx, my (N·m) and fz (N) of the force sensor; roll, pitch (rad) and az (m/s²) of a foot's tilt sensor."""

    facts = "X2; hubo-ach; HuboCan: requests 0x12 and 0x22"
    _force: str
    #: Where mx and my, and where fz, are at the end of their range, in the message's unit.
    _ends: tuple[float, float]

    def setup(self) -> None:
        """Add signals and polls as dialect, kind and the robot's file say."""
        force, tilt = self.sensor_of("force_torque"), self.sensor_of("tilt")
        is_foot = self.config.kind == "foot"
        matrix = force is not None and force.matrix is not None
        self._ends = (_END, _END)
        if self.is_old:
            self._force = "ForceTorqueD08"
            self.ask_for(Poll("SensorRequestD08", reply=self._force, fields={"mode": "all"}))
            if is_foot:
                self.motion_of_old(tilt)
        else:
            self._force = "ForceTorqueDigits" if matrix else "ForceTorque"
            mode = "ft_digital" if matrix else "ft_scaled"
            polls = [Poll("ForceTorqueRequest", reply=self._force, fields={"mode": mode})]
            if is_foot:
                polls.append(Poll("TiltRequest", reply="Tilt", fields={"mode": "tilt_scaled"}))
            self.ask_for(*polls)
            if is_foot:
                angles = [("roll", "ax", "rad", _DEGREE), ("pitch", "ay", "rad", _DEGREE)]
                self.axes(tilt, "Tilt", [*angles, ("az", "az", "m/s²", G)])
        if self._force == "ForceTorque":
            self._ends = (_END / 100, _END / 10)
            self.axes(force, self._force, [(name, name, unit, 1.0) for name, unit in _AXES])
            return
        digits = [(f"{name}_digits", name, "", 1.0) for name, _ in _AXES]
        self.axes(force, self._force, digits, turned=not matrix)
        if force is not None and matrix:
            self.products(force, self._force, _AXES)

    def received(self, record: Record, instant: int) -> None:
        """Turn digits into forces by the matrix; report readings at the end of their range."""
        name = type(record).__name__
        update = self.made_of.get(name) if self.made_of else None
        if name == self._force:
            moment, force = self._ends
            mx, my, fz = record.mx, record.my, record.fz
            at_end = abs(fz) >= force or abs(mx) >= moment or abs(my) >= moment
            if at_end or self.alarms:
                self.alarm("saturated", at_end)
            if update is not None:
                update((mx, my, fz), instant)
        elif update is not None:
            update((*record.acceleration, *record.gyro), instant)

    def null(self) -> Job:
        """Take the present force, torque and, of a D12 foot, tilt for zero."""
        requests: list[tuple[str, dict[str, FieldValue]]] = [("NullSensor", {"what": "force_torque"})]
        if self.config.kind == "foot" and not self.is_old:
            requests.append(("NullSensor", {"what": "tilt"}))
        return self.nulled(*requests)


EXAMPLE = """
name = "hubo_ft"
rate_hz = 30

[buses]
lower = { link = "can", protocol = "hubo", dialect = "D12" }
old = { link = "can", protocol = "hubo", dialect = "D08" }

[devices]
FT_RF = { driver = "hubo_ft", bus = "lower", credentials = { board = 0x30, sensor = 1 }, kind = "foot" }
FT_RH = { driver = "hubo_ft", bus = "lower", credentials = { board = 0x35, sensor = 6 }, kind = "ft" }
OLD_RF = { driver = "hubo_ft", bus = "old", credentials = { board = 0x30, sensor = 1 }, kind = "foot" }

[sensors]
RFFT = { kind = "force_torque", device = "FT_RF", signs = [-1, -1, 1] }
TILT_R = { kind = "tilt", device = "FT_RF" }
RHFT = { kind = "force_torque", device = "FT_RH", matrix = [[0.01, 0, 0], [0, 0.01, 0], [0, 0, 0.1]] }
OLD_RFFT = { kind = "force_torque", device = "OLD_RF", matrix = [
    [0.0722, -0.0002, -0.0007], [0.0012, 0.0740, -0.0014], [-0.0562, 0.0469, 0.3234],
] }
OLD_TILT = { kind = "tilt", device = "OLD_RF" }
"""

driver = Driver(
    "hubo_ft",
    device=ForceTorqueBoard,
    twin=ForceTorqueTwin,
    example=EXAMPLE,
    doc="Force/torque board of a Hubo foot or hand; a foot's measures its tilt too.",
    source="HUBO2_CANprotocol.xls (X1, X2); acesHubo; hubo-ach; HuboCan",
    scan=scan_of("hubo_ft", ("foot", "ft")),
    settings=described(SensorSettings),
)
