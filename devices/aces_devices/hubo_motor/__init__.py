"""Hubo's motor boards: driver `hubo_motor`, its twin and its examples; `d15` is the driver of later boards.

The examples are the TOML files in `examples`. Together they have every row of `shapes`, except a hand of D08X, of which that
sheet has no reply at all.
"""

from __future__ import annotations

from importlib.resources import files

from aces_bus.device import Driver
from aces_bus.device.settings import described

from .driver import HuboMotor
from .scan import scan_boards
from .shapes import BoardSettings
from .twin import HuboMotorTwin


def _read(name: str) -> str:
    return (files(__name__) / "examples" / f"{name}.toml").read_text(encoding="utf-8")


#: D12: boards of 1, 2 and 5 channels; of 3, and DRC-Hubo's hand and neck. D08: boards of 1, 2, 3 and 5 channels.
D12, D12_THREE, D08 = (_read(name) for name in ("d12", "d12_three", "d08"))
#: The robot of D08 by the vendor's sheet alone, without the hand.
_D08X = D08.replace('dialect = "D08"', 'dialect = "D08X"').replace("boards_d08", "boards_d08x")
D08X = "\n".join(line for line in _D08X.splitlines() if "EJMC4" not in line)

driver = Driver(
    "hubo_motor",
    device=HuboMotor,
    twin=HuboMotorTwin,
    example=D12,
    doc="Motor boards of the Hubo humanoids: 1, 2, 3 or 5 motors, DRC-Hubo's hand and neck",
    source="hubo-ach; HuboCan; acesHubo; HUBO2_CANprotocol.xls",
    scan=scan_boards,
    settings=described(BoardSettings),
)
