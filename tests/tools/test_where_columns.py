"""`--where` on columns keeps exactly the rows whose records it keeps one by one."""

from __future__ import annotations

import datetime
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from aces_bus import FrameTable, Unknown, make_column_scanner, make_scanner
from aces_bus.errors import CallerError
from aces_bus.testing import strategies
from aces_tools.output.shape import plans_of
from aces_tools.reading.where import Where, WhereColumns
from aces_tools.reading.window import TimeWindow
from tests.specs.catalogue import SPECS

META = ("time", "channel", "direction", "identifier", "extended", "fd", "remote", "is_rx", "offset", "size")


def path_of(draw: Any, name: str) -> str:
    """A column's path, with some of its numbers left out."""
    parts = [part for part in name.split(".") if not part.isdecimal() or draw(st.booleans())]
    return ".".join(parts)


@pytest.mark.slow
@settings(max_examples=40)
@given(data=st.data())
def test_rows_are_kept_as_records_are(data: st.DataObject) -> None:
    """For any wire, field, sign and value."""
    draw: Any = data.draw
    protocol = draw(st.sampled_from(sorted(SPECS.values(), key=lambda one: one.name)))
    variant = draw(st.sampled_from(protocol.variants()))
    direction: Any = "from device" if variant.direction_conflict else None
    traffic = draw(strategies.scenes(variant, direction, size=200)).traffic
    is_can = variant.link == "can"
    live: Any = make_scanner([variant], direction=direction, include_unknown=True)
    records = [one for one in [*live.feed(traffic), *live.close()] if type(one) is not Unknown]
    scanner = make_column_scanner([variant], direction=direction)
    tables = [*scanner.feed(FrameTable.from_frames(traffic) if is_can else traffic), *scanner.close()]
    plans = plans_of([variant])
    values: list[str] = ["none", "", "nan", "0", "1", "0x10", "-1", "0.5", "true", "00", "1e300", "to", "inf"]
    if tables and draw(st.booleans()):
        table = draw(st.sampled_from(tables))
        column = next(iter(table.columns()), None)
        if column is None:
            return
        column = draw(st.sampled_from(list(table.columns())))
        path = path_of(draw, column.name)
        shown = column.to_list()[:5]
        values += [one.hex() if isinstance(one, bytes) else str(one) for one in shown]
        values += [*(column.kind.names or {}).values(), *(column.kind.flags or {})]
    else:
        path = f"meta.{draw(st.sampled_from(META))}"
    values += ["-1..1", "0..1e300", "0,1", "none,0..0.5"]

    def one_condition() -> str:
        return (
            f"{path}{draw(st.sampled_from(['=', '!=', '<', '>', '<=', '>=']))}{draw(st.sampled_from(values))}"
        )

    text = one_condition()
    if draw(st.booleans()):
        text = f"{text} {draw(st.sampled_from(['and', 'or']))} {one_condition()}"
    try:
        one_by_one = Where([text], plans)
    except CallerError:
        with pytest.raises(CallerError):
            WhereColumns([text], plans)
        return
    wanted: dict[str, list[bool]] = {}
    for record in records:
        wanted.setdefault(type(record).__name__, []).append(one_by_one.holds(record))
    columns = WhereColumns([text], plans)
    found: dict[str, list[bool]] = {}
    for table in tables:
        found.setdefault(table.message, []).extend(columns.holds(table).tolist())
    assert found == wanted, text


def test_windows() -> None:
    """Without the last instant, relative to the first time that is known, or absolute."""
    none = -(1 << 63)
    times = np.array([none, 10, 11, 12, 13], np.int64) * 1
    times[1:] = times[1:] * 10**9
    window = TimeWindow.parse("1", "3")
    assert window is not None
    assert window.inside(times).tolist() == [False, False, True, True, False]
    assert window.untimed == 1
    window.begin()
    assert window.inside(times[3:]).tolist() == [False, True]
    absolute = TimeWindow.parse("100000011", None)
    assert absolute is not None
    assert absolute.inside(times + 10**17).tolist()[1:] == [False, True, True, True]
    assert TimeWindow.parse(None, None) is None


def test_windows_by_the_clock() -> None:
    """A time of day is that of the first frame's day, or of the next one past midnight; an instant may say its zone."""
    first = datetime.datetime(2026, 11, 22, 23, 50)
    times = np.array([first.timestamp() + 60 * minute for minute in (0, 15, 25)], np.float64) * 1e9
    instants = times.astype(np.int64)
    for start, stop, wanted in [
        ("23:00", "00:10", [True, True, False]),
        ("00:00:30", None, [False, True, True]),
        ("2026-11-23T00:10", None, [False, False, True]),
        (None, "2026-11-22 23:59:59.5", [True, False, False]),
    ]:
        window = TimeWindow.parse(start, stop)
        assert window is not None
        assert window.inside(instants).tolist() == wanted, (start, stop)
    zone = TimeWindow.parse("2001-09-09T01:46:41Z", None)
    assert zone is not None
    assert zone.start == 1_000_000_001 * 10**9
    for text in ("12:61", "noon", "12:00+01:00", "2026-13-01T00:00"):
        with pytest.raises(CallerError, match="is not a time"):
            TimeWindow.parse(text, None)
