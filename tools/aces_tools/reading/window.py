"""`--from` and `--to`: a piece of a recording by time.

1. From the first instant on, up to and without the last: windows that touch share nothing.
2. Instants are compared as integer nanoseconds, as the digits of the recording and of the option say.

A time below 1e8 counts in seconds from the first frame of each file that has a time; a larger one is absolute, in seconds
since 1970. `2026-11-22T14:05:00` is an instant, local unless it says its zone; `14:05` is that local time of the day of the
first frame, or of the next day where a recording runs past midnight.
"""

from __future__ import annotations

import datetime
from decimal import Decimal, InvalidOperation
from typing import Any

import msgspec

from aces_bus.errors import CallerError
from aces_bus.frame_table import NO_TIME

#: Seconds from which on a time is absolute: 3 March 1973.
ABSOLUTE_S = 10**8


class TimeWindow(msgspec.Struct):
    """The piece that is wanted; `start` and `stop` in ns or as a time of day, None open."""

    start: int | datetime.time | None
    stop: int | datetime.time | None
    #: Instead of `stop`: it ends so long after its start.
    lasting_ns: int | None = None
    #: Items without a time, which are never inside.
    untimed: int = 0
    _first: int | None = None

    @classmethod
    def parse(
        cls, start: str | None, stop: str | None, names: tuple[str, str] = ("--from", "--to")
    ) -> TimeWindow | None:
        """Return the window of two texts, None when neither is given. `names` are what the caller calls them.

        Raises `CallerError` for what is not a time, and for an end that is not later than its start.
        """
        if start is None and stop is None:
            return None
        window = cls(_ns(names[0], start), _ns(names[1], stop))
        if (
            isinstance(window.start, int)
            and isinstance(window.stop, int)
            and window.stop <= window.start
            and _is_absolute(window.start) == _is_absolute(window.stop)
        ):
            raise CallerError(f"{names[1]} {stop} is not later than {names[0]} {start}")
        return window

    @property
    def first(self) -> int | None:
        """The first instant of the file, once one has come."""
        return self._first

    @property
    def bounds(self) -> tuple[int | None, int | None]:
        """Start and stop as instants (ns), as soon as the first one of the file is known; None is open."""
        start, stop = self._bound(self.start), self._bound(self.stop)
        return start, start + self.lasting_ns if self.lasting_ns is not None and start is not None else stop

    def begin(self) -> None:
        """Begin another file, with a first frame of its own."""
        self._first = None

    def inside(self, time: Any) -> Any:
        """Return which instants of an array (int64, ns) are inside: a boolean array."""
        known = time != NO_TIME
        if self._first is None and known.any():
            self._first = int(time[known][0])
        kept = known
        start, stop = self.bounds
        if start is not None:
            kept = kept & (time >= start)
        if stop is not None:
            kept = kept & (time < stop)
        self.untimed += int((~known).sum())
        return kept

    def see(self, time: int) -> None:
        """Note an instant, which may be the first of its file."""
        if self._first is None and time != NO_TIME:
            self._first = time

    def _bound(self, given: int | datetime.time | None) -> int | None:
        if isinstance(given, datetime.time):
            return None if self._first is None else _of_the_day(given, self._first)
        return given if given is None or _is_absolute(given) or self._first is None else self._first + given


def _of_the_day(clock: datetime.time, first_ns: int) -> int:
    """Return the instant (ns) of a local time of day that belongs to a recording's first one."""
    day = datetime.datetime.fromtimestamp(first_ns / 1e9).date()
    instant = datetime.datetime.combine(day, clock)
    if first_ns - _instant_ns(instant) > 12 * 3600 * 10**9:
        instant += datetime.timedelta(days=1)
    return _instant_ns(instant)


def _instant_ns(instant: datetime.datetime) -> int:
    whole = instant.replace(microsecond=0)
    return round(whole.timestamp()) * 10**9 + instant.microsecond * 1000


def _is_absolute(ns: int) -> bool:
    return ns >= ABSOLUTE_S * 10**9


def _ns(name: str, text: str | None) -> int | datetime.time | None:
    if text is None:
        return None
    try:
        number = Decimal(text)
        if not number.is_finite() or not 0 <= number < 9_000_000_000:
            raise InvalidOperation
    except InvalidOperation:
        for parse in (datetime.time.fromisoformat, datetime.datetime.fromisoformat):
            try:
                found = parse(text) if ":" in text else None
            except ValueError:
                continue
            if isinstance(found, datetime.datetime):
                return _instant_ns(found)
            if found is not None and found.tzinfo is None:
                return found
        raise CallerError(
            f"{name} {text!r} is not a time; write seconds from the first frame (12.5) or since 1970 (1436509052.25),"
            " 14:05:30, or 2026-11-22T14:05:30"
        ) from None
    return int(number.scaleb(9))
