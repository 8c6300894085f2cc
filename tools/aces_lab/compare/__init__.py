"""What differs between two recordings, or between two times of one: identifiers, periods, lengths, bits, values, signals.

1. Each side is a profile of bounded size: how often, how long, which values, when a bit was seen set and when clear.
   Frames are counted as columns; none is kept.
2. A change says how telling it is, from 0 to 1: how sure it is not an accident of having looked at another time.
3. No protocol is needed; with one its signals are compared as well.
"""

from __future__ import annotations

from .changes import TrafficChange
from .comparer import RecordingComparison, compare_recordings
from .marks import TimeMark, parse_marks

__all__ = [
    "RecordingComparison",
    "TimeMark",
    "TrafficChange",
    "compare_recordings",
    "parse_marks",
]
