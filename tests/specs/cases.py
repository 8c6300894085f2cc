"""Worked examples of the specs: bytes from sheets, peers and throw-away scripts, with what they mean.

`Case.data` is one packet (streams) or the data of one frame (CAN); `before` are packets or frames that must be seen
first.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from aces_bus import Frame


@dataclass(frozen=True)
class Case:
    """One packet or frame, its message, and the fields that the source states (not always all)."""

    spec: str
    message: str
    data: bytes
    fields: Mapping[str, Any]
    id: int | None = None
    before: tuple[Case, ...] = ()
    dialect: str | None = None
    extended: bool = False
    remote: bool = False
    source: str = ""
    key: str = field(init=False)

    def __post_init__(self) -> None:
        shown = self.data[:6].hex() if self.id is None else f"{self.id:03X}"
        object.__setattr__(
            self, "key", f"{self.spec}-{self.message}-{shown}{f'-{self.dialect}' if self.dialect else ''}"
        )

    @property
    def frame(self) -> Frame:
        assert self.id is not None
        return Frame(self.id, self.data, is_extended_id=self.extended, is_remote_frame=self.remote)


def stream(
    spec: str, message: str, hex_: str, *, before: tuple[Case, ...] = (), source: str = "", **fields: Any
) -> Case:
    return Case(spec, message, bytes.fromhex(hex_), fields, before=before, source=source)


def frame(
    spec: str,
    message: str,
    id_: int,
    hex_: str = "",
    *,
    dialect: str | None = None,
    before: tuple[Case, ...] = (),
    extended: bool = False,
    remote: bool = False,
    source: str = "",
    **fields: Any,
) -> Case:
    return Case(spec, message, bytes.fromhex(hex_), fields, id_, before, dialect, extended, remote, source)


# ---------------------------------------------------------------------- Dynamixel 2

PING = stream("dynamixel2", "Ping", "FF FF FD 00 01 03 00 01 19 4E", source="e-manual, DynamixelSDK", id=1)
FAST_SYNC_READ = stream(
    "dynamixel2",
    "FastSyncRead",
    "FF FF FD 00 FE 09 00 8A 84 00 04 00 01 02 4D 72",
    source="DynamixelSDK",
    start=132,
    count=4,
    ids=[1, 2],
)
DYNAMIXEL2 = [
    PING,
    stream(
        "dynamixel2",
        "PingStatus",
        "FF FF FD 00 01 07 00 55 00 06 04 26 65 5D",
        before=(PING,),
        source="e-manual",
        id=1,
        model=1030,
        firmware=38,
    ),
    stream(
        "dynamixel2",
        "Status",
        "FF FF FD 00 01 07 00 55 00 06 04 26 65 5D",
        source="e-manual",
        parameters=b"\x06\x04\x26",
    ),
    stream(
        "dynamixel2",
        "Read",
        "FF FF FD 00 01 07 00 02 84 00 04 00 1D 15",
        source="e-manual",
        id=1,
        start=132,
        count=4,
    ),
    stream(
        "dynamixel2",
        "Status",
        "FF FF FD 00 01 08 00 55 00 A6 00 00 00 8C C0",
        source="e-manual",
        id=1,
        error={"code": "none", "alert": 0},
        parameters=b"\xa6\0\0\0",
    ),
    stream(
        "dynamixel2",
        "Write",
        "FF FF FD 00 01 09 00 03 74 00 00 02 00 00 CA 89",
        source="e-manual",
        start=116,
        data=b"\0\2\0\0",
    ),
    stream(
        "dynamixel2",
        "Status",
        "FF FF FD 00 01 04 00 55 84 B9 0F",
        error={"code": "data_range", "alert": 1},
        parameters=b"",
    ),
    stream(
        "dynamixel2",
        "SyncRead",
        "FF FF FD 00 FE 09 00 82 84 00 04 00 01 02 CE FA",
        source="DynamixelSDK",
        start=132,
        count=4,
        ids=[1, 2],
    ),
    stream(
        "dynamixel2",
        "SyncWrite",
        "FF FF FD 00 FE 11 00 83 74 00 04 00 01 96 00 00 00 02 AA 00 00 00 82 87",
        source="DynamixelSDK",
        start=116,
        servos=[{"id": 1, "data": b"\x96\0\0\0"}, {"id": 2, "data": b"\xaa\0\0\0"}],
    ),
    stream(
        "dynamixel2",
        "BulkRead",
        "FF FF FD 00 FE 0D 00 92 01 90 00 02 00 02 92 00 01 00 1A 05",
        source="e-manual",
        areas=[{"id": 1, "start": 144, "count": 2}, {"id": 2, "start": 146, "count": 1}],
    ),
    stream(
        "dynamixel2",
        "Write",
        "FF FF FD 00 01 0A 00 03 74 00 FF FF FD FD 00 21 E7",
        start=116,
        data=b"\xff\xff\xfd\0",
    ),
    FAST_SYNC_READ,
    stream(
        "dynamixel2",
        "FastSyncStatus",
        "FF FF FD 00 FE 11 00 55 00 01 A6 00 00 00 74 3B 00 02 1F 08 00 00 1C 36",
        before=(FAST_SYNC_READ,),
        source="DynamixelSDK accepts it",
        first={"error": {"code": "none", "alert": 0}, "id": 1, "data": b"\xa6\0\0\0"},
    ),
]

# ---------------------------------------------------------------------- MAVLink 1

MAVLINK1 = [
    stream(
        "mavlink1",
        "Heartbeat",
        "FE 09 05 01 01 00 00 00 00 00 02 03 51 03 03 2B DC",
        source="pymavlink",
        sequence=5,
        system=1,
        component=1,
        type=2,
        autopilot=3,
        base_mode=0x51,
        status="standby",
    ),
    stream(
        "mavlink1",
        "Attitude",
        "FE 1C 05 01 01 1E E8 03 00 00 CD CC CC 3D CD CC 4C BE 00 00 C0 3F" + "00" * 12 + "33 4F",
        source="pymavlink",
        time=1000,
        roll=0.10000000149011612,
        pitch=-0.20000000298023224,
        yaw=1.5,
        yaw_rate=0.0,
    ),
]

# ---------------------------------------------------------------------- Modbus, HuboVia

READ_FORCE = stream(
    "modbus_like",
    "Read",
    "09 03 00 B4 00 06 84 A6",
    source="pymodbus, FT 300 manual",
    unit=9,
    start=180,
    count=6,
)
WRITE_MANY = stream(
    "modbus_like",
    "WriteMany",
    "09 10 01 9A 00 01 02 02 00 CD CA",
    source="pymodbus",
    start=410,
    registers=[0x0200],
)
FORCES: dict[str, Any] = {"force": [10.0, -2.5, 50.0], "torque": [0.1, -0.02, 0.005]}
MODBUS = [
    READ_FORCE,
    stream(
        "modbus_like",
        "ReadForceTorque",
        "09 03 0C 03 E8 FF 06 13 88 00 64 FF EC 00 05 F5 B9",
        before=(READ_FORCE,),
        source="pymodbus",
        unit=9,
        **FORCES,
    ),
    WRITE_MANY,
    stream(
        "modbus_like",
        "WriteManyAnswer",
        "09 10 01 9A 00 01 21 52",
        before=(WRITE_MANY,),
        source="pymodbus",
        start=410,
        count=1,
    ),
    stream("modbus_like", "Refusal", "09 83 02 41 33", unit=9, reason="address"),
    stream("modbus_like", "ForceTorque", "20 4E E8 03 06 FF 88 13 64 00 EC FF 05 00 8F F2", **FORCES),
]
HUBOVIA = [
    stream(
        "hubovia_like",
        "Joint",
        "FF 41 01 23 80 57 49 43",
        motor=35,
        angle={"negative": 1, "degrees": 87, "hundredths": 0.73},
    ),
    stream(
        "hubovia_like",
        "Joint",
        "FF 41 01 1E 00 2D 32 7D",
        motor=30,
        angle={"negative": 0, "degrees": 45, "hundredths": 0.5},
    ),
    stream(
        "hubovia_like",
        "Joint",
        "FF 41 01 1E 01 2C 19 64",
        motor=30,
        angle={"negative": 0, "degrees": 300, "hundredths": 0.25},
    ),
]

# ---------------------------------------------------------------------- MIT motor

CHEETAH: dict[str, Any] = {"position": 1.0, "velocity": -2.0, "kp": 100.0, "kd": 1.0, "torque": 3.0}
READ_REGISTER = frame(
    "mit_motor",
    "ReadFloat",
    0x7FF,
    "01 00 33 15 00 00 00 00",
    dialect="DM4310",
    motor=1,
    register="position_max",
)
MIT = [
    frame(
        "mit_motor", "Command", 0x001, "8A 3C 7C 03 33 33 39 54", dialect="mini_cheetah", motor=1, **CHEETAH
    ),
    frame("mit_motor", "Command", 0x001, "8A 3C 7A D3 33 33 39 54", dialect="AK80_9", motor=1, **CHEETAH),
    frame(
        "mit_motor",
        "Command",
        0x001,
        "7F FF 7F F0 00 00 07 FF",
        dialect="AK80_9",
        position=0,
        velocity=0,
        kp=0,
        kd=0,
        torque=0,
    ),
    frame(
        "mit_motor",
        "Command",
        0x001,
        "8A 3C 77 71 99 0F 59 32",
        dialect="DM4310",
        source="python-damiao-driver, send_cmd_mit",
        position=1.0,
        velocity=-2.0,
        kp=50,
        kd=0.3,
        torque=1.5,
    ),
    frame(
        "mit_motor",
        "Feedback",
        0x011,
        "11 7A E0 8C C7 32 23 29",
        dialect="DM4310",
        motor=1,
        status="enabled",
        position=-0.5,
        velocity=3.0,
        torque=-1.0,
        mos_temperature=35,
        rotor_temperature=41,
    ),
    frame(
        "mit_motor",
        "PositionVelocity",
        0x101,
        "00 00 C0 3F 00 00 00 40",
        dialect="DM4310",
        position=1.5,
        velocity_limit=2.0,
    ),
    frame("mit_motor", "Velocity", 0x201, "00 00 40 C0", dialect="DM4310", velocity=-3.0),
    frame(
        "mit_motor",
        "ForcePosition",
        0x301,
        "00 00 C0 3F C8 00 C4 09",
        dialect="DM4310",
        position=1.5,
        velocity_limit=2.0,
        current_limit=0.25,
    ),
    READ_REGISTER,
    frame(
        "mit_motor",
        "ReadFloatReply",
        0x011,
        "01 00 33 15 00 00 48 41",
        dialect="DM4310",
        before=(READ_REGISTER,),
        motor=1,
        value=12.5,
    ),
    frame(
        "mit_motor",
        "WriteInteger",
        0x7FF,
        "01 00 55 0A 02 00 00 00",
        dialect="DM4310",
        register="control_mode",
        value=2,
    ),
    frame("mit_motor", "Enable", 0x001, "FF FF FF FF FF FF FF FC", dialect="AK80_9", motor=1),
    frame("mit_motor", "Disable", 0x07F, "FF FF FF FF FF FF FF FD", dialect="mini_cheetah", motor=127),
    frame("mit_motor", "SetZero", 0x001, "FF FF FF FF FF FF FF FE", dialect="AK80_9", motor=1),
    frame("mit_motor", "ClearError", 0x001, "FF FF FF FF FF FF FF FB", dialect="DM4310", motor=1),
    frame(
        "mit_motor",
        "Command",
        0x001,
        "FF FF FF FF FF FF FF FB",
        dialect="AK80_9",
        motor=1,
        torque=18 - 36 * 4 / 4095,
    ),
]

# ---------------------------------------------------------------------- ODrive

ODRIVE = [
    frame(
        "odrive_like",
        "Heartbeat",
        0x061,
        "00 02 00 00 08 00 01 81",
        dialect="0.5",
        source="odrive-cansimple.dbc",
        node=3,
        error=0x200,
        state="closed_loop",
        motor=0,
        encoder=1,
        controller=0x81,
    ),
    frame(
        "odrive_like",
        "Heartbeat",
        0x061,
        "00 00 00 04 01 01 01 00",
        dialect="0.6",
        source="ODriveArduino",
        node=3,
        error=0x0400_0000,
        state="idle",
        result="busy",
        trajectory_done=1,
    ),
    frame(
        "odrive_like",
        "SetInputPosition",
        0x06C,
        "00 00 C0 3F FA 00 83 FF",
        source="odrive-cansimple.dbc",
        node=3,
        position=1.5,
        velocity=0.25,
        torque=-0.125,
    ),
    frame(
        "odrive_like",
        "EncoderEstimates",
        0x069,
        "00 00 80 BE 00 00 00 40",
        source="ODriveArduino",
        position=-0.25,
        velocity=2.0,
    ),
    frame("odrive_like", "EncoderEstimatesRequest", 0x069, remote=True, node=3),
    frame("odrive_like", "EncoderEstimatesPoll", 0x069, node=3),
    frame("odrive_like", "SetAxisState", 0x067, "08 00 00 00", source="ODriveArduino", state="closed_loop"),
    frame(
        "odrive_like",
        "SetControllerModes",
        0x06B,
        "02 00 00 00 02 00 00 00",
        control="velocity",
        input="velocity_ramp",
    ),
    frame("odrive_like", "RxSdo", 0x064, "00 23 01 00", opcode="read", endpoint=0x0123, value=b""),
    frame(
        "odrive_like",
        "RxSdo",
        0x064,
        "01 23 01 00 00 00 A0 3F",
        opcode="write",
        endpoint=0x0123,
        value=b"\0\0\xa0\x3f",
    ),
    frame(
        "odrive_like",
        "SetAddress",
        0x7E6,
        "05 31 33 6B 39 68 30",
        source="ODriveArduino",
        address=5,
        serial_number=0x3068396B3331,
        connection=b"",
    ),
    frame("odrive_like", "Discover", 0x7E6, remote=True),
]

# ---------------------------------------------------------------------- J1939

J1939 = [
    frame(
        "j1939_like",
        "EngineController1",
        0x0CF00400,
        "F0 FF AF C0 5D FF FF FF",
        extended=True,
        priority=3,
        source_address=0,
        torque_demand=None,
        torque=50,
        speed=3000.0,
    ),
    frame(
        "j1939_like",
        "Request",
        0x18EAFF21,
        "EB FE 00",
        extended=True,
        priority=6,
        destination=0xFF,
        pgn=0xFEEB,
    ),
    frame(
        "j1939_like",
        "AddressClaimed",
        0x18EEFF03,
        "01 00 A0 01 00 03 00 80",
        extended=True,
        identity=1,
        manufacturer=13,
        function=3,
        arbitrary_address=1,
    ),
    frame(
        "j1939_like",
        "ParameterGroup",
        0x1DEAD0AA,
        "01 02",
        extended=True,
        priority=7,
        pgn=0x1EAD0,
        data=b"\1\2",
    ),
]

STREAMS = [*DYNAMIXEL2, *MAVLINK1, *MODBUS, *HUBOVIA]
FRAMES = [*MIT, *ODRIVE, *J1939]
