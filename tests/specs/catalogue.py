"""The specs that keep the language honest, by name: `from tests.specs.catalogue import SPECS`.

The root of the repository is on the path of tests, so that `tests.specs` is a namespace package; nothing here is
installed.
"""

from __future__ import annotations

from aces_bus.protocol import Protocol
from tests.specs.automotive import automotive
from tests.specs.cobs import cobs
from tests.specs.cyphal_like import cyphal_like
from tests.specs.database_like import database_like
from tests.specs.dronecan_like import dronecan_like
from tests.specs.dynamixel2 import dynamixel2
from tests.specs.hubovia_like import hubovia_like
from tests.specs.j1939_like import j1939_like
from tests.specs.j1939_long import j1939_long
from tests.specs.mavlink1 import mavlink1
from tests.specs.mit_motor import mit_motor
from tests.specs.modbus_like import modbus_like
from tests.specs.nmea2000_like import nmea2000_like
from tests.specs.odrive_like import odrive_like
from tests.specs.sdo_like import sdo_like
from tests.specs.slip import slip
from tests.specs.uds_like import uds_like
from tests.specs.xbus_like import xbus_like

SPECS: dict[str, Protocol] = {
    protocol.name: protocol
    for protocol in (
        automotive,
        cobs,
        cyphal_like,
        database_like,
        dronecan_like,
        dynamixel2,
        hubovia_like,
        j1939_like,
        j1939_long,
        mavlink1,
        mit_motor,
        modbus_like,
        nmea2000_like,
        odrive_like,
        sdo_like,
        slip,
        uds_like,
        xbus_like,
    )
}
