"""Databases of protocols that the core does not read: CANopen's EDS and DCF, MAVLink's dialects, canboat's NMEA 2000.

They are entry points of the group `aces_bus.databases`, as a stranger's are: a module is imported when a file of its kind is
read.
"""

from __future__ import annotations

from aces_bus.protocol.exchange import DatabaseFormat

DATABASES: tuple[DatabaseFormat, ...] = (
    DatabaseFormat("canopen", (".eds", ".dcf"), "aces_lab.databases.eds:load_eds"),
    DatabaseFormat("mavlink", (".xml",), "aces_lab.databases.mavlink:load_mavlink"),
    DatabaseFormat("canboat", (".json",), "aces_lab.databases.canboat:load_canboat"),
)
