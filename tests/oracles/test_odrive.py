"""ODrive frames before cantools: the database that we export, read by it, against the published frames and our scanner."""

from __future__ import annotations

import math
from functools import cache
from typing import Any

import pytest

from aces_bus import Frame
from aces_bus.protocol.exchange import print_dbc
from aces_protocols.odrive.spec import odrive
from tests.oracles.foreign import oracle

cantools = oracle("cantools", "cantools")

#: Dialect, frame, signals: ODrive's own database and ODriveArduino, compiled, gave the same bytes.
PUBLISHED = [
    ("0.5", "061#0002000008000181", {"state": "closed_loop", "error_controller_failed": 1, "encoder_error": 1}),
    ("0.6", "061#0000000401010100", {"state": "idle", "result": "busy", "trajectory_done": 1, "error_spinout": 1}),
    ("0.6", "06C#0000C03FFA0083FF", {"position": 1.5, "velocity": 0.25, "torque": -0.125}),
    ("0.6", "069#000080BE00000040", {"position": -0.25, "velocity": 2.0}),
    ("0.5", "06B#0200000002000000", {"control": "velocity", "input": "velocity_ramp"}),
]  # fmt: skip
MESSAGES = ("Heartbeat", "EncoderEstimates", "SetInputPosition", "SetControllerModes", "Iq")


@cache
def exported(dialect: str) -> Any:
    """Our database, as cantools reads it."""
    text, _ = print_dbc(odrive.variant(dialect), only=MESSAGES)
    return cantools.database.load_string(text, "dbc", strict=True)


@pytest.mark.slow
@pytest.mark.parametrize(("dialect", "text", "signals"), PUBLISHED)
def test_our_database_reads_the_published_frames(dialect: str, text: str, signals: dict[str, object]) -> None:
    """cantools decodes them by our export as ODrive says they mean."""
    database = exported(dialect)
    identifier, _, data = text.partition("#")
    told = database.decode_message(int(identifier, 16), bytes.fromhex(data))
    for name, value in signals.items():
        shown = told[name]
        if isinstance(value, float):
            assert math.isclose(shown, value), name
        else:
            assert str(shown) == str(value), name


def test_what_cantools_encodes_we_decode() -> None:
    """By our export; the node is in the identifier."""
    database = exported("0.6")
    message = next(one for one in database.messages if one.frame_id == 5 << 5 | 0x14)
    data = message.encode({"setpoint": 1.5, "measured": -2.25})
    (record,) = odrive.scanner().feed([Frame(message.frame_id, data)])
    assert (record.node, record.setpoint, record.measured) == (5, 1.5, -2.25)
