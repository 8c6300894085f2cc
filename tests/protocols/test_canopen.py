"""The spec of CANopen, against the facts' frames and against what the canopen library sends and reads."""

from __future__ import annotations

import logging
from typing import Any

import pytest

from aces_bus import Frame, as_dict
from aces_bus.errors import FieldError
from aces_protocols.canopen.records import Emergency, Heartbeat, SdoAborted, SdoUpload, Sync, Tpdo1
from aces_protocols.canopen.spec import canopen


def _frame(text: str) -> Frame:
    identifier, _, data = text.partition("#")
    return Frame(int(identifier, 16), bytes.fromhex(data))


def _read(*texts: str) -> list[Any]:
    return canopen.scanner(include_unknown=True).feed([_frame(text) for text in texts])


#: Frames of the facts, and what they are.
WORKED: list[tuple[str, str, dict[str, Any]]] = [
    ("000#01 05", "Nmt", {"command": "start", "node": 5}),
    ("000#80 00", "Nmt", {"command": "pre_operational", "node": 0}),
    ("205#0F 00 18 FC FF FF", "Rpdo1", {"node": 5, "data": bytes.fromhex("0F0018FCFFFF")}),
    ("705#00", "Heartbeat", {"node": 5, "state": "boot_up"}),
    ("705#05", "Heartbeat", {"node": 5, "state": "operational"}),
    ("085#30 81 11 00 00 00 00 00", "Emergency", {"node": 5, "code": "heartbeat_lost", "register": 0x11}),
    ("605#2F 60 60 00 08 00 00 00", "SdoDownload", {"index": 0x6060, "unused": 3, "sized": 1}),
    ("605#23 7A 60 00 18 FC FF FF", "SdoDownload", {"index": 0x607A, "unused": 0}),
    ("605#40 41 60 00 00 00 00 00", "SdoUpload", {"index": 0x6041, "subindex": 0}),
    ("585#4B 41 60 00 37 06 00 00", "SdoUploaded", {"index": 0x6041, "unused": 2}),
    ("585#80 40 60 00 30 00 09 06", "SdoAborted", {"index": 0x6040, "code": "value_range"}),
    ("605#21 08 10 00 06 00 00 00", "SdoDownloadStart", {"index": 0x1008, "size": 6}),
    ("585#60 08 10 00 00 00 00 00", "SdoDownloaded", {"index": 0x1008}),
    ("605#03 61 62 63 64 65 66 00", "SdoDownloadSegment", {"unused": 1, "last": 1, "toggle": 0}),
    ("585#20 00 00 00 00 00 00 00", "SdoDownloadedSegment", {"toggle": 0}),
    ("605#2B 17 10 00 E8 03 00 00", "SdoDownload", {"index": 0x1017, "data": b"\xe8\x03\0\0"}),
]

#: Messages that both dialects have.
EXPEDITED = {"SdoUpload", "SdoUploaded", "SdoDownload", "SdoAborted"}


@pytest.mark.parametrize(("text", "name", "fields"), WORKED)
def test_worked_frames(text: str, name: str, fields: dict[str, Any]) -> None:
    """Each is read as the facts say, and written again with the same bytes."""
    (record,) = _read(text)
    assert type(record).__name__ == name
    found = as_dict(record)
    assert {key: found[key] for key in fields} == fields
    assert canopen.encode(name, **found).data == _frame(text).data


def test_60_means_another_thing_each_way() -> None:
    """Download accepted from the server, the next segment please from the client: the identifier tells."""
    kinds = [
        type(one).__name__ for one in _read("585#60 00 10 00 00 00 00 00", "605#60 00 00 00 00 00 00 00")
    ]
    assert kinds == ["SdoDownloaded", "SdoUploadSegment"]


def test_sync_with_and_without_a_counter() -> None:
    """0x080 alone is SYNC, 0x080 + node an emergency; a counter is 1 to 240."""
    first, second, third = _read("080#", "080#F0", "081#00 10 01 00 00 00 00 00")
    assert isinstance(first, Sync)
    assert second.counter == 240
    assert isinstance(third, Emergency)
    assert third.code == "generic"
    with pytest.raises(FieldError, match="counter"):
        canopen.encode("SyncCounter", counter=241)


def test_what_is_no_object_is_unknown() -> None:
    """Node 0 has no PDO or heartbeat; SDO of seven bytes and of an unknown command are not a message."""
    unknown = ["700#05", "180#00", "605#80 00", "605#40 41 60 00 00 00 00", "777#00 00"]
    for record in _read(*unknown):
        assert type(record).__name__ == "Unknown", record
    assert isinstance(_read("77F#7F")[0], Heartbeat)


def test_transfers_are_one_record() -> None:
    """The dialect `transfers`: segments are one record, what takes and asks for them is counted; all else as in `frames`."""
    written = ["605#21 08 10 00 06 00 00 00", "585#60 08 10 00 00 00 00 00", "605#03 61 62 63 64 65 66 00"]
    read = ["605#40 08 10 00 00 00 00 00", "585#41 08 10 00 06 00 00 00", "605#60 00 00 00 00 00 00 00"]
    rest = ["585#20 00 00 00 00 00 00 00", *read, "585#03 61 62 63 64 65 66 00"]
    expedited = [text for text, name, _ in WORKED if name in EXPEDITED]
    scanner = canopen.scanner(dialect="transfers")
    found = scanner.feed([_frame(text) for text in [*written, *rest, *expedited]])
    names = ["SdoDownloaded", "SdoDownloadTransfer", "SdoUpload", "SdoUploadTransfer"]
    assert [type(one).__name__ for one in found[:4]] == names
    for one in (found[1], found[3]):
        assert (one.node, one.index, one.subindex, one.data) == (5, 0x1008, 0, b"abcdef")
    assert [as_dict(one) for one in found[4:]] == [as_dict(one) for one in _read(*expedited)]
    assert (scanner.counts.control, scanner.counts.malformed) == (2, 0)


def test_codes_without_a_name_show_their_number() -> None:
    """Emergency codes and aborts of makers are kept as they are."""
    emergency, abort = _read("085#21 43 08 01 02 03 04 05", "585#80 40 60 01 01 00 00 08")
    assert (emergency.code, list(emergency.register), emergency.details) == (
        0x4321,
        ["temperature"],
        bytes((1, 2, 3, 4, 5)),
    )
    assert isinstance(abort, SdoAborted)
    assert abort.code == 0x08000001


def test_every_node_and_every_pdo() -> None:
    """127 nodes, four PDOs each way: number and node are told by the identifier."""
    for node in (1, 64, 127):
        for number in range(1, 5):
            for name, base in ((f"Tpdo{number}", 0x180), (f"Rpdo{number}", 0x200)):
                frame = canopen.encode(name, node=node, data=b"\x01\x02")
                assert frame.arbitration_id == base + 0x100 * (number - 1) + node
    (record,) = _read("1FF#")
    assert isinstance(record, Tpdo1)
    assert (record.node, record.data) == (127, b"")


def test_what_the_library_sends_is_understood() -> None:
    """NMT, SYNC, TIME, SDO and emergencies of the canopen library are messages of the spec, with what it meant."""
    library = pytest.importorskip("canopen")
    logging.getLogger("canopen").setLevel(logging.CRITICAL)
    sent: list[Frame] = []

    def send(can_id: int, data: Any, remote: bool = False) -> None:
        sent.append(Frame(can_id, bytes(data)))

    network: Any = library.Network()
    network.send_message = send
    node = library.RemoteNode(5, library.ObjectDictionary())
    network.add_node(node)
    node.sdo.RESPONSE_TIMEOUT = 0.001
    node.nmt.state = "OPERATIONAL"
    network.sync.transmit(3)
    network.time.transmit(86_400 * 366 * 30.0)
    producer: Any = library.emcy.EmcyProducer(0x85)
    producer.network = network
    producer.send(0x8130, 0x11)
    assert _read("085#30 81 11 00 00 00 00 00")[0].code == "heartbeat_lost"
    assert sent.pop().data.hex() == "3081110000000000"
    with pytest.raises(library.SdoCommunicationError):
        node.sdo.upload(0x6041, 0)
    with pytest.raises(library.SdoCommunicationError):
        node.sdo.download(0x1008, 0, b"abcdef")
    found = canopen.scanner(include_unknown=True).feed(sent)
    names = [type(one).__name__ for one in found]
    assert names[:6] == ["Nmt", "SyncCounter", "Time", "SdoUpload", "SdoAbort", "SdoDownloadStart"]
    assert "Unknown" not in names
    assert isinstance(found[3], SdoUpload)
    assert found[4].code == "timeout"
    assert found[5].size == 6
