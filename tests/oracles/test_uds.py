"""can-isotp and udsoncan, unmodified, with our twins of ECUs on a served bus; udsoncan's messages by our spec."""

from __future__ import annotations

from collections.abc import Generator
from contextlib import contextmanager
from typing import Any

import can
import pytest

from aces_bus import Frame
from aces_devices.obd2 import driver
from aces_devices.obd2.twin import Obd2Twin
from aces_devices.uds.twin import UdsTwin
from aces_protocols.obd2.spec import obd2
from aces_protocols.uds.spec import uds
from tests.oracles.foreign import oracle
from tests.oracles.served import PATIENCE_S, ServedTwins, served

isotp: Any = oracle("isotp", "can-isotp")
udsoncan: Any = oracle("udsoncan", "udsoncan")
services: Any = oracle("udsoncan.services", "udsoncan")


def frames_of(packet: bytes, key: int = 0x7E0) -> list[Frame]:
    """A short packet in its frame, as can-isotp sends it."""
    return [Frame(key, bytes((len(packet),)) + packet)]


def test_can_isotp_reads_our_ecu() -> None:
    """Values, codes and the number (with flow control, two frames at a time) are what the twin says."""
    with served(driver.example) as ecu, can.Bus(channel=ecu.channel, interface="aces") as bus:
        twin = ecu.twins["ENGINE"]
        assert isinstance(twin, Obd2Twin)
        address = isotp.Address(isotp.AddressingMode.Normal_11bits, txid=0x7E0, rxid=0x7E8)
        params = {"stmin": 0, "blocksize": 2, "tx_padding": 0xAA}
        stack = isotp.CanStack(bus, address=address, params=params)
        stack.start()
        try:

            def asked(*data: int) -> bytes:
                stack.send(bytes(data))
                return bytes(stack.recv(block=True, timeout=PATIENCE_S))

            assert asked(0x01, 0x0C, 0x0D, 0x05) == bytes.fromhex("41 0C 1A F8 0D 32 05 7B")
            assert asked(0x03) == bytes.fromhex("43 01 03 01")
            assert asked(0x09, 0x02) == b"\x49\x02\x01" + twin.ecu.vin.encode()
        finally:
            stack.stop()
        scanner = obd2.scanner(include_unknown=True)
        records = scanner.feed([Frame(m.arbitration_id, bytes(m.data)) for m in ecu.frames()])
    assert [type(one).__name__ for one in records if type(one).__name__ != "Unknown"] == [
        "ReadLive", "Live", "ReadStoredCodes", "StoredCodes", "ReadInfo", "Vin",
    ]  # fmt: skip
    counts = scanner.counts
    assert counts.decoded + counts.control == counts.total
    assert records[0].pids == (0x0C, 0x0D, 0x05)


REQUESTS: list[tuple[str, Any, dict[str, Any]]] = [
    ("ChangeSession", lambda: services.DiagnosticSessionControl.make_request(3), {"session": "extended", "suppress": 0}),
    ("Reset", lambda: services.ECUReset.make_request(1), {"kind": "hard"}),
    ("ClearCodes", lambda: services.ClearDiagnosticInformation.make_request(0xFFFFFF), {"group": 0xFFFFFF}),
    ("TesterPresent", lambda: services.TesterPresent.make_request(), {"none": 0}),
    ("ReadData", lambda: services.ReadDataByIdentifier.make_request([0xF190, 0xF186], {"default": "B"}),
        {"identifiers": (0xF190, 0xF186)}),
    ("WriteData", lambda: services.WriteDataByIdentifier.make_request(0x123, 0x5A, {0x123: "B"}),
        {"identifier": 0x123, "data": b"\x5a"}),
    ("AccessSecurity", lambda: services.SecurityAccess.make_request(1, services.SecurityAccess.Mode.SendKey, b"\xa5\x5a"),
        {"step": 2, "data": b"\xa5\x5a"}),
    ("ReadCodes", lambda: services.ReadDTCInformation.make_request(2, status_mask=8), {"status": 8}),
    ("CountCodes", lambda: services.ReadDTCInformation.make_request(1, status_mask=8), {"status": 8}),
    ("ReadKnownCodes", lambda: services.ReadDTCInformation.make_request(10), {}),
    ("ControlRoutine", lambda: services.RoutineControl.make_request(0x201, 1, b"\xa5\x5a"),
        {"action": "start", "routine": 0x201, "data": b"\xa5\x5a"}),
    ("BeginDownload", lambda: services.RequestDownload.make_request(
        udsoncan.MemoryLocation(0x60, 0xF0, address_format=8, memorysize_format=16)),
        {"method": 0, "widths": 0x21, "address": 0x60, "size": 0xF0}),
    ("TransferData", lambda: services.TransferData.make_request(1, b"\xde\xad"), {"number": 1, "data": b"\xde\xad"}),
    ("EndTransfer", lambda: services.RequestTransferExit.make_request(), {"data": b""}),
    ("Other", lambda: services.ControlDTCSetting.make_request(2), {"service": "control_code_setting", "data": b"\2"}),
]  # fmt: skip


@pytest.mark.parametrize(("name", "made", "fields"), REQUESTS, ids=[one[0] for one in REQUESTS])
def test_what_udsoncan_asks_we_read(name: str, made: Any, fields: dict[str, Any]) -> None:
    """Each request has its message and its values; with its suppress bit, too, where it may have one."""
    request = made()
    (record,) = uds.scanner(include_unknown=True).feed(frames_of(request.get_payload()))
    assert type(record).__name__ == name
    assert {one: getattr(record, one) for one in fields} == fields
    if hasattr(record, "suppress"):
        quiet = request.get_payload(suppress_positive_response=True)
        (record,) = uds.scanner(include_unknown=True).feed(frames_of(quiet))
        assert (type(record).__name__, record.suppress) == (name, 1)


def test_what_we_answer_udsoncan_reads() -> None:
    """Sessions, codes with their status, seeds, values."""
    session = parsed(
        services.DiagnosticSessionControl, "Session", session="extended", answers_within=0.05, patience=5.0
    )
    assert (session.session_echo, session.p2_server_max, session.p2_star_server_max) == (3, 0.05, 5.0)
    seed = parsed(
        services.SecurityAccess,
        "Security",
        step=1,
        data=b"\x36\x57",
        mode=services.SecurityAccess.Mode.RequestSeed,
    )
    assert (seed.security_level_echo, bytes(seed.seed)) == (1, b"\x36\x57")
    codes = parsed(
        services.ReadDTCInformation,
        "Codes",
        available=0xFF,
        codes=[{"code": "P0301-11", "status": ["failed", "confirmed"]}],
        subfunction=2,
    )
    (code,) = codes.dtcs
    assert code.id == 0x030111
    assert (code.status.test_failed, code.status.confirmed, code.status.pending) == (True, True, False)


def parsed(service: Any, message: str, **fields: Any) -> Any:
    """What udsoncan reads in a packet of ours; `subfunction` and `mode` are its own arguments."""
    mine = {name: fields.pop(name) for name in ("subfunction", "mode") if name in fields}
    (record,) = uds.scanner().feed(uds.encode(message, ecu=0, **fields))
    response = udsoncan.Response.from_payload(record.meta.raw)
    assert response.valid
    service.interpret_response(response, **mine)
    return response.service_data


def test_refusals_have_the_same_reasons() -> None:
    """Every code that udsoncan names we name, for each service; its name of the service is the one we mean."""
    numbers = {v: n for n, v in vars(udsoncan.ResponseCode).items() if n[0].isupper() and isinstance(v, int)}
    unnamed = []
    for number in numbers:
        (record,) = uds.scanner().feed(frames_of(bytes((0x7F, 0x22, number)), 0x7E8))
        response = udsoncan.Response.from_payload(record.meta.raw)
        assert (record.service, response.code) == ("read_data", number)
        if number and not isinstance(record.reason, str):
            unnamed.append(numbers[number])
    assert unnamed == []


ENGINE = """
name = "car"
rate_hz = 20
[buses]
can = { link = "can", protocol = "uds", bitrate = 500_000 }
[devices.ENGINE]
driver = "uds"
bus = "can"
credentials = { ecu = 0 }
[devices.ENGINE.settings]
level = 1
routines = { learn = 0x0201 }
[devices.ENGINE.settings.identifiers]
limit = { identifier = 0x0110, type = "u16", access = "read-write", unit = "rpm", scale = 0.25, upper = 8000 }
name = { identifier = 0x0111, type = "text", count = 30, access = "read-write" }
"""


@contextmanager
def a_tester(key: Any = None) -> Generator[tuple[Any, Any, ServedTwins]]:
    """udsoncan's client at a served bus, and the twin that it talks to."""
    from udsoncan.client import Client
    from udsoncan.connections import PythonIsoTpConnection

    config: Any = {
        **udsoncan.configs.default_client_config,
        "request_timeout": PATIENCE_S,
        "p2_timeout": PATIENCE_S,
        "p2_star_timeout": PATIENCE_S,
        "use_server_timing": False,
        "data_identifiers": {0x0110: ">H", 0x0111: udsoncan.AsciiCodec(30), 0xF190: udsoncan.AsciiCodec(17)},
        "security_algo": key,
    }
    with served(ENGINE) as ecu, can.Bus(channel=ecu.channel, interface="aces") as bus:
        twin = ecu.twins["ENGINE"]
        assert isinstance(twin, UdsTwin)
        address = isotp.Address(isotp.AddressingMode.Normal_11bits, txid=0x7E0, rxid=0x7E8)
        stack = isotp.CanStack(bus, address=address, params={"stmin": 0, "blocksize": 4, "tx_padding": 0xAA})
        with Client(PythonIsoTpConnection(stack), config=config) as client:
            yield client, twin, ecu


def refused(ask: Any, *args: Any) -> str:
    """How udsoncan names the refusal of a request."""
    with pytest.raises(udsoncan.exceptions.NegativeResponseException) as found:
        ask(*args)
    return str(found.value.response.code_name)


def test_udsoncan_works_with_our_twin() -> None:
    """Sessions, seed and key, values of several frames, codes, routines, a download, a reset; and all refusals by name."""
    with a_tester(lambda level, seed, params: bytes(byte ^ 0xFF for byte in seed)) as (client, twin, ecu):
        values = client.read_data_by_identifier([0xF190, 0x0110]).service_data.values
        assert (values[0xF190], values[0x0110]) == (twin.ecu.vin, (0,))
        assert refused(client.write_data_by_identifier, 0x0110, (1,)) == "ServiceNotSupportedInActiveSession"
        assert refused(client.transfer_data, 1, b"1") == "ServiceNotSupportedInActiveSession"
        assert refused(client.control_dtc_setting, 1) == "ServiceNotSupported"
        timing = client.change_session(3).service_data
        assert (timing.p2_server_max, timing.p2_star_server_max) == (0.05, 5.0)
        assert refused(client.write_data_by_identifier, 0x0110, (1,)) == "SecurityAccessDenied"
        assert client.unlock_security_access(1).positive
        assert refused(client.write_data_by_identifier, 0x0110, (32_001,)) == "RequestOutOfRange"
        assert client.write_data_by_identifier(0x0110, (4000,)).positive
        assert client.write_data_by_identifier(0x0111, "a text that takes some frames.").positive
        assert ecu.call(lambda: (twin.take("limit"), twin.take("name"))) == (
            1000.0,
            "a text that takes some frames.",
        )

        codes = {
            one.id: one.status.get_byte_as_int()
            for one in client.get_dtc_by_status_mask(0xFF).service_data.dtcs
        }
        assert codes == {0x030100: 0b1101, 0x042000: 0b0100}
        assert client.get_number_of_dtc_by_status_mask(0x08).service_data.dtc_count == 1
        assert refused(client.get_dtc_fault_counter) == "SubFunctionNotSupported"
        assert client.clear_dtc().positive
        assert client.get_supported_dtc().service_data.dtc_count == 0

        assert refused(client.get_routine_result, 0x0201) == "RequestSequenceError"
        assert client.start_routine(0x0201, b"\xa5").service_data.routine_id_echo == 0x0201
        assert client.stop_routine(0x0201).positive
        assert refused(client.start_routine, 0x0202) == "RequestOutOfRange"

        data = bytes(range(256)) * 5
        client.change_session(2)
        client.unlock_security_access(1)
        place = udsoncan.MemoryLocation(0x200, len(data), address_format=16, memorysize_format=16)
        size = client.request_download(place).service_data.max_length - 2
        assert refused(client.transfer_data, 2, b"1") == "WrongBlockSequenceCounter"
        for number, at in enumerate(range(0, len(data), size), 1):
            client.transfer_data(number, data[at : at + size])
        assert client.request_transfer_exit().positive
        assert ecu.call(lambda: bytes(twin.memory[0x200 : 0x200 + len(data)])) == data

        with client.suppress_positive_response():
            client.tester_present()
        assert ecu.call(lambda: twin.session) == "programming"
        assert client.ecu_reset(1).positive
        scanner = uds.scanner()
        names = [
            type(one).__name__
            for one in scanner.feed([Frame(m.arbitration_id, bytes(m.data)) for m in ecu.frames()])
        ]
    assert (names[:2], names[-2:]) == (["ReadData", "Data"], ["Reset", "ResetBegins"])
    assert scanner.counts.decoded + scanner.counts.control == scanner.counts.total


def test_udsoncan_has_patience_with_our_twin() -> None:
    """A twin that asks for patience is waited for; the value comes."""
    with a_tester() as (client, twin, ecu):
        heard: list[Any] = []
        client.set_config("nrc78_callback", lambda: heard.append(1))
        ecu.call(lambda: twin.fault("pending", 0.2))
        assert client.read_data_by_identifier(0xF190).service_data.values[0xF190] == twin.ecu.vin
        assert len(heard) == 1


def test_a_wrong_key_is_udsoncans_too() -> None:
    """The client is told so by name, and after the third one that it has to wait."""
    with a_tester(lambda level, seed, params: bytes(4)) as (client, _, _):
        client.change_session(3)
        assert refused(client.unlock_security_access, 1) == "InvalidKey"
        assert refused(client.unlock_security_access, 1) == "InvalidKey"
        assert refused(client.unlock_security_access, 1) == "ExceedNumberOfAttempts"
        assert refused(client.unlock_security_access, 1) == "RequiredTimeDelayNotExpired"
