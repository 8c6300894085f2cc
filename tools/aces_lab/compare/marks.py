"""Marks in a text file: when something was done while a bus was recorded.

    # what I did
    12.3        pressed          from then on, until the next line (or for as long as is asked for)
    14.0        released
    20.5..22.1  pressed          a range of its own
    14:05:30    pressed          clock times, as --from takes them

1. Times are those of `aces_tools.reading.window`: seconds from the recording's first frame, since 1970, or by the clock.
2. Marks of one name are one thing done several times. A line that is not a mark is refused, with its number.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from fnmatch import fnmatchcase

from aces_bus.errors import CallerError
from aces_tools.reading.window import TimeWindow

_RANGE = re.compile(r"(?P<start>.*?)\.\.(?P<stop>.*)")
#: Marks of a file.
MOST_MARKS = 1000


@dataclass(frozen=True)
class TimeMark:
    """A time with a name; `start` and `stop` as they were written, `stop` None where the next mark ends it."""

    name: str
    start: str
    stop: str | None = None
    line: int = 0


def parse_window(text: str, what: str) -> TimeWindow:
    """Parse `START..STOP`, either of which may be empty; `what` names it in messages. Raises `CallerError`."""
    found = _RANGE.fullmatch(text.strip())
    if found is None or not (found["start"] or found["stop"]):
        raise CallerError(
            f"{what} {text!r} is not a range of time; write START..STOP, such as 10..20, 10.. or 14:05..14:06"
        )
    window = TimeWindow.parse(found["start"] or None, found["stop"] or None, (what, "its end"))
    assert window is not None
    return window


def parse_marks(text: str, name: str = "marks") -> list[TimeMark]:
    """Return the marks of a text, in its order; `name` says in messages where it is from. Raises `CallerError`.

    >>> [mark.name for mark in parse_marks("1.5 pressed\\n2..3 held down\\n")]
    ['pressed', 'held down']
    """
    marks: list[TimeMark] = []
    for number, line in enumerate(text.splitlines(), 1):
        line = line.partition("#")[0].strip()
        if not line:
            continue
        time, _, label = line.partition(" ") if "\t" not in line else line.partition("\t")
        where = f"{name}:{number}: mark"
        found = _RANGE.fullmatch(time)
        if found is not None:
            parse_window(time, where)
            mark = TimeMark(label.strip() or "mark", found["start"], found["stop"], number)
        else:
            TimeWindow.parse(time, None, (where, where))
            mark = TimeMark(label.strip() or "mark", time, None, number)
        marks.append(mark)
        if len(marks) > MOST_MARKS:
            raise CallerError(f"{name}: more than {MOST_MARKS} marks")
    if not marks:
        raise CallerError(f"{name}: no marks; a line reads '12.3 pressed' or '12.3..14 pressed'")
    return marks


def windows_of(marks: Iterable[TimeMark], wanted: str, lasting_ns: int | None = None) -> list[TimeWindow]:
    """Return the windows of the marks whose name is `wanted` (in any case, with * and ?), none where there are none.

    A mark with one time lasts `lasting_ns`, or until the next line's time.
    """
    marks = list(marks)
    found: list[TimeWindow] = []
    for place, mark in enumerate(marks):
        if not fnmatchcase(mark.name.lower(), wanted.lower()):
            continue
        where = f"line {mark.line} of the marks:"
        stop = mark.stop
        if stop is None and lasting_ns is None and place + 1 < len(marks):
            stop = marks[place + 1].start
        window = TimeWindow.parse(mark.start or None, stop or None, (where, "the mark's end"))
        if window is None:
            continue
        window.lasting_ns = lasting_ns if mark.stop is None else None
        found.append(window)
    return found
