"""Which motor boards are on a bus: every number is asked, and what answers is told apart by what it answers.

1. Looking changes nothing: encoder and status requests first. Only a number that answers neither is asked for its name,
   which also sets the board's command period (to what this host's rate means).
2. A board whose answers are those of its kind in the robot's (or protocol's) table is of that kind; otherwise the length of
   its answers says how many channels it has. One and two channels answer alike: then it is taken for two.
"""

from __future__ import annotations

from typing import Any

from aces_bus.device import Device, DeviceConfig, Job, Steps
from aces_bus.errors import AcesError, CallerError
from aces_protocols.hubo.spec import hubo

#: Numbers of motor boards.
BOARDS = range(0x30)
#: So many boards are asked at once, and so long their answers may take (ns).
AT_ONCE, PATIENCE = 8, 8_000_000
#: Identifiers of encoder and status replies, less the board's number.
_ENCODER, _STATUS = 0x060, 0x150


class _Probe(Device):
    """Whoever has this number."""

    protocol = hubo
    is_there = False

    def setup(self) -> None:
        """Nothing has been heard."""
        #: Lengths of encoder replies that do not fit the kind in the table.
        self.lengths: list[int] = []

    def heard(self, record: Any, instant: int) -> None:
        """Something of this number."""
        self.is_there = True


def name_of(board: int) -> str:
    """What such a board is called: JMC0 to JMC15, EJMC0 from 0x20 on."""
    if board < 0x10:
        return f"JMC{board}"
    return f"EJMC{board - 0x20}" if board >= 0x20 else f"BOARD_{board:#04x}"


def channels_by_length(lengths: list[int], dialect: str) -> int | None:
    """How many channels a board has whose encoder replies are so long: 4 bytes one, 8 two, 6 three; 6 and 4 five."""
    if dialect == "D12" and 6 in lengths and 4 in lengths:
        return 5
    return next((channels for size, channels in ((8, 2), (6, 3), (4, 1)) if size in lengths), None)


def scan_boards(host: Any, job: Job) -> Steps:
    """The motor boards that answer on this host's bus, as a list of `DeviceConfig` by number.

    Boards that the host has already and hears are listed as they are. Raises `CallerError` on a bus without Hubo's protocol.
    """
    variant = next((v for v in host.variants.values() if v.protocol.name == "hubo"), None)
    if variant is None:
        raise CallerError(f"{host.name} does not speak hubo")
    dialect = variant.dialect or "D12"
    table = dict(variant.tables.get("channels", {})) if variant.tables else {}
    own = {
        device.credentials["board"]: device.config
        for device in host.devices.values()
        if "board" in device.credentials
    }
    robot = _no_robot()
    probes: dict[int, _Probe] = {}
    for board in BOARDS:
        if board not in own and table.get(board) != "power":
            config = DeviceConfig(
                name=f"probe {board:#04x}", driver="hubo_motor", bus=host.name, credentials={"board": board}
            )
            probes[board] = host.add(_Probe(host, config, robot, variant))

    def unknown(word: Any, instant: int) -> None:
        identifier = word.meta.identifier
        for base in (_ENCODER, _STATUS):
            probe = None if identifier is None else probes.get(identifier - base)
            if probe is not None:
                probe.is_there = True
                if base == _ENCODER:
                    probe.lengths.append(len(word.meta.raw))

    host.unknown_handlers.append(unknown)
    try:
        requests = _requests(dialect, host)
        for number, (message, fields) in enumerate(requests):
            waiting = [p for p in probes.values() if fields is not None or not p.is_there]
            for start in range(0, len(waiting), AT_ONCE):
                for probe in waiting[start : start + AT_ONCE]:
                    _tell(probe, message, fields)
                yield PATIENCE
            job.progress = (number + 1) / len(requests)
    finally:
        host.unknown_handlers.remove(unknown)
        for probe in probes.values():
            host.remove(probe.name)
    found = [config for config in own.values() if config.driver == "hubo_motor" and _is_heard(host, config)]
    for board, probe in probes.items():
        if probe.is_there:
            found.append(_config(host, board, probe, table.get(board), dialect))
    return sorted(found, key=lambda config: config.credentials["board"])


def _requests(dialect: str, host: Any) -> list[tuple[str, dict[str, Any] | None]]:
    """What is asked, in order; None: of those that have not answered, with the period."""
    asked: list[tuple[str, dict[str, Any] | None]]
    if dialect == "D12":
        asked = [
            ("SendEncoder", {"selector": "normal"}),
            ("SendEncoder", {"selector": "upper"}),
            ("SendStatus", {}),
        ]
        # Twice: a bus loses words.
        return [*asked, *asked, ("GetBoardInfo", None)]
    asked = [("SendEncoderD08", {}), ("SendStatus", {})]
    return [*asked, *asked, ("NameInfo5", None)]


def _tell(probe: _Probe, message: str, fields: dict[str, Any] | None) -> None:
    if fields is None:
        rate = probe.host.rate_hz
        fields = {"period": 5 if rate is None else max(1, min(255, round(1000 / rate)))}
    try:
        probe.tell(message, **fields)
    except AcesError:
        return  # NameInfo of one byte is for hands only: other kinds have answered, or are not there


def _is_heard(host: Any, config: DeviceConfig) -> bool:
    device = host.devices[config.name]
    return device.last_heard is not None and not device.is_silent


def _config(host: Any, board: int, probe: _Probe, known: Any, dialect: str) -> DeviceConfig:
    measured = channels_by_length(probe.lengths, dialect)
    kind: str | None = None
    if known is not None and measured is None:
        channels = 3 if isinstance(known, str) else int(known)
        kind = known if isinstance(known, str) else None
    else:
        channels = measured if measured is not None else 2
    return DeviceConfig(
        name=name_of(board),
        driver="hubo_motor",
        bus=host.name,
        credentials={"board": board},
        channels=channels,
        kind=kind,
    )


def _no_robot() -> Any:
    from aces_bus.device import Robot

    return Robot(name="scan", buses={}, devices={}, joints={}, sensors={})
