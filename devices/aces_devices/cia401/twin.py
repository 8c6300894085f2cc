"""The twin of a CiA 401 module: inputs that a program puts, outputs that a host sets, error values when it is gone.

1. A changed input is sent with its PDO at once; analog ones only where object 6423 says so, as on a module.
2. When network management stops it, or the host's heartbeat is missed, outputs take the values that 6206, 6207, 6443 and
   6444 say.
"""

from __future__ import annotations

from typing import Any, ClassVar

from aces_bus.device.settings import settings_of
from aces_bus.errors import CallerError, UnknownNameError

from ..canopen_node.twin import HOST_GONE_REGISTER, CanopenTwin
from .channels import (
    ERROR_VALUES,
    KINDS,
    OUTPUTS,
    USUAL_ERRORS,
    IoChannel,
    ModuleSettings,
    io_channels,
    module_dictionary,
)

ANALOG_EVENTS = 0x6423


class Cia401Twin(CanopenTwin):
    """`twin.put("door", True)`, `twin.take("valve")`: channels by name, in the units of the robot's file."""

    faults: ClassVar = {**CanopenTwin.faults, "stuck": "its outputs stay as they are"}

    def setup(self) -> None:
        """Begin with all outputs as the module's file says, all inputs 0."""
        settings = settings_of(self.name, ModuleSettings, self.config.settings)
        dictionary = module_dictionary(settings.eds, self.credentials["node"])
        self.channels = io_channels(self.name, settings, dictionary)
        #: The numbers of all objects of inputs and outputs, by index and subindex.
        self.numbers: dict[tuple[int, int], int] = {channel.where: 0 for channel in self.channels.values()}
        self.has_lost_host = False
        self.add_node(dictionary)
        for index, subindex in self.numbers:
            known = dictionary.get_variable(index, subindex)
            if index in OUTPUTS and isinstance(known.default, int):
                self.numbers[index, subindex] = known.default

    def _channel(self, name: str) -> IoChannel:
        if name not in self.channels:
            raise UnknownNameError(f"channel of {self.name}", name, self.channels)
        return self.channels[name]

    def put(self, name: str, value: Any) -> None:
        """Have an input's value. Raises `UnknownNameError`, `CallerError` for an output."""
        channel = self._channel(name)
        if channel.is_output:
            raise CallerError(f"{self.name}: {name} is an output; the host sets it")
        before = self.numbers[channel.where]
        self.numbers[channel.where] = channel.put(before, value)
        if self.numbers[channel.where] != before:
            self._send_changed(channel)

    def take(self, name: str) -> Any:
        """Return a channel's value, an input's or an output's. Raises `UnknownNameError`."""
        channel = self._channel(name)
        return channel.value(self.numbers[channel.where])

    def _send_changed(self, channel: IoChannel) -> None:
        if self.node.nmt.state != "OPERATIONAL" or not self.is_powered:
            return
        is_quiet = channel.index == KINDS["analog_input"][0] and self.number(ANALOG_EVENTS, 0) == 0
        for number, layout in self.outputs.items():
            is_in = any((place.index, place.subindex) == channel.where for place in layout.places)
            if is_in and not layout.is_synchronous and not is_quiet:
                self.send_pdo(number, layout, self.clock.now())

    # ------------------------------------------------------------------ objects

    def take_object(self, index: int, subindex: int, value: int, now: int) -> None:
        """Take an output."""
        if index in OUTPUTS and (index, subindex) in self.numbers and "stuck" not in self.active_faults:
            self.numbers[index, subindex] = value

    def object_value(self, index: int, subindex: int, now: int) -> Any:
        """Return an input, an output or the error register."""
        if index == 0x1001:
            return HOST_GONE_REGISTER if self.has_lost_host else 0
        return self.numbers.get((index, subindex))

    # ------------------------------------------------------------------ error values

    def lost_host(self, now: int) -> None:
        """Give outputs their error values."""
        self.has_lost_host = True
        self._to_error_values()

    def changed_state(self, state: str, now: int) -> None:
        """Give outputs their error values when the module is stopped."""
        if state == "STOPPED":
            self._to_error_values()
        elif state == "OPERATIONAL":
            self.has_lost_host = False

    def _to_error_values(self) -> None:
        for (index, subindex), number in self.numbers.items():
            if index in OUTPUTS and "stuck" not in self.active_faults:
                mode, value = (
                    self.number(entry, subindex)
                    if self.dictionary.get_variable(entry, subindex) is not None
                    else USUAL_ERRORS[entry]
                    for entry in ERROR_VALUES[index]
                )
                self.numbers[index, subindex] = error_number(index, number, mode, value)


def error_number(index: int, number: int, mode: int, value: int) -> int:
    """Return what an output's object becomes on errors: of digital ones bit by bit, of analog ones as a whole."""
    if index == KINDS["digital_output"][0]:
        return number & ~mode | value & mode
    return value if mode else number
