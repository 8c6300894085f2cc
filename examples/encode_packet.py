"""Packets and registers from values: three ways to say where a Dynamixel servo should go."""

from __future__ import annotations

from aces_bus.errors import FieldError
from aces_protocols.robotis.spec import control_table, robotis


def main() -> None:
    # The message and its fields, as the sheet has them: 0x1E is goal_position, F6 01 is count 502.
    print(robotis.encode("Write", id=1, start=0x1E, data=b"\xf6\x01").hex(" ").upper())

    # The register by its name, in degrees.
    print(control_table.write(1, {"goal_position": 147.2}).hex(" ").upper())

    # The same register of several servos, in one packet.
    print(control_table.sync_write("goal_position", {71: 154.8, 96: 150.1}).hex(" ").upper())

    # What the sheet does not allow is not sent.
    try:
        control_table.write(1, {"goal_position": 301})
    except FieldError as error:
        print(error)


if __name__ == "__main__":
    main()
