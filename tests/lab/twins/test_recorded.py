"""Recordings as devices: requests have the answers that they had, and what cannot be answered is reported."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import can
import pytest

from aces_bus.errors import CallerError, UnknownNameError
from aces_lab.twins import TwinBench, open_bench
from aces_protocols.modbus.spec import modbus
from aces_protocols.odrive.spec import odrive

serial: Any = pytest.importorskip("serial")
METER: dict[str, Any] = {"registers": {"voltage": {"address": 0, "type": "u16", "table": "input"}}}


def ask(port: Any, start: int = 0) -> bytes:
    """Ask a meter for a register."""
    port.write(modbus.encode("ReadRegisters", unit=5, function=4, start=start, count=1))
    return bytes(port.read(7))


def recorded_line(folder: Path) -> Path:
    """A recording of a meter that was read three times: 230 V, 231 V, 232 V."""
    with (
        open_bench("modbus", unit=5, settings=METER) as meter,
        serial.Serial(meter.port, meter.baud, timeout=5.0) as port,
    ):
        for value in (230, 231, 232):
            meter.state.put("voltage", value)
            assert len(ask(port)) == 7
        (file,) = meter.save(folder / "meter")
        return file


def test_a_line_s_recording_answers_in_order(tmp_path: Path) -> None:
    """The k-th time the k-th answer, then the last; another address is not answered, and reported."""
    file = recorded_line(tmp_path)
    with (
        open_bench(str(file), protocol="modbus") as meter,
        serial.Serial(meter.port, meter.baud, timeout=5.0) as port,
    ):
        assert [ask(port)[4] for _ in range(5)] == [230, 231, 232, 232, 232]
        port.timeout = 0.05
        assert ask(port, 9) == b""
        assert (
            "not in the recording, 1 times: ReadRegisters(unit=5, function=4, start=9, count=1)"
            in meter.text()
        )


def talk(motor: TwinBench, goals: list[float]) -> list[float]:
    """Give an ODrive goals, and ask where it is: its positions."""
    found: list[float] = []
    with motor.bus as bus:
        for goal in goals:
            frame = odrive.encode("SetInputPosition", node=3, position=goal, velocity=0.0, torque=0.0)
            bus.send(can.Message(arbitration_id=frame.arbitration_id, data=frame.data, is_extended_id=False))
            asked = odrive.encode("GetEncoderEstimates", node=3)
            bus.send(
                can.Message(
                    arbitration_id=asked.arbitration_id, is_remote_frame=True, dlc=8, is_extended_id=False
                )
            )
            motor.wait(0.01)
            while (message := bus.recv(0.0)) is not None:
                record = odrive.scanner().feed([message])
                found += [one.position for one in record if type(one).__name__ == "EncoderEstimates"]
    return found


def test_a_can_recording_answers_by_the_spec(tmp_path: Path) -> None:
    """A goal of another value is answered as the one recorded, which is said; what was sent unasked comes, too."""
    with open_bench("odrive", node=3, time="virtual", settings={"estimates": "asked"}) as motor:
        motor.call(lambda: motor.twins["ODRIVE1"].motor.place(0, 3.0))  # type: ignore[attr-defined]
        said = talk(motor, [1.0])
        motor.wait(0.3)
        (file,) = motor.save(tmp_path / "motor")
    with open_bench(str(file), protocol="odrive", time="virtual") as again:
        assert talk(again, [1.0]) == said
        assert talk(again, [1.25]) == said
        again.wait(0.3)
        assert "with other numbers, 1 times: SetInputPosition(node=3, position=1.25" in again.text()
        assert again.last("Heartbeat").node == 3


def test_a_recording_in_which_nothing_is_asked_is_refused(tmp_path: Path) -> None:
    """A recording of another protocol, or a protocol that there is not."""
    file = recorded_line(tmp_path)
    with pytest.raises(CallerError, match="nothing in it was asked"):
        open_bench(str(file), protocol="feetech")
    with pytest.raises(UnknownNameError, match="modbus"):
        open_bench(str(file), protocol="modbuss")
