"""Attitude boards: roll, pitch and their rates.

1. D12: the board scales, in ° and °/s. D08: acceleration and rotation in digits, without a unit until a matrix gives one.
2. SI outside: rad and rad/s.
"""

from __future__ import annotations

from math import pi

from aces_bus.device import Driver, Job, Poll, Ticket
from aces_bus.device.settings import described
from aces_bus.protocol import Record

from ..hubo_sensors.board import MOTION, SensorBoard, SensorSettings, scan_of
from .twin import ImuTwin

_DEGREE = pi / 180


class ImuBoard(SensorBoard):
    """Signals: roll, pitch (rad), roll_rate, pitch_rate (rad/s); of D08 acc1, acc2, gyro1, gyro2 in digits."""

    facts = "X2; hubo-ach; HuboCan: the request with a third byte"

    def setup(self) -> None:
        """Add signals and polls as the dialect says."""
        sensor = self.sensor_of("imu")
        if self.is_old:
            self.ask_for(Poll("SensorRequestD08", reply="ImuD08", fields={"mode": "all"}))
            self.motion_of_old(sensor)
            return
        self.lacks("init")
        self.ask_for(Poll("ImuRequest", reply="Imu", fields={"select": "imu"}))
        self.axes(sensor, "Imu", [(name, name, unit, _DEGREE) for name, unit in MOTION])

    def received(self, record: Record, instant: int) -> None:
        """Turn digits into signals by the matrix."""
        if self.made_of and type(record).__name__ == "ImuD08":
            self.made_of["ImuD08"]((*record.acceleration, *record.gyro), instant)

    def null(self) -> Job:
        """Take the present attitude for zero."""
        return super().null() if self.is_old else self.nulled(("NullImu", {}))

    def init(self) -> Ticket | Job:
        """Refuse: it is not known of this board in D12; only force/torque boards have it there."""
        if self.is_old:
            return super().init()
        return self.refused("init", "only force/torque boards are known to be initialised")


EXAMPLE = """
name = "hubo_imu"
rate_hz = 50

[buses]
lower = { link = "can", protocol = "hubo", dialect = "D12" }
old = { link = "can", protocol = "hubo", dialect = "D08" }

[devices]
IMU_0 = { driver = "hubo_imu", bus = "lower", credentials = { board = 0x32, sensor = 3 }, kind = "imu" }
OLD_0 = { driver = "hubo_imu", bus = "old", credentials = { board = 0x32, sensor = 3 }, kind = "imu" }

[devices.OLD_1]
driver = "hubo_imu"
bus = "old"
credentials = { board = 0x33, sensor = 4 }
kind = "imu"
settings = { name_info_tail = "0000000000" }

[sensors]
IMU0 = { kind = "imu", device = "IMU_0", signs = [-1, 1, -1, 1] }
OLD0 = { kind = "imu", device = "OLD_0" }
# 750 digits are 1 g, which is as many radians for small angles; 100 digits are 1 °/s: the twin's own scales
OLD1 = { kind = "imu", device = "OLD_1", matrix = [
    [0.0013333, 0, 0, 0], [0, 0.0013333, 0, 0], [0, 0, 0.00017453, 0], [0, 0, 0, 0.00017453],
] }
"""

driver = Driver(
    "hubo_imu",
    device=ImuBoard,
    twin=ImuTwin,
    example=EXAMPLE,
    doc="Hubo's inertial board: roll, pitch and their rates.",
    source="HUBO2_CANprotocol.xls (X2); hubo-ach; HuboCan",
    scan=scan_of("hubo_imu", ("imu",)),
    settings=described(SensorSettings),
)
