"""What a dataset consists of, and what is missing of it."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

from aces_bus.errors import CallerError
from aces_bus.recordings.base import Link
from aces_tools.reading.totals import Totals

from .manifest import FleetDataset, FleetInput, InputState, joined_totals


@dataclass
class FleetStatus:
    """The inputs of a dataset, by URI; `cut_off` are those that an attempt has begun to write, and not ended."""

    dataset: str
    inputs: dict[str, FleetInput]
    cut_off: list[str]
    #: The datasets of messages that there are.
    messages: list[str]

    @property
    def states(self) -> dict[InputState, int]:
        """Number of inputs by their state."""
        return dict(Counter(entry.state for entry in self.inputs.values()))

    @property
    def total(self) -> dict[Link, Totals]:
        """Frames and bytes by their outcome, per link: the sum over the inputs."""
        return joined_totals(self.inputs.values())

    @property
    def bytes(self) -> int:
        """Of all inputs, as they are stored."""
        return sum(entry.size for entry in self.inputs.values())

    @property
    def duration_s(self) -> float:
        """Of all inputs together, from the first to the last decoded message of each."""
        return sum(entry.duration_s or 0.0 for entry in self.inputs.values())

    @property
    def seconds(self) -> float:
        """That workers took."""
        return sum(entry.seconds for entry in self.inputs.values())

    @property
    def faulty(self) -> list[FleetInput]:
        """Inputs of which something could not be read, or nothing."""
        return [entry for entry in self.inputs.values() if entry.faults]


def status(dataset: str) -> FleetStatus:
    """Return what a dataset consists of; also while a run writes it. Raises `CallerError` where there is none."""
    place = FleetDataset(dataset)
    place.check()
    inputs = place.manifest()
    journal = place.journal()
    cut_off = {entry.uri for entry in journal.values() if entry.state == "placing"}
    for entry in journal.values():
        if entry.state != "placing":
            inputs[entry.uri] = entry
            cut_off.discard(entry.uri)
    if not inputs and not cut_off:
        raise CallerError(
            f"{place.uri}: no dataset of a fleet; aces decode … -o {dataset} --cluster … makes one"
        )
    return FleetStatus(place.uri, inputs, sorted(cut_off), list(place.folders()))
