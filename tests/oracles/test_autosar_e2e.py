"""The package autosar-e2e, unmodified: messages that it protects, read and built by specs whose checks have data ids."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from aces_bus import Frame, FrameTable, make_column_scanner, make_scanner
from aces_bus.protocol import BitLayout, Counter, Crc, DataIds, Protocol, bits
from aces_bus.protocol.against import check_recordings
from aces_bus.protocol.files import load_file
from aces_bus.protocol.reference import Reference
from aces_lab.guess import Traffic, draft_source
from tests.oracles.foreign import oracle

profile_2: Any = oracle("e2e.p02", "autosar-e2e")
profile_1: Any = oracle("e2e.p01", "autosar-e2e")

IDS = bytes.fromhex("3F 1A 77 02 C5 9E 10 4D AB 60 08 F1 33 D2 5C 81")
OWN = 0x5A3C
spec = Protocol("protected", link="can")
Body = BitLayout(
    8,
    "crc" / bits(8),
    "count" / Counter(bits(4)),
    "mode" / bits(4),
    "speed" / bits(16),
    "force" / bits(16),
    "flags" / bits(16),
)
spec.message(
    "Second",
    id=0x200,
    payload=Body,
    check=Crc("CRC8-AUTOSAR", field="crc", over=(slice(1, None), DataIds("count", IDS))),
)
spec.message(
    "First",
    id=0x201,
    payload=Body,
    # Profile 1 has SAE J1850's polynomial; its initial and final values cancel out (AUTOSAR PRS E2EProtocol, profile 1).
    check=Crc(
        width=8,
        poly=0x1D,
        field="crc",
        over=(DataIds("count", bytes([OWN & 0xFF, OWN >> 8])), slice(1, None)),
    ),
)


def protected(count: int) -> list[Frame]:
    """Frames that the package has protected: profile 2, and profile 1 in its alternating mode."""
    drawn = np.random.default_rng(11)
    found = []
    for number in range(count):
        speed = int(20000 + 9000 * np.sin(number / 30))
        body = bytearray([0, number % 16 | 0x30, *speed.to_bytes(2, "little"), *drawn.bytes(4)])
        profile_2.e2e_p02_protect(body, IDS, increment_counter=False)
        found.append(Frame(0x200, bytes(body), number / 100))
        body[1] = number % 15 | 0x30
        mode = profile_1.E2E_P01_DATAID_ALT
        profile_1.e2e_p01_protect(body, OWN, data_id_mode=mode, increment_counter=False)
        found.append(Frame(0x201, bytes(body), number / 100 + 0.001))
    return found


def test_messages_of_the_package_hold_and_ours_are_the_same() -> None:
    """Live, in columns and by the reference; built again, each is the same frame; a flipped bit is refused."""
    frames = protected(600)
    live, columns = make_scanner([spec.variant()]), make_column_scanner([spec.variant()])
    records = live.feed(frames)
    columns.feed(FrameTable.from_frames(frames))
    reference = Reference([spec.variant()]).frames(frames)
    assert len(records) == live.counts.records == columns.counts.records == len(frames)
    assert [item.message for item in reference] == [type(record).__name__ for record in records]
    for record, frame in zip(records, frames, strict=True):
        fields = {name: getattr(record, name) for name in ("count", "mode", "speed", "force", "flags")}
        assert spec.encode(type(record).__name__, **fields).data == frame.data
    for byte in range(8):
        data = bytearray(frames[byte].data)
        data[byte] ^= 1 << byte
        broken = Frame(frames[byte].arbitration_id, bytes(data))
        assert str(spec.scanner(include_unknown=True).feed([broken])[0].reason) == "malformed: checksum"


@pytest.mark.parametrize("identifier", [0x200, 0x201])
def test_a_draft_declares_the_ids_and_holds_against_its_recording(identifier: int, tmp_path: Path) -> None:
    """What `spec guess` solves of the package's messages is declared; `spec check --against` finds nothing wrong."""
    frames = [frame for frame in protected(600) if frame.arbitration_id == identifier]
    traffic = Traffic()
    traffic.add(FrameTable.from_frames(frames))
    path = tmp_path / "draft.py"
    path.write_text(draft_source(traffic.guess(known=False), "draft", ["car.log"]), encoding="utf-8")
    draft = load_file(str(path)).draft
    assert isinstance(draft, Protocol)
    [message] = draft.messages.values()
    assert message.check is not None
    [ids] = [part for part in message.check_over if isinstance(part, DataIds)]
    if identifier == 0x200:
        assert ids.ids == IDS
    scanner = draft.scanner()
    assert len(scanner.feed(frames)) == len(frames)
    assert [str(found) for found in check_recordings(draft, [frames]) if found.level != "note"] == []
