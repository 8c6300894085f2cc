"""Guessing a spec from recordings of an unknown protocol: what varies how, and what that may mean.

1. A guess has its evidence in words and a confidence between 0 and 1; what is not known is said to be bytes.
2. Recordings are untrusted: work and memory are bounded by samples, whatever the recording holds.
3. No I/O: the caller opens the recording (`aces_bus.recordings.open_recording`).
"""

from __future__ import annotations

from .carried import CarriedGuess
from .checks import CheckGuess, checks_of, checks_of_packets
from .draft import draft_source
from .draft_stream import stream_source
from .fields import FieldGuess, FieldKind, fields_of
from .framings import FramingGuess, LengthRule
from .nodes import NodeGuess
from .pairs import PairGuess
from .protocols import ProtocolGuess
from .reference import MeasuredQuantity, ReferenceGuess, ReferenceGuesses
from .reference_file import read_quantity
from .streams import PacketGuess, StreamGuess, StreamTraffic
from .traffic import MessageGuess, TimingGuess, Traffic, TrafficGuess

__all__ = [
    "CarriedGuess",
    "CheckGuess",
    "FieldGuess",
    "FieldKind",
    "FramingGuess",
    "LengthRule",
    "MeasuredQuantity",
    "MessageGuess",
    "NodeGuess",
    "PacketGuess",
    "PairGuess",
    "ProtocolGuess",
    "ReferenceGuess",
    "ReferenceGuesses",
    "StreamGuess",
    "StreamTraffic",
    "TimingGuess",
    "Traffic",
    "TrafficGuess",
    "checks_of",
    "checks_of_packets",
    "draft_source",
    "fields_of",
    "read_quantity",
    "stream_source",
]
