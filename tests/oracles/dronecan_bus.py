"""A bus of python-can for nodes of dronecan."""

from __future__ import annotations

from typing import Any

import can

from tests.oracles.foreign import oracle

driver = oracle("dronecan.driver.common", "dronecan")


class BusDriver(driver.AbstractDriver):  # type: ignore[name-defined,misc]
    """A bus of python-can as dronecan has its drivers; its own waits a thousand times too long."""

    def __init__(self, bus: can.BusABC) -> None:
        super().__init__()
        self.bus = bus

    def send_frame(self, frame: Any) -> None:
        self.bus.send(
            can.Message(arbitration_id=frame.id, data=bytes(frame.data), is_extended_id=frame.extended)
        )

    def receive(self, timeout: float | None = None) -> Any:
        message = self.bus.recv(0)
        return None if message is None else driver.CANFrame(message.arbitration_id, bytes(message.data), True)

    def close(self) -> None:
        self.bus.shutdown()
