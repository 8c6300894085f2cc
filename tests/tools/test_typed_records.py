"""What a type checker knows of records through the stubs; `make check` reads this file, the tests run it."""

from __future__ import annotations

from typing import TYPE_CHECKING, assert_type

from aces_bus.protocol import Record
from aces_protocols.robotis.records import Read, Status, robotis


def described(record: Record) -> str:
    """Each `assert_type` fails in mypy and pyright when the stub is less exact."""
    match record:
        case Status(id=servo, error=error, parameters=parameters):
            assert_type(servo, int)
            assert_type(error.overload, bool)
            assert_type(parameters, bytes)
            return f"{servo}: {'overload' if error.overload else parameters.hex()}"
        case Read():
            assert_type(record.start, int)
            # A misspelt field is an error: without one, checkers would say that this comment is not needed.
            if TYPE_CHECKING:
                print(record.strat)  # type: ignore[attr-defined]  # pyright: ignore[reportAttributeAccessIssue]
            return f"{record.id} reads {record.count} from {record.start:#x}"
        case _:
            return "?"


def test_records_are_matched_by_their_types() -> None:
    """The types of `records` are those of the scanner's records."""
    packets = (
        robotis.encode("Read", id=1, start=0x24, count=2),
        robotis.encode("Status", id=1, error=["overload"], parameters=b""),
    )
    scanner = robotis.scanner(direction="both")
    assert [described(record) for record in scanner.feed(b"".join(packets))] == [
        "1 reads 2 from 0x24",
        "1: overload",
    ]
