"""pcap and pcapng beside scapy, which is not a dependency: what it writes we read, and what we write it reads."""

from __future__ import annotations

import importlib.util
import random
from pathlib import Path
from typing import Any

import pytest

from aces_bus import Frame, FrameTable, open_recording
from aces_bus.frames import FD_LENGTHS
from aces_bus.recordings.write import open_writer

if importlib.util.find_spec("scapy") is None:
    pytest.skip("scapy is not installed (pip install scapy)", allow_module_level=True)

can_layer: Any = pytest.importorskip("scapy.layers.can")
files: Any = pytest.importorskip("scapy.utils")


def drawn(dice: random.Random) -> list[Frame]:
    """Frames of all kinds."""
    frames: list[Frame] = []
    for number in range(60):
        kind = dice.choice(["data", "remote", "fd", "error"])
        extended = kind != "error" and dice.random() < 0.4
        size = dice.choice(FD_LENGTHS) if kind == "fd" else dice.randint(0, 8)
        wide = extended or kind == "error"
        frames.append(
            Frame(
                dice.getrandbits(29 if wide else 11),
                b"" if kind == "remote" else dice.randbytes(size),
                1436509052.5 + number / 1024,
                "can0",
                extended,
                kind == "remote",
                kind == "error",
                kind == "fd",
                kind == "fd" and dice.random() < 0.5,
                kind == "fd" and dice.random() < 0.5,
                dlc=size if kind == "remote" else None,
            )
        )
    return frames


def flags_of(frame: Frame) -> int:
    """SocketCAN's three bits above the identifier."""
    return 4 * frame.is_extended_id + 2 * frame.is_remote_frame + frame.is_error_frame


def marks_of(frame: Frame) -> int:
    """The flags of a CAN FD frame."""
    return frame.is_fd * (4 + frame.bitrate_switch + 2 * frame.error_state_indicator)


@pytest.mark.parametrize("seed", range(4))
def test_scapy_reads_what_we_write(seed: int, tmp_path: Path) -> None:
    """Identifier, flags, data and time of every packet."""
    frames = drawn(random.Random(seed))
    path = tmp_path / "walk.pcapng"
    with open_writer(path) as writer:
        writer.write(FrameTable.from_frames(frames))
    packets = files.rdpcap(str(path))
    assert len(packets) == len(frames)
    for packet, frame in zip(packets, frames, strict=True):
        assert isinstance(packet, can_layer.CANFD if frame.is_fd else can_layer.CAN)
        assert (packet.identifier, int(packet.flags)) == (frame.arbitration_id, flags_of(frame))
        assert (packet.length, bytes(packet.data)[: len(frame.data)]) == (frame.length, frame.data)
        if frame.is_fd:
            assert int(packet.fd_flags) == marks_of(frame)
        assert float(packet.time) == pytest.approx(frame.timestamp, abs=1e-6)


@pytest.mark.parametrize("suffix", ["pcap", "pcapng"])
@pytest.mark.parametrize("seed", range(4))
def test_we_read_what_scapy_writes(suffix: str, seed: int, tmp_path: Path) -> None:
    """The same the other way round; pcap names no interface, and neither says the direction."""
    frames = drawn(random.Random(seed))
    packets: list[Any] = []
    for frame in frames:
        kind = can_layer.CANFD if frame.is_fd else can_layer.CAN
        marks = {"fd_flags": marks_of(frame)} if frame.is_fd else {}
        packet = kind(
            identifier=frame.arbitration_id,
            flags=flags_of(frame),
            length=frame.length,
            data=frame.data,
            **marks,
        )
        packet.time = frame.timestamp
        packets.append(packet)
    path = tmp_path / f"walk.{suffix}"
    (files.wrpcap if suffix == "pcap" else files.wrpcapng)(str(path), packets)
    with open_recording(path, link="can") as capture:
        found = list(capture)
        assert capture.problems == []
    for one, frame in zip(found, frames, strict=True):
        assert one.timestamp == pytest.approx(frame.timestamp, abs=1e-6)
        for name in ("arbitration_id", "data", "length", "is_fd", "bitrate_switch", "error_state_indicator"):
            assert getattr(one, name) == getattr(frame, name), name
        assert flags_of(one) == flags_of(frame)
