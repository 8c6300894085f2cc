"""A node's objects by hand: read, written, asked what it is.

1. What is written wants a word: it goes past every check that the driver makes.
"""

from __future__ import annotations

from typing import Any

from aces_bus.device import Device, Job, Steps
from aces_bus.errors import AcesError, CallerError

from .dictionary import object_of
from .sdo import SdoChannel

#: What `identity` asks for: name, index, subindex. The first must be there.
IDENTITY = (
    ("type", 0x1000, 0),
    ("vendor", 0x1018, 1),
    ("product", 0x1018, 2),
    ("revision", 0x1018, 3),
    ("serial", 0x1018, 4),
    ("name", 0x1008, 0),
)


class ObjectAccess(Device):
    """A CANopen node with its dictionary (canopen's) and its SDO channel."""

    dictionary: Any
    sdo: SdoChannel

    def raw(self, index: int, subindex: int, value: Any) -> bytes:
        """Return an object's value as bytes, as the node's file says. Raises `CallerError` for what does not fit."""
        known = self.dictionary.get_variable(index, subindex)
        if known is None:
            raise CallerError(
                f'{self.name}: its file has no object {index:04X}:{subindex}; give bytes, as value="0f 00"'
            )
        try:
            return bytes(known.encode_raw(value))
        except Exception as error:  # of canopen and struct, by type of object
            raise CallerError(f"{self.name}: {value!r} is no value of {known.name}: {error}") from None

    def read(self, object: str | int) -> Job:
        """Read an object over SDO: its value, or its bytes in hexadecimal where the file does not know it."""
        index, subindex, known = object_of(self.dictionary, object)

        def steps(job: Job) -> Steps:
            data: bytes = yield self.sdo.upload(index, subindex)
            if known is None:
                return data.hex(" ")
            try:
                value = known.decode_raw(data)
            except Exception:  # another length than the file says
                return data.hex(" ")
            return _printable(data) if isinstance(value, str) else value

        return self.job(f"read {index:04X}:{subindex}", steps)

    def write(self, object: str | int, value: Any, confirm: bool = False) -> Job:
        """Write an object over SDO. Raises `CallerError` without `confirm`: it may move the device, or outlive it."""
        index, subindex, known = object_of(self.dictionary, object)
        if confirm is not True:
            raise CallerError(
                f"{self.name}: writing object {index:04X}:{subindex} goes past all checks; confirm=true if you mean it"
            )
        if known is None and isinstance(value, str):
            try:
                data = bytes.fromhex(value)
            except ValueError:
                raise CallerError(f"{self.name}: {value!r} is not bytes in hexadecimal") from None
        else:
            data = self.raw(index, subindex, value)
        return self.sdo.download(index, subindex, data)

    def identity(self) -> Job:
        """Read what the node says about itself: device type, vendor, product, revision, serial number, name."""

        def steps(job: Job) -> Steps:
            found: dict[str, Any] = {}
            for number, (name, index, subindex) in enumerate(IDENTITY):
                try:
                    data: bytes = yield self.sdo.upload(index, subindex)
                except AcesError:
                    if index == 0x1000:
                        raise
                    continue  # optional
                found[name] = _printable(data) if name == "name" else int.from_bytes(data, "little")
                job.progress = (number + 1) / 6
            return found

        return self.job("identity", steps)


def _printable(data: bytes) -> str:
    """Text of a device, without what a terminal would take for a command."""
    return "".join(one if one.isprintable() else "?" for one in data.decode("ascii", "replace").rstrip("\0"))
