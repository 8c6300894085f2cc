"""The channels of a module, for both ends: which bit or number of which object each is, and what its numbers are in SI.

Objects of CiA 401: 6000 digital inputs and 6200 digital outputs, eight a subindex; 6401 analog inputs and 6411 analog
outputs of 16 bits, one a subindex.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, Literal

import msgspec
from msgspec import Meta

from aces_bus.errors import CallerError

from ..canopen_node.dictionary import OwnFile, read_dictionary
from ..canopen_node.settings import NodeSettings

if TYPE_CHECKING:
    from canopen import ObjectDictionary

Kind = Literal["digital_input", "digital_output", "analog_input", "analog_output"]
#: Kind → its object, what a channel without a name is called, channels a subindex.
KINDS: dict[Kind, tuple[int, str, int]] = {
    "digital_input": (0x6000, "di", 8),
    "digital_output": (0x6200, "do", 8),
    "analog_input": (0x6401, "ai", 1),
    "analog_output": (0x6411, "ao", 1),
}
OUTPUTS = (0x6200, 0x6411)
#: Output object → which of its outputs take an error value, and that value, by subindex.
ERROR_VALUES = {0x6200: (0x6206, 0x6207), 0x6411: (0x6443, 0x6444)}
#: What these are where a module does not have them (CiA 401's defaults): all outputs, to 0.
USUAL_ERRORS = {0x6206: 0xFF, 0x6207: 0, 0x6443: 1, 0x6444: 0}
#: The range of analog numbers.
LEAST, MOST = -(1 << 15), (1 << 15) - 1

OWN = OwnFile(
    "aces_devices.cia401",
    "module.eds",
    tuple(index for index, _, _ in KINDS.values()),
    "has none of the objects 6000, 6200, 6401, 6411: no module of CiA 401 with inputs and outputs of 8 and 16 bits",
)


class ChannelSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A channel with a name, in a robot file."""

    kind: Kind
    number: Annotated[int, Meta(ge=1, description="which one of its kind, from 1 on")]
    unit: Annotated[str, Meta(description="of analog ones: the unit, SI; none when absent")] = ""
    scale: Annotated[
        float, Meta(description="of analog ones: value = number × scale + offset; 1 when absent")
    ] = 1.0
    offset: float = 0.0
    lower: float | None = None
    upper: float | None = None
    stop: Annotated[
        float | bool | None,
        Meta(
            description="of outputs: the value that stops it; when absent the module's own error value (6207, 6444)"
        ),
    ] = None


class ModuleSettings(NodeSettings, frozen=True, kw_only=True):
    """The driver's own keys in a robot file."""

    eds: Annotated[
        str | None, Meta(description="the module's EDS or DCF file; our own module's when absent")
    ] = None
    channels: Annotated[
        dict[str, ChannelSettings],
        Meta(
            description="channels with names: door = { kind, number, unit, scale, offset, lower, upper, stop }"
        ),
    ] = msgspec.field(default_factory=dict[str, ChannelSettings])
    every_s: Annotated[
        float,
        Meta(gt=0, description="how often all channels are read over SDO, beside PDOs (s), 0.5 when absent"),
    ] = 0.5


@dataclass(frozen=True)
class IoChannel:
    """One input or output: its object, and of digital ones its bit there (None: the whole number)."""

    name: str
    index: int
    subindex: int
    bit: int | None
    given: ChannelSettings

    @property
    def is_output(self) -> bool:
        """True if the channel can be set."""
        return self.index in OUTPUTS

    @property
    def where(self) -> tuple[int, int]:
        """Index and subindex of its object."""
        return self.index, self.subindex

    def value(self, number: int) -> Any:
        """Return what it is, its object being `number`."""
        if self.bit is not None:
            return bool(number >> self.bit & 1)
        return number * self.given.scale + self.given.offset

    def put(self, number: int, value: Any) -> int:
        """Return the object's number with another value of this channel; those that do not fit stop at the end of the
        range.
        """
        if self.bit is not None:
            return number & ~(1 << self.bit) | bool(value) << self.bit
        return min(max(round((float(value) - self.given.offset) / self.given.scale), LEAST), MOST)


def module_dictionary(path: str | None, node: int) -> Any:
    """Return the dictionary of a module's file (None: our own module's). Raises `CallerError` for a file that is none."""
    return read_dictionary(path, node, OWN)


def io_channels(who: str, settings: ModuleSettings, dictionary: ObjectDictionary) -> dict[str, IoChannel]:
    """Return all channels that a module's file has, by name. Raises `CallerError` for a name of one that it does not
    have.
    """
    count = {kind: _count(dictionary, index) * each for kind, (index, _, each) in KINDS.items()}
    named = {(given.kind, given.number): (name, given) for name, given in settings.channels.items()}
    for name, given in settings.channels.items():
        if given.number > count[given.kind]:
            raise CallerError(
                f"{who}: channel {name} is {given.kind} {given.number}; the module has {count[given.kind]}"
            )
        if not given.scale:
            raise CallerError(f"{who}: channel {name}: a scale of 0 gives nothing")
        if named[given.kind, given.number][0] != name:
            raise CallerError(f"{who}: channels {name} and {named[given.kind, given.number][0]} are one")
    found: dict[str, IoChannel] = {}
    for kind, (index, usual, each) in KINDS.items():
        for number in range(1, count[kind] + 1):
            plain = ChannelSettings(kind=kind, number=number)
            name, given = named.get((kind, number), (f"{usual}{number}", plain))
            bit = (number - 1) % each if each > 1 else None
            if name in found:
                raise CallerError(f"{who}: two channels are called {name}")
            found[name] = IoChannel(name, index, (number - 1) // each + 1, bit, given)
    return found


def _count(dictionary: ObjectDictionary, index: int) -> int:
    """Return how many subindices an array has."""
    entry = dictionary.get(index)
    if entry is None or hasattr(entry, "data_type"):
        return 0
    return sum(1 for member in entry.values() if member.subindex)
