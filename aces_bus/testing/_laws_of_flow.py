"""Laws 3, 4, 6, 7 and 8: nothing is lost, however the words come, and nothing stops the scanner.

Each function takes a `Trial` and raises `LawError`; the public ones with wire, direction and scene are in `laws`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from ..frame_table import FrameTable
from ..protocol.declare.framing import Framing, Verdict
from ..protocol.live.can import CanScanner
from ..protocol.live.candidates import CHAINS
from ..protocol.live.stream import StreamScanner
from ..protocol.record import Unknown
from ._laws_of_content import first_difference
from ._play import as_heard, copy_item, image_of, play
from ._scenes import Scene, cast
from ._trial import Trial

# ---------------------------------------------------------------------- 3


def check_chunking(trial: Trial) -> None:
    """Law 3."""
    given, counts, _ = trial.cut_up
    pieces = as_heard(given, trial.bench.is_can)
    how = f"cut at {trial.cuts}: "
    if pieces != trial.heard:
        trial.fail(3, how + first_difference("whole", trial.heard, "in pieces", pieces))
    if counts != trial.counts:
        trial.fail(3, f"{how}counts {counts} instead of {trial.counts}")
    if trial.bench.is_can and trial.columns and not trial.scene.sent_at:
        scanner: Any = trial.bench.scanner()
        table = as_heard(scanner.feed_table(FrameTable.from_frames(trial.scene.words)), is_can=True)
        if table != trial.heard:
            trial.fail(3, "as a table: " + first_difference("whole", trial.heard, "the table", table))


# ---------------------------------------------------------------------- 4


def check_resynchronisation(trial: Trial) -> None:
    """Law 4."""
    if trial.bench.is_can:
        _no_frame_overlooked(trial)
        return
    scene = trial.scene
    covered = bytearray(len(scene))
    for item in trial.heard:
        if item.message or item.reason.startswith("unknown"):
            covered[item.offset : item.offset + item.size] = b"\1" * item.size
    framings = list(zip(trial.bench.framings, trial.bench.extras, strict=True))
    begin = 0
    for end in [*scene.idle_at, len(scene)]:
        seen = scene.words[:end]
        for (variant, framing, messages), extras in framings:
            for start in _candidates(framing, seen, begin):
                if covered[start]:
                    continue
                judged = framing.judge(seen, start, silent=True, extras=extras)
                if judged.verdict is not Verdict.WHOLE or any(covered[start : start + judged.size]):
                    continue
                packet = seen[start : start + judged.size]
                name = next(
                    (m.name for m in messages if trial.bench.reads(m, packet)), "a packet without a message"
                )
                trial.fail(4, f"at {start} stands {variant.name} {name} {packet.hex()}, not heard")
        begin = end


def _candidates(framing: Framing, seen: bytes, begin: int) -> Sequence[int]:
    """Where a packet of a framing may begin."""
    if not framing.sync:
        return range(begin, len(seen))
    found: list[int] = []
    at = seen.find(framing.sync, begin)
    while at >= 0:
        found.append(at)
        at = seen.find(framing.sync, at + 1)
    return found


def _no_frame_overlooked(trial: Trial) -> None:
    who = cast(trial.bench.wire, trial.direction)
    heard = trial.heard
    if len(heard) != len(trial.scene):
        trial.fail(4, f"of {len(trial.scene)} frames, {len(heard)} were heard")
    for number, frame in enumerate(trial.scene.words):
        item = heard[number]
        if frame.is_error_frame or item.message or item.reason.startswith("unknown: needs"):
            continue
        image = image_of(frame)
        for variant, message in who.messages:
            if (variant.name, message.name) in trial.bench.contextual:
                continue
            if message.identifier.match(frame.arbitration_id) is not None and trial.bench.reads(
                message, image
            ):
                trial.fail(4, f"frame {number} is {message.name}, but was {item.reason}")


# ---------------------------------------------------------------------- 6


def check_accounting(trial: Trial) -> None:
    """Law 6."""
    is_can, scene = trial.bench.is_can, trial.scene
    given, counts, balance = trial.cut_up
    if balance or counts["total"] != len(scene):
        trial.fail(6, f"bins do not sum to {len(scene)}: {counts}")
    if is_can and len(given) != len(scene):
        trial.fail(6, f"of {len(scene)} frames, {len(given)} came out")
    spans = [(i, 1) for i in range(len(given))] if is_can else [(g.meta.offset, g.meta.size) for g in given]
    at = 0
    losses: dict[str, int] = {}
    decoded = records = 0
    for (offset, size), item in zip(spans, given, strict=True):
        raw = item.meta.raw
        wanted = bytes(scene.words[offset].data) if is_can else scene.words[offset : offset + size]
        if offset != at or size < 1 or raw != wanted:
            trial.fail(6, f"at {at}, something of {size} from {offset} on, raw {raw.hex()}")
        at += size
        if isinstance(item, Unknown):
            losses[item.reason] = losses.get(item.reason, 0) + size
        else:
            decoded, records = decoded + size, records + 1
    pending = losses.pop("pending", 0)
    if at != len(scene) or (decoded, records, pending, losses) != tuple(
        counts[name] for name in ("decoded", "records", "pending", "reasons")
    ):
        trial.fail(
            6, f"given: decoded={decoded} records={records} pending={pending} {losses}; counts: {counts}"
        )
    less = trial.bench.scanner(include_unknown=False)
    names = [type(item).__name__ for item in play(less, scene, trial.cuts)]
    if copy_item(less.counts) != counts:
        trial.fail(6, f"without everything, counts are {copy_item(less.counts)}, not {counts}")
    if names != [type(item).__name__ for item in given if not isinstance(item, Unknown)]:
        trial.fail(6, "without everything, other records come")


# ---------------------------------------------------------------------- 7

#: A check may cost this many bytes for a candidate besides the sums of its bytes (law 7: O(1)).
PER_CANDIDATE = 16


def check_bounded(trial: Trial) -> None:
    """Law 7."""
    if trial.bench.is_can:
        return
    scanner, words = trial.bench.scanner(), trial.scene.words
    assert isinstance(scanner, StreamScanner)
    at = 0
    cuts = [*trial.cuts, len(words)]
    for cut in cuts:
        chunk = words[at : max(at, cut)]
        scanner.feed(chunk)
        at = max(at, cut)
        if scanner.buffered > scanner.max_size:
            trial.fail(7, f"{scanner.buffered} bytes held after {at}, max_size is {scanner.max_size}")
    scanner.close()
    limit = _work_allowed(scanner.framings, words, len(cuts))
    if scanner.check_work > limit:
        trial.fail(7, f"checks read {scanner.check_work} bytes of {len(words)}; {limit} is the limit")
    limit = _unstuffing_allowed(scanner.framings, words, len(cuts))
    if scanner.unstuff_work > limit:
        trial.fail(7, f"unstuffing read {scanner.unstuff_work} bytes of {len(words)}; {limit} is the limit")


def _work_allowed(framings: Sequence[Framing], words: bytes, chunks: int) -> int:
    """How many bytes checks may read in `words`."""
    limit = len(words)  # each byte of an accepted packet once
    for framing in framings:
        if framing.check is None:
            continue
        candidates = len(_candidates(framing, words, 0))
        is_whole = framing.end and framing.stuffing is None  # what stands on the wire is what is summed
        if framing.check.kind == "crc" or not ((framing.sync and not framing.end) or is_whole):
            limit += framing.max_size * candidates
            if len(framings) > 1:
                # While another framing waits at the same offset, each chunk has the candidate read again.
                limit += framing.max_size * chunks
        else:
            limit += len(words) + PER_CANDIDATE * candidates
    return limit


def _unstuffing_allowed(framings: Sequence[Framing], words: bytes, chunks: int) -> int:
    """How many bytes may be unstuffed in `words`: a few times all of them, and a small part of a packet a candidate."""
    limit = 0
    for framing in framings:
        if framing.is_enclosed:
            limit += 3 * len(words) + (framing.max_size // CHAINS + 1) * len(words)
            if len(framings) > 1:
                limit += 2 * framing.max_size * chunks
    return limit


# ---------------------------------------------------------------------- 8


def check_calm(trial: Trial) -> None:
    """Law 8."""
    for include_unknown, raw in trial.sample(((True, False), (False, False), (True, True))):
        scanner = trial.bench.scanner(include_unknown=include_unknown, raw=raw)
        try:
            for record in play(scanner, trial.scene, trial.cuts):
                assert repr(record)
                assert record.meta is not None
            _provoke(scanner, trial.scene)
        except Exception as error:
            trial.fail(8, f"raised {error!r} (include_unknown={include_unknown}, raw={raw})")


def _provoke(scanner: Any, scene: Scene) -> None:
    """What a caller may also do: send nonsense, fall silent twice, go on after the end."""
    words = scene.words
    if isinstance(scanner, CanScanner):
        for frame in words:
            scanner.sent(frame)
        scanner.feed(words)
        scanner.feed(iter(words))
        return
    scanner.sent(words[: len(words) // 2])
    scanner.sent(b"")
    scanner.feed(bytearray(words), 1.5)
    scanner.idle()
    scanner.idle(float("nan"))
    scanner.feed(words[::-1], float("inf"))
    scanner.close()
    scanner.close()
    if scanner.counts.balance:
        raise AssertionError(f"bins do not sum: {scanner.counts}")


__all__ = ["check_accounting", "check_bounded", "check_calm", "check_chunking", "check_resynchronisation"]
