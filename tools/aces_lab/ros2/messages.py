"""The messages of ROS 2 that are published and taken: their definitions, types on DDS, and frequent ones packed quickly.

1. A message is defined once, as text in ROS's own notation; the type on DDS, and the schema in a bag, are made of it.
2. Messages that are published at a rate are packed by `struct` into bytes that were serialised once; all others are
   serialised by cyclonedds.

*Source*: the definitions are those of ROS 2 Jazzy (packages common_interfaces, rcl_interfaces). Type hashes are REP 2016's
RIHS01, worked out from the definitions by rosbags 0.11.9; `tests/ros2` compares both with it. Names on DDS: design.ros2.org,
"Topic and Service name mapping to DDS": topic `/a` is `rt/a`, type `p/msg/T` is `p::msg::dds_::T_`.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterable, Sequence
from functools import cache
from importlib import import_module
from typing import Any, TypeAlias

from aces_bus.errors import CallerError

#: A module, class or message of cyclonedds, whose types are not known where it is not installed.
Library: TypeAlias = Any
JOINT_STATE = "sensor_msgs/msg/JointState"
IMU = "sensor_msgs/msg/Imu"
WRENCH = "geometry_msgs/msg/WrenchStamped"
DIAGNOSTICS = "diagnostic_msgs/msg/DiagnosticArray"
TRAJECTORY = "trajectory_msgs/msg/JointTrajectory"

DEFINITIONS: dict[str, str] = {
    "builtin_interfaces/msg/Time": "int32 sec\nuint32 nanosec\n",
    "builtin_interfaces/msg/Duration": "int32 sec\nuint32 nanosec\n",
    "std_msgs/msg/Header": "builtin_interfaces/Time stamp\nstring frame_id\n",
    "geometry_msgs/msg/Vector3": "float64 x\nfloat64 y\nfloat64 z\n",
    "geometry_msgs/msg/Quaternion": "float64 x\nfloat64 y\nfloat64 z\nfloat64 w\n",
    "geometry_msgs/msg/Wrench": "geometry_msgs/Vector3 force\ngeometry_msgs/Vector3 torque\n",
    WRENCH: "std_msgs/Header header\ngeometry_msgs/Wrench wrench\n",
    JOINT_STATE: "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort\n",
    IMU: (
        "std_msgs/Header header\ngeometry_msgs/Quaternion orientation\nfloat64[9] orientation_covariance\n"
        "geometry_msgs/Vector3 angular_velocity\nfloat64[9] angular_velocity_covariance\n"
        "geometry_msgs/Vector3 linear_acceleration\nfloat64[9] linear_acceleration_covariance\n"
    ),
    "diagnostic_msgs/msg/KeyValue": "string key\nstring value\n",
    "diagnostic_msgs/msg/DiagnosticStatus": (
        "byte OK=0\nbyte WARN=1\nbyte ERROR=2\nbyte STALE=3\n"
        "byte level\nstring name\nstring message\nstring hardware_id\ndiagnostic_msgs/KeyValue[] values\n"
    ),
    DIAGNOSTICS: "std_msgs/Header header\ndiagnostic_msgs/DiagnosticStatus[] status\n",
    "trajectory_msgs/msg/JointTrajectoryPoint": (
        "float64[] positions\nfloat64[] velocities\nfloat64[] accelerations\nfloat64[] effort\n"
        "builtin_interfaces/Duration time_from_start\n"
    ),
    TRAJECTORY: (
        "std_msgs/Header header\nstring[] joint_names\ntrajectory_msgs/JointTrajectoryPoint[] points\n"
    ),
}
#: Type hashes, without "RIHS01_".
HASHES: dict[str, str] = {
    JOINT_STATE: "a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e",
    DIAGNOSTICS: "5a8a36efb05fb25070fa0fb3810290c0e6cd4862b54a8fb975a1ee8dc55a333e",
    IMU: "7d9a00ff131080897a5ec7e26e315954b8eae3353c3f995c55faf71574000b5b",
    WRENCH: "8dc3deaf06b2ab281f9f9a742a8961c328ca7cec16e3fd6586d3a5c83fa78f77",
    TRAJECTORY: "179b33eba59d676f6d967ac71fe35e7ca2f64b2f3928f4a018cec115e213796e",
}
#: Variance (rad²) of an angle that is not measured: evenly spread over a turn.
UNMEASURED = math.pi**2 / 3


def cyclonedds(module: str) -> Library:
    """Return a module of the library, such as `core`; `CallerError` naming the extra when it is missing."""
    try:
        return import_module(f"cyclonedds.{module}")
    except ImportError as missing:
        raise CallerError(f"--ros2 needs cyclonedds: pip install 'aces-bus[ros2]' ({missing})") from missing


def message_fields(name: str) -> list[tuple[str, str]]:
    """Return type and name of each field of a message; constants are none."""
    lines = [line.split() for line in DEFINITIONS[name].splitlines()]
    return [(kind, field) for kind, field in lines if "=" not in field]


def _message_name(kind: str) -> str:
    """Return the full name of a nested message: `std_msgs/Header` is `std_msgs/msg/Header`."""
    return kind.replace("/", "/msg/")


def dds_type_name(name: str) -> str:
    """Return a message's type name on DDS.

    >>> dds_type_name(JOINT_STATE)
    'sensor_msgs::msg::dds_::JointState_'
    """
    package, _, title = name.rpartition("/")
    return f"{package.replace('/', '::')}::dds_::{title}_"


def schema_text(name: str) -> str:
    """Return a message's definition with those that it is made of, as bags have it (`ros2msg`)."""
    needed = [name]
    for known in needed:
        for kind, _ in message_fields(known):
            base = kind.partition("[")[0]
            if "/" in base and (nested := _message_name(base)) not in needed:
                needed.append(nested)
    rest = [f"{'=' * 80}\nMSG: {n.replace('/msg/', '/')}\n{DEFINITIONS[n]}" for n in needed[1:]]
    return DEFINITIONS[name] + "".join(rest)


@cache
def dds_type(name: str) -> Library:
    """Return cyclonedds' class of a message, a dataclass with `serialize` and `deserialize`."""
    idl, types = cyclonedds("idl"), cyclonedds("idl.types")
    plain: dict[str, Library] = {
        "int32": types.int32,
        "uint32": types.uint32,
        "float64": types.float64,
        "byte": types.byte,
        "string": str,
    }
    fields: dict[str, Library] = {}
    for kind, field in message_fields(name):
        base, _, size = kind.partition("[")
        made = plain[base] if base in plain else dds_type(_message_name(base))
        if size == "]":
            made = types.sequence[made]
        elif size:
            made = types.array[made, int(size.rstrip("]"))]
        fields[field] = made
    return idl.make_idl_struct(name.rpartition("/")[2], dds_type_name(name), fields)


def stamped_header(instant: int, frame: str = "") -> Library:
    """Return a header of an instant (ns since 1970)."""
    return dds_type("std_msgs/msg/Header")(
        dds_type("builtin_interfaces/msg/Time")(*divmod(max(0, instant), 1_000_000_000)), frame
    )


class PackedNumbers:
    """Bytes of a message of a fixed size that ends in float64 values: the stamp and these are put in anew each time.

    `groups` are the values' places from the end of the message, (bytes before the end, how many), in the message's order.
    """

    def __init__(self, message: Library, groups: Iterable[tuple[int, int]]) -> None:
        self._data = bytearray(message.serialize(use_version_2=False))
        size = len(self._data)
        self._places = [(struct.Struct(f"<{number}d"), size - back, number) for back, number in groups]

    def pack(self, instant: int, values: Sequence[float]) -> bytes:
        """Return the message of an instant (ns since 1970)."""
        data = self._data
        struct.pack_into("<iI", data, 4, *divmod(max(0, instant), 1_000_000_000))
        start = 0
        for form, place, number in self._places:
            form.pack_into(data, place, *values[start : start + number])
            start += number
        return bytes(data)


def packed_joint_state(names: Sequence[str]) -> PackedNumbers:
    """Return a JointState of these joints, whose values are positions, velocities, efforts.

    The three lists begin at a multiple of eight bytes, each behind its length, which takes eight with its padding.
    """
    number = len(names)
    none = [math.nan] * number
    message = dds_type(JOINT_STATE)(stamped_header(0), list(names), none, none, none)
    size = 8 * number
    return PackedNumbers(message, [(3 * size + 16, number), (2 * size + 8, number), (size, number)])


def packed_imu(frame: str) -> PackedNumbers:
    """Return an Imu, whose 37 values are as `imu_values` returns them."""
    triple, nine = dds_type("geometry_msgs/msg/Vector3")(0.0, 0.0, 0.0), [0.0] * 9
    turn = dds_type("geometry_msgs/msg/Quaternion")(0.0, 0.0, 0.0, 1.0)
    message = dds_type(IMU)(stamped_header(0, frame), turn, nine, triple, nine, triple, nine)
    return PackedNumbers(message, [(37 * 8, 37)])


def packed_wrench(frame: str) -> PackedNumbers:
    """Return a WrenchStamped, whose six values are force x y z (N) and torque x y z (N·m)."""
    triple = dds_type("geometry_msgs/msg/Vector3")(0.0, 0.0, 0.0)
    message = dds_type(WRENCH)(stamped_header(0, frame), dds_type("geometry_msgs/msg/Wrench")(triple, triple))
    return PackedNumbers(message, [(6 * 8, 6)])


def imu_values(
    angles: Sequence[float], rates: Sequence[float], accelerations: Sequence[float]
) -> list[float]:
    """Return an Imu's numbers: orientation, angular velocity, linear acceleration, each with its covariance.

    All are x, y, z (angles: roll, pitch, yaw, about fixed axes); NaN where not measured. As sensor_msgs/Imu has it, the
    first covariance of a group that is not measured is -1. Without a yaw it is taken as 0, with the variance of an angle
    that may be any.
    """
    roll, pitch, yaw = angles
    if math.isnan(roll) or math.isnan(pitch):
        orientation = [math.nan] * 4 + [-1.0] + [0.0] * 8
    else:
        variance = UNMEASURED if math.isnan(yaw) else 0.0
        orientation = [*_quaternion(roll, pitch, 0.0 if math.isnan(yaw) else yaw), *[0.0] * 8, variance]
    values = orientation
    for group in (rates, accelerations):
        values = [*values, *group, -1.0 if all(map(math.isnan, group)) else 0.0, *[0.0] * 8]
    return values


def _quaternion(roll: float, pitch: float, yaw: float) -> tuple[float, float, float, float]:
    """Return x, y, z, w of a turn about the fixed x, then y, then z axis (rad)."""
    cr, sr = math.cos(roll / 2), math.sin(roll / 2)
    cp, sp = math.cos(pitch / 2), math.sin(pitch / 2)
    cy, sy = math.cos(yaw / 2), math.sin(yaw / 2)
    return (
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
        cr * cp * cy + sr * sp * sy,
    )
