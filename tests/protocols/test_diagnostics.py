"""obd2 and uds: values by name, trouble codes as text, refusals, requests to all."""

from __future__ import annotations

from typing import Any

import pytest

from aces_bus import Frame, Unknown, make_scanner
from aces_bus.errors import FieldError
from aces_protocols.obd2.spec import obd2
from aces_protocols.uds.spec import uds


def reads(protocol: Any, key: int, *data: str) -> Any:
    """The one record of some frames."""
    frames = [Frame(key, bytes.fromhex(one)) for one in data]
    (record,) = protocol.scanner(include_unknown=True).feed(frames)
    return record


def test_live_values_have_names_and_units_in_any_order() -> None:
    """An answer of several PIDs over two frames, filled up with anything."""
    record = reads(obd2, 0x7E8, "10 0A 41 0C 1A F8 0D 32", "21 05 7B 04 80 AA AA AA")
    assert [(one.kind, one.data) for one in record.values] == [
        ("engine_speed", 1726), ("vehicle_speed", 50), ("coolant_temperature", 83),
        ("engine_load", pytest.approx(50.2, abs=0.01)),
    ]  # fmt: skip


def test_an_unknown_pid_ends_what_is_known() -> None:
    """The values before it are read; it and the rest are bytes with a reason."""
    record = reads(obd2, 0x7E8, "07 41 0D 32 A6 01 02 03")
    assert [(one.kind, one.data, one.reason) for one in record.values] == [
        ("vehicle_speed", 50, None), (0xA6, b"\1\2\3", "unknown"),
    ]  # fmt: skip


def test_masks_name_what_is_supported() -> None:
    """BE 1F A8 13 are PIDs 01, 03 to 07, 0C to 11, 13, 15, 1C and 1F, and the next mask."""
    (mask,) = reads(obd2, 0x7E8, "06 41 00 BE 1F A8 13 00").values
    assert mask.kind == "supported_01"
    assert {"engine_speed", "air_flow", "pid_03", "run_time", "more"} <= set(mask.data)
    assert "fuel_pressure" not in mask.data
    assert len(list(mask.data)) == 17


@pytest.mark.parametrize(
    ("code", "data"), [("P0301", "03 01"), ("C1234", "52 34"), ("B0A1F", "8A 1F"), ("U3FFF", "FF FF")]
)
def test_trouble_codes_are_text_both_ways(code: str, data: str) -> None:
    """The letter is in the two highest bits (SAE J2012)."""
    assert reads(obd2, 0x7EA, f"04 47 01 {data}").codes == (code,)
    (frame,) = obd2.encode("PendingCodes", ecu=2, codes=[code])
    assert frame.data[:5].hex(" ").upper() == f"04 47 01 {data}"


@pytest.mark.parametrize("code", ["P4301", "X0301", "P030", "P0301-11", 301])
def test_what_is_no_code_is_refused(code: object) -> None:
    """The error has an example of one."""
    with pytest.raises(FieldError, match="not a trouble code such as P0301"):
        obd2.encode("StoredCodes", ecu=0, codes=[code])


def test_requests_to_all_are_messages_of_their_own() -> None:
    """0x7DF names no ECU; a request that is longer than a single frame cannot go there."""
    (frame,) = uds.encode("TesterPresentAll", none=0, suppress=1)
    assert (frame.arbitration_id, frame.data[:3]) == (0x7DF, b"\x02\x3e\x80")
    with pytest.raises(FieldError):
        uds.encode("WriteDataAll", identifier=1, data=bytes(20))


def test_several_identifiers_in_one_answer() -> None:
    """Values of fixed form are read one behind the other: session, engine speed (0xF40C)."""
    record = reads(uds, 0x7E9, "10 08 62 F1 86 03 F4 0C", "21 1A F8 00 00 00 00 00")
    assert [(one.kind, one.data) for one in record.values] == [
        ("session", "extended"),
        ("engine_speed", 1726),
    ]


def test_both_on_one_wire() -> None:
    """One scanner reads both: packets of the same identifiers, told apart by their service."""
    frames = [
        *obd2.encode("ReadInfo", ecu=0, what="vin"),
        *obd2.encode("Vin", ecu=0, vin="1D4GP00R55B123456"),
        *uds.encode("ReadData", ecu=0, identifiers=[0xF190]),
        *uds.encode("Data", ecu=0, values=[{"kind": "vin", "data": "1D4GP00R55B123456"}]),
        *uds.encode("Refused", ecu=0, service="security", reason="invalid_key"),
    ]
    for order in ((obd2, uds), (uds, obd2)):
        scanner = make_scanner([one.variant() for one in order], include_unknown=True)
        records = scanner.feed(frames)
        assert not any(isinstance(one, Unknown) for one in records)
        names = [type(one).__name__ for one in records]
        assert names == ["ReadInfo", "Vin", "ReadData", "Data", "Refused"]
        assert records[-1].reason == "invalid_key"
