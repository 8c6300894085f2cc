"""robstride 0.1.0, unmodified, with our twin on a served bus: positions and parameters; where it is wrong."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import can
import pytest
from hypothesis import given
from hypothesis import strategies as st

from aces_bus import Frame
from aces_devices.robstride.twin import RobstrideTwin
from aces_protocols.robstride.spec import robstride
from tests.oracles.foreign import oracle
from tests.oracles.served import ServedTwins, served, wait_until

theirs = oracle("robstride", "robstride")

ROBOT = """
name = "leg"
[buses]
leg = { link = "can", protocol = "robstride", bitrate = 1_000_000 }
[devices]
M1 = { driver = "robstride", bus = "leg", credentials = { motor = 1 }, model = "RS02" }
"""


@pytest.fixture
def leg() -> Iterator[ServedTwins]:
    with served(ROBOT) as made:
        yield made


def test_it_drives_our_twin(leg: ServedTwins) -> None:
    """It reads and writes parameters, switches on, goes to a position, and reads where the twin is."""
    twin = leg.twins["M1"]
    assert isinstance(twin, RobstrideTwin)
    with can.Bus(channel=leg.channel, interface="aces") as bus:
        client = theirs.Client(bus, recv_timeout=30)
        assert client.read_param(1, "vbus") == 24.0
        client.write_param(1, "run_mode", theirs.RunMode.Position)
        assert client.read_param(1, "run_mode") == theirs.RunMode.Position
        client.write_param(1, "limit_spd", 2.5)
        assert client.read_param(1, "limit_spd") == 2.5
        client.enable(1)
        client.write_param(1, "loc_ref", 0.5)
        wait_until(
            lambda: (
                abs(client.read_param(1, "mechpos") - 0.5) < 0.02
                and abs(client.read_param(1, "mechvel")) < 0.05
            )
        )
        assert leg.call(lambda: twin.angle) == pytest.approx(0.5, abs=0.05)
        told = client.disable(1)
        assert told.angle == pytest.approx(0.5, abs=0.05)
        assert leg.call(lambda: twin.state) == "reset"
    records = robstride.scanner().feed(leg.frames())
    names = {type(one).__name__ for one in records}
    assert names >= {
        "ReadParameter",
        "FloatParameter",
        "ByteParameter",
        "WriteByte",
        "WriteFloat",
        "Enable",
        "Stop",
        "Feedback",
    }
    written = [one for one in records if type(one).__name__ == "WriteFloat"]
    assert [(one.index, one.value) for one in written] == [("limit_spd", 2.5), ("loc_ref", 0.5)]


def feedback(identifier: int, data: bytes) -> Any:
    """What it makes of a feedback."""
    client = theirs.Client(None, host_can_id=0xFD)
    message = can.Message(arbitration_id=identifier, data=data, is_extended_id=True)
    return client._parse_feedback_resp(message, 1, 1)


@given(st.integers(0, 31), st.binary(min_size=8, max_size=8))
def test_it_reads_positions_and_faults_as_we_do(faults: int, data: bytes) -> None:
    """The ranges of its model 1 are those of an RS02."""
    identifier = 2 << 24 | faults << 16 | 1 << 8 | 0xFD
    told = feedback(identifier, data)
    (ours,) = robstride.scanner(dialect="RS02").feed([Frame(identifier, data, is_extended_id=True)])
    assert told.angle == pytest.approx(ours.position, abs=1e-9)
    assert told.velocity == pytest.approx(ours.velocity, abs=1e-9)
    assert told.torque == pytest.approx(ours.torque, abs=1e-9)
    assert told.temp == pytest.approx(ours.temperature)
    names = (
        "under_voltage",
        "over_current",
        "over_temperature",
        "magnetic_encoder",
        "stalled",
        "uncalibrated",
    )
    assert [bool(getattr(ours, name)) for name in names] == [faults >> bit & 1 == 1 for bit in range(6)]
    assert len(told.errors) == faults.bit_count()


def test_where_it_is_wrong() -> None:
    """A motor that runs it takes for one that is reset, looking at one bit of two; uncalibrated it never says."""
    identifier, data = 0x028001FD, bytes.fromhex("8A2F77778554013B")
    (ours,) = robstride.scanner(dialect="cybergear").feed([Frame(identifier, data, is_extended_id=True)])
    assert ours.state == "run"
    assert feedback(identifier, data).mode.name == "Reset"
    assert feedback(identifier | 1 << 21, data).errors == []
