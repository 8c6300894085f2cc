"""Setting a node up: what it is, its PDOs, its heartbeat, its ramps, its start. Nothing of it moves the drive.

1. What is read is checked against what the driver needs, and what to do is said.
2. What is written is lost when the drive is switched off: nothing is stored.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from aces_bus.device import Job, Steps
from aces_bus.errors import DeviceError

from ..canopen_node.pdo import MOST, NOT_VALID, RECEIVED, SENT, PdoLayout, layout_of, offset_of, read_layouts
from ..canopen_node.sdo import SdoRefused
from .axis import CONTROLWORD, MODE, MODE_SHOWN, POSITION, STATUSWORD, TORQUE, VELOCITY
from .states import TARGETS, emergency_text

if TYPE_CHECKING:
    from .driver import Cia402

#: Sizes (bits) of the objects that we map.
SIZES = {
    CONTROLWORD: 16,
    STATUSWORD: 16,
    MODE: 8,
    MODE_SHOWN: 8,
    POSITION: 32,
    VELOCITY: 32,
    TORQUE: 16,
    0x607A: 32,
    0x60FF: 32,
    0x6071: 16,
    0x6042: 16,
}


def set_up(device: Cia402, job: Job) -> Steps:
    """Yield the steps up to an operational node."""
    boots = device.boots
    job.text = "identity"
    data: bytes = yield device.sdo.upload(0x1000)
    profile = int.from_bytes(data[:2], "little")
    if profile != 402:
        raise DeviceError(f"{device.name}: node {device.node} is of device profile {profile}, not 402")
    job.progress, job.text = 0.1, "PDOs"
    if device.pdo == "write":
        yield device.send("Nmt", command="pre_operational")
        yield from _write(device)
    elif device.pdo == "read":
        for side in (RECEIVED, SENT):
            found = yield from read_layouts(device, side)
            if side is SENT:
                device.inputs = found
            else:
                device.outputs = found
    _check(device)
    job.progress, job.text = 0.8, "settings"
    if device.heartbeat_ms:
        yield device.sdo.download(0x1017, 0, device.raw(0x1017, 0, device.heartbeat_ms))
    for axis in device.axes:
        joint = axis.joint
        ramps = [(0x6081, joint.nominal_speed)]
        ramps += [(index, joint.nominal_acceleration) for index in (0x6083, 0x6084)]
        for index, value in ramps:
            if value is not None and device.dictionary.get_variable(index + axis.offset) is not None:
                raw = device.raw(index + axis.offset, 0, round(abs(value * axis.units.per_speed)))
                yield device.sdo.download(index + axis.offset, 0, raw)
    yield from _last_error(device)
    job.progress, job.text = 0.9, "start"
    if device.boots != boots:
        return
    yield device.send("Nmt", command="start")
    device.begin()
    received = [axis.received for axis in device.axes]
    yield device.until(
        lambda: (
            device.network.last == "operational"
            or any(axis.received > before for axis, before in zip(device.axes, received, strict=True))
        ),
        1.0 + 2 * device.heartbeat_ms / 1000,
        lambda: f"node {device.node} was started, and sends neither PDOs nor that it is operational",
    )


def _last_error(device: Cia402) -> Steps:
    """Return the error that is there already: emergencies report new ones only."""
    try:
        data: bytes = yield device.sdo.upload(0x603F)
    except SdoRefused:
        code = 0
    else:
        code = int.from_bytes(data[:2], "little")
    device.error.update(emergency_text(code) if code else "", device.clock.now())


def _check(device: Cia402) -> None:
    """Raise `DeviceError` unless what the driver needs in each tick is in PDOs that are sent when expected."""
    help_ = 'settings pdo = "write" makes it so'
    for axis in device.axes:
        holders = [
            pdo
            for pdo in device.inputs.values()
            if any(place.index == STATUSWORD + axis.offset for place in pdo.places)
        ]
        if not holders:
            raise DeviceError(f"{device.name}: no PDO has the statusword of {axis.joint.name}; {help_}")
        if device.sync and holders[0].kind != 1:
            raise DeviceError(
                f"{device.name}: PDO {holders[0].number} is sent by transmission type {holders[0].kind}, not at each SYNC"
                f" (1); {help_}, and sync = false does without"
            )
        if not device.sync and holders[0].is_synchronous:
            raise DeviceError(
                f"{device.name}: PDO {holders[0].number} is sent at SYNC; settings sync = true sends it"
            )


def _write(device: Cia402) -> Steps:
    """Write the PDOs that the driver prefers: one each way for state and target of an axis, and one for the
    rest while there are numbers left.
    """
    axes = len(device.axes)
    if axes > MOST:
        raise DeviceError(
            f"{device.name}: {axes} axes need {axes} PDOs each way; {MOST} have predefined identifiers"
        )
    out: dict[int, list[int]] = {}
    back: dict[int, list[int]] = {}
    for number, axis in enumerate(device.axes, 1):
        target = TARGETS[axis.wanted][1]
        out[number] = [index + axis.offset for index in (CONTROLWORD, target, MODE)]
        back[number] = [index + axis.offset for index in (STATUSWORD, POSITION, MODE_SHOWN)]
        if number + axes <= MOST:
            rest = [index for index in (0x60FF, 0x6071) if index != target]
            rest += [0x607A] if target in (0x60FF, 0x6042) and len(rest) < 2 else []
            known = [
                index + axis.offset for index in rest if device.dictionary.get_variable(index + axis.offset)
            ]
            out[number + axes] = known
            back[number + axes] = [index + axis.offset for index in (VELOCITY, TORQUE)]
    device.outputs = yield from _write_side(device, RECEIVED, out)
    device.inputs = yield from _write_side(device, SENT, back)


def _write_side(device: Cia402, side: tuple[int, int, int], wanted: dict[int, list[int]]) -> Steps:
    """Write PDOs in the order that CiA 301 wants: off, no objects, objects, their number, on."""
    communication, mapping, base = side
    found: dict[int, PdoLayout] = {}
    kind = 1 if device.sync else 255
    for number in range(1, MOST + 1):
        index, objects = communication + number - 1, mapping + number - 1
        if index not in device.dictionary:
            if wanted.get(number):
                raise DeviceError(f"{device.name}: its file has no PDO {number} ({index:04X})")
            continue
        identifier = base + 0x100 * (number - 1) + device.node
        yield device.sdo.download(index, 1, (identifier | NOT_VALID).to_bytes(4, "little"))
        if not wanted.get(number):
            continue
        yield device.sdo.download(objects, 0, b"\0")
        entries = [entry << 16 | SIZES[entry - offset_of(entry)] for entry in wanted[number]]
        for subindex, entry in enumerate(entries, 1):
            yield device.sdo.download(objects, subindex, entry.to_bytes(4, "little"))
        yield device.sdo.download(objects, 0, bytes((len(entries),)))
        yield device.sdo.download(index, 2, bytes((kind,)))
        raw = {1: identifier, 2: kind}
        if side is SENT and kind == 255:
            yield device.sdo.download(index, 5, device.event_ms.to_bytes(2, "little"))
            raw[5] = device.event_ms
        yield device.sdo.download(index, 1, identifier.to_bytes(4, "little"))
        made = layout_of(device.name, device.dictionary, number, base, device.node, raw, entries)
        if made is not None:
            found[number] = made
    return found
