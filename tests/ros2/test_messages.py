"""Bytes, types and hashes of what is published: rosbags has the same."""

from __future__ import annotations

import math
import random
import re
from typing import Any

import numpy as np
import pytest

from aces_lab.ros2.messages import (
    DEFINITIONS,
    DIAGNOSTICS,
    HASHES,
    IMU,
    JOINT_STATE,
    TRAJECTORY,
    WRENCH,
    dds_type,
    imu_values,
    packed_imu,
    packed_joint_state,
    packed_wrench,
    schema_text,
    stamped_header,
)
from tests.ros2.peer import JAZZY

INSTANT = 1_700_000_000_123_456_789


def numbers(count: int) -> list[float]:
    rng = random.Random(count)
    return [rng.choice([rng.uniform(-3, 3), math.nan, -0.0, math.inf]) for _ in range(count)]


def rosbags_header(frame: str) -> Any:
    time = JAZZY.types["builtin_interfaces/msg/Time"](1_700_000_000, 123_456_789)
    return JAZZY.types["std_msgs/msg/Header"](time, frame)


@pytest.mark.parametrize("name", HASHES)
def test_type_hashes_are_those_of_rosbags(name: str) -> None:
    """REP 2016's hash of each message that is published or taken."""
    assert f"RIHS01_{HASHES[name]}" == JAZZY.hash_rihs01(name)


@pytest.mark.parametrize("name", DEFINITIONS)
def test_definitions_are_those_of_jazzy(name: str) -> None:
    """Fields, their types and their order; and the schema of a bag has all that is inside."""
    theirs = JAZZY.generate_msgdef(name, ros_version=2)[0]

    def sections(text: str) -> set[str]:
        return {" ".join(part.split()) for part in re.split("={80}", text)}

    assert sections(schema_text(name)) == sections(theirs)


@pytest.mark.parametrize("count", [1, 2, 3, 35])
@pytest.mark.parametrize("length", range(1, 9))
def test_joint_states_are_the_bytes_of_rosbags(count: int, length: int) -> None:
    """However long names are: padding is before lengths and before numbers."""
    names = [f"{index:0{length}d}" for index in range(count)]
    values = numbers(3 * count)
    theirs = JAZZY.types[JOINT_STATE](
        rosbags_header(""), names, *(np.array(values[n * count : (n + 1) * count]) for n in range(3))
    )
    packed = packed_joint_state(names)
    for _ in range(2):  # the second is of the same buffer
        assert packed.pack(INSTANT, values) == bytes(JAZZY.serialize_cdr(theirs, JOINT_STATE))


@pytest.mark.parametrize("frame", ["", "a", "IMU0", "RIGHT_FOOT"])
def test_sensors_are_the_bytes_of_rosbags(frame: str) -> None:
    """Imu and WrenchStamped, whatever is measured and not."""
    types: Any = JAZZY.types
    vector = types["geometry_msgs/msg/Vector3"]
    values = imu_values([0.1, -0.2, 0.3], [1.0, 2.0, math.nan], [math.nan] * 3)
    theirs = types[IMU](
        rosbags_header(frame),
        types["geometry_msgs/msg/Quaternion"](*values[:4]),
        np.array(values[4:13]),
        vector(*values[13:16]),
        np.array(values[16:25]),
        vector(*values[25:28]),
        np.array(values[28:]),
    )
    assert packed_imu(frame).pack(INSTANT, values) == bytes(JAZZY.serialize_cdr(theirs, IMU))
    six = numbers(6)
    wrench = types["geometry_msgs/msg/Wrench"](vector(*six[:3]), vector(*six[3:]))
    stamped = types[WRENCH](rosbags_header(frame), wrench)
    assert packed_wrench(frame).pack(INSTANT, six) == bytes(JAZZY.serialize_cdr(stamped, WRENCH))


def test_diagnostics_are_the_bytes_of_rosbags() -> None:
    """Statuses with values."""
    types: Any = JAZZY.types
    theirs = types[DIAGNOSTICS](
        rosbags_header(""),
        [
            types["diagnostic_msgs/msg/DiagnosticStatus"](
                2, "leg: JMC3", "silent", "leg", [types["diagnostic_msgs/msg/KeyValue"]("events", "3")]
            )
        ],
    )
    pair = dds_type("diagnostic_msgs/msg/KeyValue")("events", "3")
    status = dds_type("diagnostic_msgs/msg/DiagnosticStatus")(2, "leg: JMC3", "silent", "leg", [pair])
    data = dds_type(DIAGNOSTICS)(stamped_header(INSTANT), [status]).serialize(use_version_2=False)
    assert data == bytes(JAZZY.serialize_cdr(theirs, DIAGNOSTICS))


def test_a_trajectory_of_rosbags_is_read() -> None:
    """All lists of all points."""
    types: Any = JAZZY.types
    points = [
        types["trajectory_msgs/msg/JointTrajectoryPoint"](
            np.array([0.1, 0.2]),
            np.array([]),
            np.array([1.0, 2.0]),
            np.array([]),
            types["builtin_interfaces/msg/Duration"](n, 500_000_000),
        )
        for n in range(3)
    ]
    theirs = types[TRAJECTORY](rosbags_header("base"), ["A", "Bee"], points)
    read = dds_type(TRAJECTORY).deserialize(bytes(JAZZY.serialize_cdr(theirs, TRAJECTORY)))
    assert read.joint_names == ["A", "Bee"]
    assert [point.time_from_start.sec for point in read.points] == [0, 1, 2]
    assert read.points[2].accelerations == [1.0, 2.0]


def test_an_orientation_is_a_turn_about_fixed_axes() -> None:
    """A pitch of 90° turns about y; what is not measured is said by covariances, as sensor_msgs/Imu has it."""
    values = imu_values([0.0, math.pi / 2, math.nan], [math.nan] * 3, [0.0, 0.0, 9.8])
    assert values[:4] == pytest.approx([0.0, math.sqrt(0.5), 0.0, math.sqrt(0.5)])
    assert values[12] == pytest.approx(math.pi**2 / 3)
    assert values[16] == -1.0
    assert values[28] == 0.0
    assert imu_values([math.nan, 0.0, 0.0], [0.0] * 3, [0.0] * 3)[4] == -1.0
