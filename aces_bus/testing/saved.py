"""Scenes on disk: as a capture that any tool opens, and as the exact scene that a law is asked of again.

    robotis-law3-1f0c9a52.slog     what came over the wire; `aces decode` opens it (CAN: a candump .log)
    robotis-law3-1f0c9a52.json     the same with cuts, silences and transmissions; `aces fuzz --replay` plays it

1. A file's name follows from its content: the same failure is the same file.
2. What is read back is checked, field by field; a file that is none of ours raises `CaptureError`, and nothing else.
"""

from __future__ import annotations

import hashlib
import json
import shlex
import struct
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import construct as c
import msgspec
from msgspec import structs

from ..errors import AcesError, CallerError, CaptureError
from ..frame_table import Channels, FrameTable
from ..frames import Frame
from ..protocol.record import PlainValue
from .bench import Bench
from .packets import DrawnPacket
from .scenes import Scene, Way, Wire, wire_variants

VERSION = 2
#: A scene file larger than this is none of ours.
MOST_BYTES = 1 << 22


@dataclass(frozen=True)
class Saved:
    """Where a failure was written: the capture, and the scene to replay."""

    capture: Path
    scene: Path

    def decode_command(self, spec: str, direction: Way) -> str:
        """Return the command that decodes the capture with a protocol as the command line names it."""
        way = {
            "to device": " --direction to",
            "from device": " --direction from",
            "both": " --direction both",
        }
        return f"aces decode {shlex.quote(str(self.capture))} -p {shlex.quote(spec)}{way.get(str(direction), '')}"


@dataclass(frozen=True)
class Loaded:
    """A scene read back: of which protocol, wire and direction, for which law (None: any)."""

    protocol: str
    label: str
    direction: Way
    law: int | None
    cuts: tuple[int, ...]
    traffic: Any
    idle_at: tuple[int, ...]
    sent_at: tuple[tuple[int, Any], ...]
    packets: tuple[Mapping[str, Any], ...]

    def scene(self, bench: Bench) -> Scene:
        """Return the scene for a wire of that protocol; packets of messages that it no longer has are left out."""
        packets = tuple(p for packet in self.packets if (p := _packet(bench, packet)) is not None)
        return Scene(self.traffic, self.idle_at, self.sent_at, packets)


# ---------------------------------------------------------------------- writing


def save_scene(
    folder: Path,
    wire: Wire,
    direction: Way,
    scene: Scene,
    cuts: Iterable[int] = (),
    *,
    law: int | None = None,
) -> Saved:
    """Write a scene into a folder (made when it is not there). Raises `CallerError` when that cannot be written."""
    text = scene_text(wire, direction, scene, cuts, law=law)
    name = wire_variants(wire)[0].name
    kind = f"law{law}" if law is not None else "scene"
    stem = f"{name}-{kind}-{hashlib.sha256(text.encode()).hexdigest()[:8]}"
    suffix = ".slog" if isinstance(scene.traffic, bytes) else ".log"
    saved = Saved(folder / f"{stem}{suffix}", folder / f"{stem}.json")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        saved.scene.write_text(text, encoding="utf-8")
        if suffix == ".slog":
            _write_stream(saved.capture, direction, scene, tuple(cuts))
        else:
            _write_frames(saved.capture, scene)
    except OSError as error:
        raise CallerError(f"{folder}: cannot be written: {error.strerror or error}") from error
    return saved


def _write_stream(path: Path, direction: Way, scene: Scene, cuts: tuple[int, ...]) -> None:
    from ..recordings.base import Chunk
    from ..recordings.write.serial import SerialLogWriter

    way: Any = direction if direction in ("to device", "from device") else None
    if way is None and scene.sent_at:
        way = "from device"
    borders = {offset for offset in (*cuts, *scene.idle_at) if 0 < offset < len(scene)}
    borders |= {offset for offset, _ in scene.sent_at if 0 < offset < len(scene)}
    with path.open("wb") as file:
        writer = SerialLogWriter(file, str(path))
        at = 0
        for end in [*sorted(borders), len(scene)]:
            for offset, packet in scene.sent_at:
                if at <= offset < end or offset == end == len(scene):
                    writer.write(Chunk(packet, None, "to device"))
            writer.write(Chunk(scene.traffic[at:end], None, way))
            at = end
        writer.close()


def _write_frames(path: Path, scene: Scene) -> None:
    from ..recordings.write.candump import CandumpWriter

    sent = list(scene.sent_at)
    frames: list[Frame] = []
    for number, frame in enumerate([*scene.traffic, None]):
        while sent and sent[0][0] <= number:
            frames.append(structs.replace(sent.pop(0)[1], is_rx=False))
        if frame is not None:
            frames.append(frame)
    timed = [
        frame if frame.timestamp is not None else structs.replace(frame, timestamp=number / 1000)
        for number, frame in enumerate(frames)
    ]
    with path.open("wb") as file:
        writer = CandumpWriter(file, str(path))
        if timed:
            writer.write(FrameTable.from_frames(timed, Channels()))
        writer.close()


def scene_text(
    wire: Wire, direction: Way, scene: Scene, cuts: Iterable[int] = (), *, law: int | None = None
) -> str:
    """Return a scene as JSON."""
    variants = wire_variants(wire)
    return json.dumps(
        {
            "aces scene": VERSION,
            "protocol": variants[0].name,
            "wire": " + ".join(v.label for v in variants),
            "direction": direction,
            "law": law,
            "traffic": scene.traffic.hex()
            if isinstance(scene.traffic, bytes)
            else [*map(_frame, scene.traffic)],
            "cuts": [*cuts],
            "idle_at": [*scene.idle_at],
            "sent_at": [[o, w.hex() if isinstance(w, bytes) else _frame(w)] for o, w in scene.sent_at],
            "packets": [_written(packet) for packet in scene.packets],
        },
        indent=1,
        ensure_ascii=False,
    )


def _frame(frame: Frame) -> dict[str, PlainValue]:
    about = structs.asdict(frame) | {"data": frame.data.hex()}
    usual = {"is_rx": None, "timestamp": None, "channel": None, "dlc": None}
    return {name: value for name, value in about.items() if value is not usual.get(name, False)}


def _written(packet: DrawnPacket) -> dict[str, PlainValue]:
    request = _written(packet.request) if packet.request is not None else None
    return {
        "message": packet.message.name,
        "values": _tagged(packet.values),
        "image": packet.image.hex(),
        "request": request,
    }


def _tagged(value: Any) -> Any:
    """Return values as JSON, each with its kind: bytes and floats keep every bit."""
    if isinstance(value, (bytes, bytearray)):
        return ["bytes", bytes(value).hex()]
    if isinstance(value, float):
        return ["float", struct.pack(">d", value).hex()]
    if isinstance(value, Mapping):
        return ["fields", {str(k): _tagged(v) for k, v in value.items() if not str(k).startswith("_")}]
    if isinstance(value, (list, tuple)):
        return ["list", [_tagged(item) for item in value]]
    if isinstance(value, int) and not isinstance(value, bool):
        return int(value)
    return value


def _untagged(value: Any) -> Any:
    if not isinstance(value, list):
        return value
    kind, content = value
    if kind == "bytes":
        return bytes.fromhex(content)
    if kind == "float":
        return struct.unpack(">d", bytes.fromhex(content))[0]
    if kind == "fields":
        return c.Container({name: _untagged(inner) for name, inner in content.items()})
    return c.ListContainer(_untagged(item) for item in content)


# ---------------------------------------------------------------------- reading


def load_scene(path: Path) -> Loaded:
    """Read a scene that `save` wrote. Raises `CaptureError` when it is none."""
    try:
        if path.stat().st_size > MOST_BYTES:
            raise CaptureError(f"{path}: larger than any scene; is it one that 'aces fuzz' saved?")
        return _loaded(json.loads(path.read_text(encoding="utf-8")))
    except OSError as error:
        raise CaptureError(f"{path}: {error.strerror or error}") from error
    except AcesError as error:
        raise CaptureError(f"{path}: {error}") from error
    except (ValueError, TypeError, LookupError, AttributeError, RecursionError, struct.error) as error:
        raise CaptureError(f"{path}: not a scene that 'aces fuzz' saved ({error})") from error


def _loaded(said: Any) -> Loaded:
    if said["aces scene"] != VERSION:
        raise ValueError(f"version {said['aces scene']!r}")
    if said["direction"] not in (None, "both", "to device", "from device"):
        raise ValueError(f"direction {said['direction']!r}")
    traffic = (
        _sent(said["traffic"]) if isinstance(said["traffic"], str) else tuple(map(_sent, said["traffic"]))
    )
    size = len(traffic)

    def offsets(numbers: Any) -> tuple[int, ...]:
        return tuple(min(max(int(n), 0), size) for n in numbers)

    return Loaded(
        str(said["protocol"]),
        str(said["wire"]),
        said["direction"],
        None if said["law"] is None else int(said["law"]),
        tuple(sorted(offsets(said["cuts"]))),
        traffic,
        tuple(sorted(set(offsets(said["idle_at"])))),
        tuple((offsets([at])[0], _sent(packet)) for at, packet in said["sent_at"]),
        tuple(said["packets"]),
    )


def _sent(said: Any) -> Any:
    if isinstance(said, str):
        return bytes.fromhex(said)
    about: dict[str, Any] = {**said, "data": bytes.fromhex(said.get("data", ""))}
    return msgspec.convert(msgspec.to_builtins(Frame(**about)), Frame)  # a frame of other types raises


def _packet(bench: Bench, said: Mapping[str, Any]) -> DrawnPacket | None:
    try:
        message = next(m for (_, name), m in bench.by_name.items() if name == said["message"])
        request = _packet(bench, said["request"]) if said["request"] is not None else None
        return DrawnPacket(message, _untagged(said["values"]), bytes.fromhex(said["image"]), request)
    except (StopIteration, KeyError, TypeError, ValueError, struct.error):
        return None


__all__ = ["Loaded", "Saved", "load_scene", "save_scene", "scene_text"]
