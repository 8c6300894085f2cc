"""pylx16a, unmodified, on a pseudo-terminal with our twins of LX-16A servos.

1. Real time: only content and order are asserted.
"""

from __future__ import annotations

import time
from typing import Any

from aces_bus import Unknown
from aces_devices.lx16a import driver
from tests.oracles.foreign import oracle
from tests.oracles.serial_lines import served_line

kit: Any = oracle("pylx16a.lx16a", "pylx16a")

LINE = """
name = "pair"
[buses]
line = { link = "serial", protocol = "lx16a", baud = 115_200 }
[devices]
S1 = { driver = "lx16a", bus = "line", credentials = { id = 1 } }
S2 = { driver = "lx16a", bus = "line", credentials = { id = 2 } }
[joints]
J1 = { device = "S1" }
J2 = { device = "S2" }
"""
PATIENCE_S = 5.0


def test_it_moves_reads_and_configures_servos() -> None:
    """Each of its packets is one of our messages, and it understands each of our answers."""
    with served_line(LINE, driver) as line:
        kit.LX16A.initialize(line.path, PATIENCE_S)
        try:
            first, second = kit.LX16A(1), kit.LX16A(2, disable_torque=True)
            assert first.is_torque_enabled(poll_hardware=True)
            assert not second.is_torque_enabled(poll_hardware=True)
            assert first.get_angle_limits(poll_hardware=True) == (0, 240)
            assert first.get_vin_limits(poll_hardware=True) == (4500, 12000)
            assert first.get_temp_limit(poll_hardware=True) == 85
            assert (first.get_temp(), first.get_vin()) == (35, 7400)
            start = first.get_physical_angle()
            first.move(60)
            end = time.monotonic() + PATIENCE_S
            while abs(first.get_physical_angle() - 60) > 0.5 and time.monotonic() < end:
                pass
            assert abs(first.get_physical_angle() - 60) <= 0.5 < abs(start - 60)
            first.move_stop()
            first.set_angle_limits(30, 192)
            first.set_vin_limits(5000, 11000)
            first.set_temp_limit(70)
            first.set_angle_offset(-12)
            assert first.get_angle_limits(poll_hardware=True) == (30, 192)
            assert first.get_vin_limits(poll_hardware=True) == (5000, 11000)
            assert first.get_temp_limit(poll_hardware=True) == 70
            assert first.get_angle_offset(poll_hardware=True) == -12
            first.motor_mode(-500)
            assert first.get_motor_speed(poll_hardware=True) == -500
            first.servo_mode()
            assert not first.is_motor_mode(poll_hardware=True)
            first.led_power_off()
            assert not first.is_led_power_on(poll_hardware=True)
            first.set_led_error_triggers(True, False, True)
            assert first.get_led_error_triggers(poll_hardware=True) == (True, False, True)
            second.set_id(7)
            assert second.get_id(poll_hardware=True) == 7
        finally:
            kit.LX16A._controller.close()
            kit.LX16A._controller = None
        found = line.records()
        assert [one for one in found if isinstance(one, Unknown)] == []
        assert {"Move", "GetPosition", "Position", "SetMode", "SetLimits", "Limits"} <= {
            type(one).__name__ for one in found
        }
