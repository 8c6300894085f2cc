"""Writes the recordings in `captures/`: what a robot would have sent, made by the protocols' own encoders.

1. The same bytes each time, on every machine: seeded, integers only, no clock.
2. `expected.json` says what is in them. It is counted while writing, so that decoding is checked and not repeated.

    python examples/make_captures.py [FOLDER]
"""

from __future__ import annotations

import json
import random
import sys
from collections import Counter
from pathlib import Path
from typing import Any

from construct import Int16ul

from aces_protocols.hubo.spec import hubo
from aces_protocols.minihubo_adc.spec import minihubo_adc
from aces_protocols.robotis.spec import BROADCAST, control_table, robotis

FOLDER = Path(__file__).resolve().parent / "captures"


class Line:
    """A serial line that is being recorded: its bytes, and what they are."""

    def __init__(self, protocol: str, direction: str) -> None:
        self.protocol, self.direction = protocol, direction
        self.data = bytearray()
        self.messages: Counter[str] = Counter()
        self.bins: Counter[str] = Counter()

    def packet(self, message: str, data: bytes) -> None:
        """Write a good packet."""
        self.messages[message] += 1
        self.bins["decoded"] += len(data)
        self.data += data

    def lose(self, kind: str, data: bytes) -> None:
        """Bytes that are not a message, and the bin they belong in."""
        self.bins[kind] += len(data)
        self.data += data

    @property
    def expected(self) -> dict[str, Any]:
        return {
            "protocol": self.protocol,
            "direction": self.direction,
            "total": len(self.data),
            **{name: self.bins[name] for name in ("decoded", "unknown", "malformed", "skipped", "pending")},
            "records": self.messages.total(),
            "messages": dict(sorted(self.messages.items())),
        }


# ---------------------------------------------------------------------- servos


class Servo:
    """A servo as far as a host sees it: a control table that answers."""

    def __init__(self, id: int, position: int) -> None:
        self.id = id
        self.table = bytearray(50)
        for register in control_table.values():
            self.set(register.name, register.default or 0)
        for name, raw in {"model_number": 28, "firmware_version": 0x18, "id": id, "baud_rate": 1}.items():
            self.set(name, raw)
        for name, raw in {"status_return_level": 2, "max_torque": 1023, "torque_limit": 1023}.items():
            self.set(name, raw)
        for name, raw in {"present_voltage": 118, "present_temperature": 36}.items():
            self.set(name, raw)
        self.set("goal_position", position)
        self.set("present_position", position)

    def set(self, name: str, raw: int) -> None:
        register = control_table[name]
        self.table[register.address : register.address + register.size] = register.encode(raw, raw=True)

    def get(self, name: str) -> int:
        register = control_table[name]
        return int(register.decode(bytes(self.table[register.address :][: register.size]), raw=True))

    def move(self) -> None:
        """Advance the motion by a hundredth of a second, at no more than 12 counts."""
        way = self.get("goal_position") - self.get("present_position")
        step = max(-12, min(12, way))
        speed, load = abs(step) * 9, abs(way) // 2
        self.set("present_position", self.get("present_position") + step)
        self.set("present_speed", speed | (0x400 if step < 0 else 0))
        self.set("present_load", load | (0x400 if way < 0 else 0))
        self.set("moving", int(step != 0))

    def answer(self, error: str = "", parameters: bytes = b"") -> bytes:
        return bytes(robotis.encode("Status", id=self.id, error=error, parameters=parameters))


def robotis_session() -> Line:
    """Record a host and two servos on one line: set-up, motion, and faults."""
    line = Line("robotis", "both")
    servos = {1: Servo(1, 512), 2: Servo(2, 300)}

    def send(message: str, **fields: Any) -> None:
        line.packet(message, robotis.encode(message, **fields))

    def read(id: int, first: str, last: str, error: str = "") -> None:
        start = control_table[first].address
        end = control_table[last].address + control_table[last].size
        line.packet("Read", control_table.read(id, first, last))
        line.packet("Status", servos[id].answer(error, bytes(servos[id].table[start:end])))

    def write(id: int, name: str, value: Any, *, message: str = "Write") -> None:
        line.packet(message, control_table.write(id, {name: value}, message=message))
        register = control_table[name]
        servos[id].set(name, int.from_bytes(register.encode(value), "little"))
        line.packet("Status", servos[id].answer())

    line.lose("skipped", bytes([0x00, 0x13, 0x7E]))  # the adapter is switched on
    for servo in servos.values():
        send("Ping", id=servo.id)
        line.packet("Status", servo.answer())

    # A Ping whose last byte is hit: its first byte is malformed, the rest is not a header. It is not answered.
    ping = bytearray(robotis.encode("Ping", id=3))
    ping[-1] ^= 0x10
    line.lose("malformed", bytes(ping[:1]))
    line.lose("skipped", bytes(ping[1:]))

    for id in servos:
        read(id, "model_number", "punch")
        write(id, "torque_enable", "on")
    write(1, "led", "on")

    # Both start at the same moment: the goals are held until the broadcast.
    write(1, "goal_position", 180.0, message="RegWrite")
    write(2, "goal_position", 120.0, message="RegWrite")
    send("Action", id=BROADCAST)

    for turn in range(30):
        if turn and turn % 10 == 0:
            goals = {1: 150.0 + turn, 2: 90.0 + 2 * turn}
            line.packet("SyncWrite", control_table.sync_write("goal_position", goals))
            for id, goal in goals.items():
                servos[id].set("goal_position", round(goal * 1023 / 300))
        for servo in servos.values():
            servo.move()
            if (turn, servo.id) == (7, 1):
                line.lose("skipped", b"\xff")  # FF FF FF: the header is the last two
            if (turn, servo.id) == (18, 2):
                line.lose("skipped", bytes([0x80, 0x00, 0xFE, 0xFF, 0x07]))
            error = "overload" if (turn, servo.id) == (12, 2) else ""
            read(servo.id, "present_position", "present_temperature", error)

    # A goal that is out of range: 0x0BB8 is 3000.
    send("Write", id=2, start=control_table["goal_position"].address, data=Int16ul.build(3000))
    line.packet("Status", servos[2].answer("range"))
    # An instruction of a later version of the protocol: a whole packet, but none of ours.
    line.lose("unknown", with_check(bytes([2, 2, 0x08])))
    # The recording ends within an answer.
    line.packet("Read", control_table.read(1, "present_voltage"))
    line.lose("pending", servos[1].answer("", bytes([118]))[:5])
    return line


def with_check(body: bytes) -> bytes:
    """Return a packet that the protocol's own encoder has no message for."""
    return b"\xff\xff" + body + bytes([~sum(body) & 0xFF])


def hex_dump(data: bytes) -> bytes:
    """Return bytes as the vendor's serial monitor prints them; its character column is Latin-1, in UTF-8."""
    rows: list[str] = []
    for at in range(0, len(data), 16):
        row = data[at : at + 16]
        cells = row.hex(" ").upper().ljust(47)
        shown = "".join(chr(b) if 0x20 <= b < 0x7F or b >= 0x80 else "." for b in row)
        rows.append(f" {cells}   {shown:<16}\n")
    return f'Port opened by process "example.exe" (PID: 1)\n\n{"".join(rows)}\nPort closed\n\n'.encode()


# ---------------------------------------------------------------------- converter board


def adc() -> Line:
    """500 samples near mid-scale, entered and left within a frame."""
    line = Line("minihubo_adc", "from device")
    rng = random.Random(11)

    def sample() -> bytes:
        channels = [base + int(rng.random() * span) for base, span in ((2309, 13), (2789, 27), (2044, 14))]
        return bytes(minihubo_adc.encode("Sample", channels=channels))

    line.lose("skipped", bytes([0x09, 0x0A, 0xF1, 0x08, 0x02]))
    for _ in range(500):
        line.packet("Sample", sample())
    line.lose("pending", sample()[:3])
    return line


# ---------------------------------------------------------------------- Hubo 2+


class Bus:
    """CAN buses that are being recorded as `candump -L` writes them."""

    #: µs from frame to frame, and the first instant.
    STEP, START = 250, 1_000_000_000

    def __init__(self) -> None:
        self.lines: list[str] = []
        self.messages: Counter[str] = Counter()
        self.bins: Counter[str] = Counter()
        self.now = self.START

    def line(self, channel: str, identifier: str, data: bytes) -> None:
        self.lines.append(
            f"({self.now // 1_000_000}.{self.now % 1_000_000:06}) {channel} {identifier}#{data.hex().upper()}\n"
        )
        self.now += self.STEP

    def send(self, channel: str, message: str, **fields: Any) -> None:
        """Write a good frame."""
        frame = hubo.encode(message, **fields)
        self.messages[message] += 1
        self.bins["decoded"] += 1
        self.line(channel, f"{frame.arbitration_id:03X}", bytes(frame.data))

    def lose(self, kind: str, channel: str, identifier: str, data: str = "") -> None:
        """Write a frame that is not a message, and count it in its bin."""
        self.bins[kind] += 1
        self.line(channel, identifier, bytes.fromhex(data))

    @property
    def expected(self) -> dict[str, Any]:
        return {
            "protocol": "hubo",
            "direction": None,
            "total": len(self.lines),
            **{name: self.bins[name] for name in ("decoded", "unknown", "malformed", "errors")},
            "records": self.messages.total(),
            "messages": dict(sorted(self.messages.items())),
        }


#: Boards by bus, with how many channels they have: the right leg on can0, the right arm and hand on can1.
LOWER, UPPER = {0x00: 2, 0x01: 1, 0x02: 1, 0x03: 2}, {0x08: 2, 0x09: 2, 0x20: 2, 0x24: 5}
BOARDS = {"can0": LOWER, "can1": UPPER}


def hubo2plus() -> Bus:
    """Half a second of a Hubo 2+: boards answer for themselves, then references and encoders at 100 Hz."""
    bus = Bus()
    rng = random.Random(12)

    def noise(span: int) -> int:
        return int(rng.random() * (2 * span + 1)) - span

    # Who is there, and with which gains and limits: the reply at 0x1C0 means what was asked for.
    for channel, boards in BOARDS.items():
        for board in boards:
            bus.send(channel, "GetBoardInfo", board=board, period=10)
            bus.send(channel, "BoardInfo", board=board, period=10)
    gains = {"kp": 900, "ki": 0, "kd": 120, "resolution": 4000, "auto_scale": 1, "direction": "ccw"}
    for selector in (1, 7):
        bus.send("can0", "GetParameters", board=3, selector=selector)
        bus.send("can0", "Parameters1", board=3, **gains)
    bus.send("can0", "GetParameters", board=3, selector=4)
    limits = {"upper_limit_high": 65536, "max_acceleration": 500, "max_velocity": 60, "max_pwm": 100}
    bus.send("can0", "Parameters4", board=3, **limits)

    for channel, boards in BOARDS.items():
        for board in boards:
            bus.send(channel, "DriverSwitch", board=board, state="on")
            bus.send(channel, "ControlOn", board=board)

    for cycle in range(50):
        bus.now = max(bus.now, bus.START + 100_000 + 10_000 * cycle)
        goal = 240 * min(cycle, 25) - 3000
        for channel, boards in BOARDS.items():
            for board, motors in boards.items():
                bus.send(channel, "SendEncoder", board=board, selector="normal")
                position = [goal + noise(15) if motor < motors else 0 for motor in range(2)]
                if motors < 5:
                    bus.send(channel, "Encoder", board=board, position=position)
                    bus.send(channel, "Reference", board=board, position=[goal, goal if motors > 1 else 0])
                else:
                    bus.send(channel, "Encoder5", board=board, position=[noise(9), noise(9), noise(9)])
        if cycle % 10 == 0:
            bus.send("can0", "SensorRequest", sensor=0xFF, mode="scaled")
            force = {"mx": noise(300) / 100, "my": noise(300) / 100, "fz": 280 + noise(40) / 10}
            bus.send("can0", "ForceTorque", sensor=1, **force)
            bus.send("can0", "Tilt", sensor=1, ax=noise(200) / 100, ay=noise(200) / 100, az=1)
        if cycle % 25 == 5:
            for channel, boards in BOARDS.items():
                for board, motors in boards.items():
                    bus.send(channel, "SendCurrent", board=board)
                    if motors < 5:
                        amps = [abs(noise(400)) / 100 if motor < motors else 0 for motor in range(2)]
                        bus.send(channel, "Current", board=board, current=amps, temperature=41)
                    else:
                        finger = [abs(noise(200)) / 1000 for _ in range(5)]
                        bus.send(channel, "Current5", board=board, current=finger)
        if cycle in (20, 40):
            # The right knee runs into its limit switch, and is fine again later.
            knee = {"drive": ["driver_on", "control_on"], "home": "homed", "errors": []}
            if cycle == 20:
                knee = {**knee, "drive": ["driver_on", "limit_switch"], "errors": ["jam", "above_maximum"]}
            bus.send("can0", "SendStatus", board=2)
            bus.send("can0", "Status", board=2, motor=[knee, {"drive": [], "home": 0, "errors": []}])
        if cycle == 3:
            bus.lose(
                "errors", "can0", "20000004", "0004000000000000"
            )  # the controller's receive buffer ran over
            bus.lose("malformed", "can0", "012", "BC3100")  # half a reference
            bus.lose("unknown", "can1", "7A0", "0102030405060708")  # an identifier that no board has
            bus.lose("unknown", "can0", "1C2", "0000290000000000")  # a reply whose request was not seen
    return bus


def captures() -> dict[str, bytes]:
    """Every file of `captures/`, by name."""
    session, samples, robot = robotis_session(), adc(), hubo2plus()
    expected = {
        "adc.bin": samples.expected,
        "hubo2plus.log": robot.expected,
        "robotis_session.bin": session.expected,
        "robotis_session.dxconf.txt": session.expected,
    }
    return {
        "adc.bin": bytes(samples.data),
        "hubo2plus.log": "".join(robot.lines).encode(),
        "robotis_session.bin": bytes(session.data),
        "robotis_session.dxconf.txt": hex_dump(bytes(session.data)),
        "expected.json": (json.dumps(expected, indent=2, ensure_ascii=False, sort_keys=True) + "\n").encode(),
    }


def main() -> None:
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else FOLDER
    folder.mkdir(parents=True, exist_ok=True)
    for name, data in captures().items():
        (folder / name).write_bytes(data)
        print(f"{name}: {len(data)} bytes")


if __name__ == "__main__":
    main()
