"""Damiao DM motors on CAN FD: the frames of `damiao` in the other format.

Source: enactic/openarm_can `src/openarm/canbus`, `src/openarm/damiao_motor` (MIT mode at 1 Mbit/s and 5 Mbit/s).
"""

from __future__ import annotations

from aces_protocols.damiao.spec import declared

damiao_fd = declared("damiao_fd", fd=True)
