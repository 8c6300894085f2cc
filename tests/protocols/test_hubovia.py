"""The spec of HuboVia, against the sheet's worked examples."""

from __future__ import annotations

import pytest

from aces_bus import Unknown
from aces_bus.errors import FieldError
from aces_bus.protocol.live.stream import StreamScanner
from aces_protocols.hubovia.records import Joint
from aces_protocols.hubovia.spec import hubovia

#: Datagram; motor, sign, whole degrees, hundredths: the three of the facts.
WORKED = [
    ("FF 41 01 23 80 57 49 43", 35, 1, 87, 0.73),
    ("FF 41 01 1E 00 2D 32 7D", 30, 0, 45, 0.5),
    ("FF 41 01 1E 01 2C 19 64", 30, 0, 300, 0.25),
]


def _scanner() -> StreamScanner:
    scanner = hubovia.scanner(include_unknown=True)
    assert isinstance(scanner, StreamScanner)
    return scanner


@pytest.mark.parametrize(("text", "motor", "negative", "degrees", "hundredths"), WORKED)
def test_worked_examples(text: str, motor: int, negative: int, degrees: int, hundredths: float) -> None:
    """Each is read and written as printed."""
    data = bytes.fromhex(text)
    (record,) = hubovia.scanner().feed(data)
    assert isinstance(record, Joint)
    assert (record.motor, record.angle.negative, record.angle.degrees) == (motor, negative, degrees)
    assert record.angle.hundredths == pytest.approx(hundredths)
    angle = {"negative": negative, "degrees": degrees, "hundredths": hundredths}
    assert hubovia.encode("Joint", motor=motor, angle=angle) == data


def test_a_wrong_sum_is_malformed() -> None:
    """The check covers motor, degrees and hundredths; a datagram that fails it costs one byte, the next is read."""
    good = bytes.fromhex(WORKED[0][0])
    for place in range(3, 8):
        bad = bytearray(good)
        bad[place] ^= 0x10
        scanner = _scanner()
        found = [*scanner.datagram(bytes(bad)), *scanner.datagram(good)]
        assert [isinstance(one, Joint) for one in found if not isinstance(one, Unknown)] == [True]
        assert scanner.counts.reasons == {"malformed: checksum": 1, "skipped": 7}


def test_a_cut_datagram_is_not_continued() -> None:
    """What one datagram leaves out, the next does not bring."""
    good = bytes.fromhex(WORKED[1][0])
    scanner = _scanner()
    assert [isinstance(one, Joint) for one in scanner.datagram(good[:5])] == [False, False]
    assert [isinstance(one, Joint) for one in scanner.datagram(good)] == [True]
    assert scanner.counts.reasons == {"malformed: incomplete": 1, "skipped": 4}


def test_several_motors_are_not_known() -> None:
    """The number of motors is always 1; another is none of its messages, even with the sum of one."""
    data = bytes.fromhex("FF 41 02 23 80 57 49 43")
    scanner = _scanner()
    assert [one.reason for one in scanner.datagram(data)] == ["unknown"]
    assert scanner.counts.unknown == len(data)


@pytest.mark.parametrize("angle", [{"degrees": 32768}, {"hundredths": 1.0}, {"hundredths": -0.01}])
def test_what_does_not_fit_is_refused(angle: dict[str, float]) -> None:
    """Degrees have 15 bits; a hundred hundredths are a degree."""
    whole = {"negative": 0, "degrees": 0, "hundredths": 0, **angle}
    with pytest.raises(FieldError, match=r"degrees|hundredths"):
        hubovia.encode("Joint", motor=0, angle=whole)
