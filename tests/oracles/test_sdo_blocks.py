"""canopen's block streams, unmodified, against our server: by hand on a wire that loses frames, and against the twin.

What goes over the wire a bystander reads as one record each way, byte for byte, whatever was lost and sent again.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import aces_devices.cia402
from aces_bus import Frame
from aces_bus.frames import message_to_frame
from aces_protocols.canopen.spec import canopen as shipped
from tests.oracles.foreign import oracle
from tests.oracles.served import PATIENCE_S, served

canopen = oracle("canopen", "canopen")
NODE, INDEX = 5, 0x2000
encode = shipped.variant(dialect="transfers").encoder.encode


def text(size: int) -> bytes:
    return bytes((11 * place + size) & 0xFF for place in range(size))


class Wire:
    """A client and a node in one thread: what one sends the other has at once, unless it is lost."""

    def __init__(self, is_lost: Callable[[int, bytes], bool] = lambda number, data: False) -> None:
        from aces_devices.canopen_node.sdo_server import BlockSdoServer

        self.sent: list[Frame] = []
        dictionary = canopen.ObjectDictionary()
        variable = canopen.objectdictionary.ODVariable("data", INDEX)
        variable.data_type, variable.access_type = canopen.objectdictionary.DOMAIN, "rw"
        dictionary.add_object(variable)
        self.node = canopen.LocalNode(NODE, dictionary)
        self.client = canopen.sdo.SdoClient(0x600 + NODE, 0x580 + NODE, dictionary)
        self.client.RESPONSE_TIMEOUT = PATIENCE_S
        server: Any = BlockSdoServer(0x600 + NODE, 0x580 + NODE, self.node)
        for one, other in ((self.client, server.on_request), (server, self.client.on_response)):
            one.network = _Line(self.sent, is_lost, other)

    def records(self) -> list[Any]:
        """What a bystander reads, who heard all."""
        scanner = shipped.scanner(dialect="transfers", include_unknown=True)
        return [*scanner.feed(self.sent), *scanner.close()]


class _Line:
    """One way of the wire, as canopen's network."""

    def __init__(self, sent: list[Frame], is_lost: Any, other: Any) -> None:
        self.sent, self._is_lost, self._other = sent, is_lost, other

    def send_message(self, identifier: int, data: Any, remote: bool = False) -> None:
        self.sent.append(Frame(identifier, bytes(data)))
        if not self._is_lost(len(self.sent), bytes(data)):
            self._other(identifier, bytearray(data), 0.0)


def write(client: Any, data: bytes, *, checked: bool = True, sized: bool = True) -> None:
    size = len(data) if sized else None
    with client.open(INDEX, 0, "wb", block_transfer=True, size=size, request_crc_support=checked) as stream:
        stream.write(data)


def read(client: Any, *, checked: bool = True) -> bytes:
    with client.open(INDEX, 0, "rb", block_transfer=True, request_crc_support=checked) as stream:
        return bytes(stream.read())


@pytest.mark.parametrize("size", [1, 7, 8, 7 * 35, 370])
def test_what_canopen_writes_and_reads_is_one_record_each(size: int) -> None:
    """Both ways with a CRC and without; and our encoder makes the same frames."""
    data = text(size)
    for checked in (1, 0):
        wire = Wire()
        write(wire.client, data, checked=bool(checked))
        assert wire.node.get_data(INDEX, 0) == data
        record, over = wire.records()
        assert (type(record).__name__, record.data, record.checked) == (
            "SdoBlockDownloadTransfer",
            data,
            checked,
        )
        assert over.reason == "control: block transfer over"
        ours = encode(
            "SdoBlockDownloadTransfer",
            node=NODE,
            checked=checked,
            sized=1,
            index=INDEX,
            subindex=0,
            data=data,
        )
        sender = [bytes(one.data) for one in ours if one.arbitration_id == 0x600 + NODE]
        assert sender == [one.data for one in wire.sent if one.arbitration_id == 0x600 + NODE]
        wire.sent.clear()
        assert read(wire.client, checked=bool(checked)) == data
        asked, record, over = wire.records()
        assert (type(asked).__name__, asked.block_size) == ("SdoBlockUpload", 127)
        assert (type(record).__name__, record.data) == ("SdoBlockUploadTransfer", data)
        ours = encode(
            "SdoBlockUploadTransfer", node=NODE, checked=checked, sized=1, index=INDEX, subindex=0, data=data
        )
        assert [bytes(one.data) for one in ours] == [one.data for one in wire.sent[1:-1]]


@pytest.mark.parametrize("place", [4, 30, 100])
def test_segments_that_are_lost_come_again(place: int) -> None:
    """One of each transfer does not arrive; the bystander, who saw all of them, reads what has arrived in the end.

    What canopen writes loses it in a block before the last one: of the last one canopen 2.4 sends nothing again.
    """
    data = text(7 * 200)
    written = Wire(lambda number, said: number == place)
    write(written.client, data)
    assert written.node.get_data(INDEX, 0) == data
    assert [one.data for one in written.records()[:-1]] == [data]
    given = Wire(lambda number, said: number == place)
    given.node.set_data(INDEX, 0, data)
    assert read(given.client) == data
    assert [one.data for one in given.records()[1:-1]] == [data]
    assert min(len(written.sent), len(given.sent)) > 200 + 8 + 127 - place


def test_a_wrong_crc_writes_nothing() -> None:
    """The server aborts, canopen says so, and a bystander has no record of the object."""
    wire = Wire()
    wire.node.set_data(INDEX, 0, b"as before")
    wire.client.crc_cls = lambda: type("Wrong", (), {"process": lambda *_: None, "final": lambda _: 0x1234})()
    with pytest.raises(canopen.SdoAbortedError, match="0x05040004"):
        write(wire.client, text(20))
    assert wire.node.get_data(INDEX, 0) == b"as before"
    assert "malformed: checksum" in [getattr(one, "reason", "") for one in wire.records()]


def test_what_cannot_be_read_or_written_is_refused() -> None:
    """By its abort code, before any data."""
    wire = Wire()
    for code, transfer in (
        ("0x060A0023", lambda: read(wire.client)),
        ("0x06020000", lambda: wire.client.open(0x3000, 0, "wb", block_transfer=True, size=9)),
    ):
        with pytest.raises(canopen.SdoAbortedError, match=code):
            transfer()


def test_the_twin_answers_canopen_s_client(tmp_path: Path) -> None:
    """A drive's twin on a served bus: a file is written and read, its name is read; each is one record."""
    eds = tmp_path / "drive.eds"
    own = Path(aces_devices.cia402.__file__).with_name("drive.eds").read_text(encoding="utf-8")
    begin, _, end = own.partition("[ManufacturerObjects]")
    rest = end[end.index("\n[") :]
    eds.write_text(
        f"{begin}[ManufacturerObjects]\nSupportedObjects=1\n1=0x2000\n{rest}\n"
        "[2000]\nParameterName=File\nObjectType=0x2\nDataType=0x000F\nAccessType=rw\nPDOMapping=0\n",
        encoding="utf-8",
    )
    robot = f"""
name = "one"
[buses]
line = {{ link = "can", protocol = "canopen", bitrate = 1_000_000 }}
[devices.DRIVE]
driver = "cia402"
bus = "line"
credentials = {{ node = {NODE} }}
settings = {{ eds = "{eds}", counts_per_turn = 1000 }}
[joints]
ARM = {{ device = "DRIVE", channel = 0, lower = -1, upper = 1 }}
"""
    data = text(1000)
    with served(robot) as side:
        network = canopen.Network()
        network.connect(interface="aces", channel=side.channel)
        try:
            node = network.add_node(NODE, str(eds))
            node.sdo.RESPONSE_TIMEOUT = PATIENCE_S
            write(node.sdo, data)
            assert read(node.sdo) == data
            with node.sdo.open(0x1008, 0, "r", block_transfer=True) as stream:
                name = stream.read()
            assert name == node.sdo[0x1008].raw
        finally:
            network.disconnect()
        frames = [message_to_frame(one) for one in side.frames()]
    scanner = shipped.scanner(dialect="transfers", include_unknown=True)
    found = [*scanner.feed(frames), *scanner.close()]
    assert [one.data for one in found if type(one).__name__ == "SdoBlockDownloadTransfer"] == [data]
    read_back = [one.data for one in found if type(one).__name__ == "SdoBlockUploadTransfer"]
    assert read_back == [data, name.encode()]
    assert scanner.counts.malformed == scanner.counts.unknown == 0
