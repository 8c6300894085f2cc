"""Which motor boards are on a bus: every number is asked, and the answers show which kind of board it is.

1. Looking changes nothing: encoder and status requests first. Only a number that answers neither is asked for its name,
   which also sets the board's command period (to what this host's rate means).
2. A board whose answers are those of its kind in the robot's (or protocol's) table is of that kind; otherwise the length of
   its answers says how many channels it has. One and two channels answer alike: then it is taken for two.
"""

from __future__ import annotations

from contextlib import suppress
from typing import Any

from aces_bus.device import Job, Steps
from aces_bus.device.config import DeviceConfig
from aces_bus.device.host import Host
from aces_bus.errors import AcesError, CallerError
from aces_bus.protocol import Record

#: Numbers of motor boards.
BOARDS = range(0x30)
#: So many boards are asked at once, and so long their answers may take (ns).
AT_ONCE, PATIENCE_NS = 8, 8_000_000
#: Identifiers of encoder and status replies, less the board's number.
_ENCODER, _STATUS = 0x060, 0x150


def name_of(board: int) -> str:
    """Return what such a board is called: JMC0 to JMC15, EJMC0 from 0x20 on."""
    if board < 0x10:
        return f"JMC{board}"
    return f"EJMC{board - 0x20}" if board >= 0x20 else f"BOARD_{board:#04x}"


def channels_by_length(lengths: list[int], dialect: str) -> int | None:
    """Return how many channels a board has whose encoder replies are so long: 4 bytes one, 8 two, 6 three; 6 and 4 five."""
    if dialect == "D12" and 6 in lengths and 4 in lengths:
        return 5
    return next((channels for size, channels in ((8, 2), (6, 3), (4, 1)) if size in lengths), None)


def scan_boards(host: Host, job: Job) -> Steps:
    """Return the motor boards that answer on this host's bus, as a list of `DeviceConfig` by number.

    Boards that the host has already, and that answer, are listed as they are. Raises `CallerError` on a bus without Hubo's
    protocol.
    """
    variant = host.variants.get("hubo")
    if variant is None:
        raise CallerError(f"{host.name} does not speak hubo")
    dialect = variant.dialect or "D12"
    table = dict(variant.tables.get("channels", {})) if variant.tables else {}
    own = {
        device.credentials["board"]: device
        for device in host.devices.values()
        if "board" in device.credentials
    }
    probes = {
        board: host.probe("hubo", board=board)
        for board in BOARDS
        if board not in own and table.get(board) != "power"
    }
    #: Of each number, the lengths of encoder replies that do not fit the kind in the table; of other answers None.
    answers: dict[int, list[int | None]] = {}

    def unknown(record: Record, instant: int) -> None:
        for base in (_ENCODER, _STATUS):
            board = (record.meta.identifier or 0) - base
            if board in probes:
                answers.setdefault(board, []).append(len(record.meta.raw) if base == _ENCODER else None)

    def is_there(board: int) -> bool:
        return board in answers or probes[board].last_received is not None

    host.unknown_handlers.append(unknown)
    try:
        requests = _requests(dialect, host)
        for number, (message, fields, is_for_all) in enumerate(requests):
            waiting = [board for board in probes if is_for_all or not is_there(board)]
            for start in range(0, len(waiting), AT_ONCE):
                for board in waiting[start : start + AT_ONCE]:
                    with suppress(AcesError):  # NameInfo of one byte is for hands only: others are not that
                        probes[board].send(message, **fields)
                yield PATIENCE_NS
            job.progress = (number + 1) / len(requests)
    finally:
        host.unknown_handlers.remove(unknown)
        for probe in probes.values():
            host.remove(probe.name)
    found = [
        device.config
        for device in own.values()
        if device.config.driver == "hubo_motor" and device.last_received is not None and not device.is_silent
    ]
    for board in filter(is_there, probes):
        lengths = [size for size in answers.get(board, ()) if size is not None]
        found.append(_config(host, board, channels_by_length(lengths, dialect), table.get(board)))
    return sorted(found, key=lambda config: config.credentials["board"])


def _requests(dialect: str, host: Host) -> list[tuple[str, dict[str, Any], bool]]:
    """Return what is asked, in order, with the fields, and whether of all numbers or of those that have not answered.

    All but the last are asked twice: a bus loses frames.
    """
    rate = host.rate_hz
    period = {"period": 5 if rate is None else max(1, min(255, round(1000 / rate)))}
    if dialect != "D12":
        return [("SendEncoderD08", {}, True), ("SendStatus", {}, True)] * 2 + [("NameInfo5", period, False)]
    asked: list[tuple[str, dict[str, Any], bool]] = [
        ("SendEncoder", {"selector": "normal"}, True),
        ("SendEncoder", {"selector": "upper"}, True),
        ("SendStatus", {}, True),
    ]
    return [*asked, *asked, ("GetBoardInfo", period, False)]


def _config(host: Host, board: int, measured: int | None, known: Any) -> DeviceConfig:
    """Return a board of so many channels as was measured, else of the kind in the table, else of two channels."""
    kind: str | None = None
    if measured is None and isinstance(known, str):
        measured, kind = 3, known
    channels = measured or (2 if known is None else int(known))
    return DeviceConfig(
        name=name_of(board),
        driver="hubo_motor",
        bus=host.name,
        credentials={"board": board},
        channels=channels,
        kind=kind,
    )
