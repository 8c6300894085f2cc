"""The nine laws on every registered protocol × dialect × shipped configuration × direction, and on the specs of the tests.

The examples of a protocol are shared among its cases, so that a protocol of many dialects costs no more than one of one:
`EXAMPLES` a law and protocol in the short profile, `ACES_EXAMPLES` in the long one. For hundreds of thousands of examples
of one protocol there is `aces fuzz`.
"""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

import can
import msgspec
import pytest
from hypothesis import HealthCheck, Phase, given, settings

from aces_bus import make_scanner
from aces_bus.testing import LAWS, Scene, laws, strategies
from aces_bus.testing.bench import Bench
from aces_bus.testing.fuzz import shrink
from aces_bus.testing.saved import load_scene, save_scene
from aces_bus.testing.trial import Law
from tests import kept
from tests.laws.drawn import drawn_arguments
from tests.laws.wires import CASES, MIXED, PROTOCOLS, REGISTERED, Case

#: Examples a law and protocol in the short profile; each is a wire of some hundred bytes or some dozens of frames.
EXAMPLES = 4
#: Dialects, configurations and directions of a protocol in `make test`; as many again, or more, are in `make test-slow`.
CASES_OF_A_PROTOCOL = 4
#: Shrinking is ours: it knows what a packet is.
PHASES = (Phase.explicit, Phase.generate)
#: Where scenes that break a law are kept: when they are drawn anew, for else they come again by themselves.
KEEP = None if settings().derandomize else kept.FAILURES
#: Law 7 has scenes of its own; the others are asked of the same ones, so that each is drawn and read once.
BOUNDED = LAWS[6]
ANY_SCENE = tuple(law for law in LAWS if law is not BOUNDED)


@cache
def _bench(case: Case) -> Bench:
    """The scanners of a case, made once; in the short profile construct is asked once of an image, as in `aces fuzz`."""
    return Bench(case.wire, case.direction, remembers=not _is_long())


def _is_long() -> bool:
    return settings().max_examples > 100


def _some(cases: Sequence[Case]) -> list[Any]:
    """In the short profile, every second case of a protocol of many dialects, configurations and directions, few of them
    quick."""
    chosen: list[Any] = []
    for number, one in enumerate(cases):
        if (
            _is_long()
            or one.share <= CASES_OF_A_PROTOCOL
            or number % -(-one.share // CASES_OF_A_PROTOCOL) == 0
        ):
            chosen.append(pytest.param(one, id=str(one)))
        elif one.share <= 8 or number % 2 == 0:
            chosen.append(pytest.param(one, id=str(one), marks=pytest.mark.slow))
    return chosen


def _examples(case: Case) -> int:
    wanted = settings().max_examples if _is_long() else EXAMPLES
    return max(2, wanted // case.share)


def _holds(asked: Sequence[Law], case: Case, folder: Path | None) -> None:
    """Draw scenes and ask laws of them; the scene that breaks one is kept in a folder, shrunk."""
    broken: list[tuple[Law, tuple[Any, ...]]] = []
    bench = _bench(case)

    @settings(
        max_examples=_examples(case),
        suppress_health_check=(HealthCheck.too_slow, HealthCheck.data_too_large),
        phases=PHASES,
        print_blob=False,
    )
    @given(strategies.arguments(asked[-1], case.wire, case.direction))
    def holds(arguments: tuple[Any, ...]) -> None:
        trial = laws.Trial(bench, *arguments)
        for law in asked:
            try:
                law.judges(trial)
            except laws.LawError:
                broken[:] = [(law, arguments)]
                raise

    try:
        holds()
    except Exception as error:
        if broken and folder is not None:
            ((law, arguments),) = broken
            trial = laws.Trial(Bench(case.wire, case.direction), *arguments)
            failure = shrink(law, trial, str(error))
            saved = save_scene(folder, case.wire, case.direction, failure.scene, failure.cuts, law=law.number)
            error.add_note(f"kept in {saved.scene}: `make test` replays it from now on")
        raise


@pytest.mark.parametrize("case", [*_some(CASES), *MIXED], ids=str)
def test_laws_hold(case: Case) -> None:
    """Whatever comes over the wire, every law holds."""
    _holds(sorted(ANY_SCENE, key=lambda law: law.takes_cuts), case, KEEP)


@pytest.mark.parametrize(
    "case", [one for one in (*CASES, *MIXED) if laws.wire_variants(one.wire)[0].link != "can"], ids=str
)
def test_work_is_bounded(case: Case) -> None:
    """Whatever comes over a serial line, headers that promise long packets too, the law of bounded work holds."""
    _holds([BOUNDED], case, KEEP)


def replay(path: Path) -> None:
    """Ask a scene that was kept of the law that it broke."""
    loaded = load_scene(path)
    (case,) = [
        one
        for one in (*CASES, *MIXED)
        if " + ".join(v.label for v in laws.wire_variants(one.wire)) == loaded.label
        and one.direction == loaded.direction
    ]
    trial = laws.Trial(
        Bench(case.wire, case.direction), loaded.scene(Bench(case.wire, case.direction)), loaded.cuts
    )
    for law in LAWS:
        if loaded.law in (None, law.number):
            law.judges(trial)


def test_scenes_that_broke_a_law_break_none() -> None:
    """Every scene that the long profile kept is asked of its law again."""
    for path in sorted(kept.FAILURES.glob("*.json")):
        replay(path)


def test_a_scene_that_breaks_a_law_is_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A failing scene is written, small; it breaks the law again, and none once that is mended."""
    case = next(one for one in CASES if str(one) == "minihubo_adc-any")
    is_broken = True

    def judges(trial: laws.Trial) -> None:
        if is_broken and len(trial.scene) > 8:
            trial.fail(3, "more than 8 bytes")

    law = dataclasses.replace(LAWS[2], judges=judges)
    monkeypatch.setattr(sys.modules[__name__], "LAWS", (law,))
    monkeypatch.setattr(sys.modules[__name__], "_examples", lambda case: 100)
    with pytest.raises(laws.LawError):
        _holds([law], case, tmp_path)
    (path,) = tmp_path.glob("*.json")
    with pytest.raises(laws.LawError):
        replay(path)
    assert len(load_scene(path).traffic) == 9
    is_broken = False
    replay(path)


def test_every_registered_protocol_is_tested() -> None:
    """The cases hold every dialect, configuration and direction of every registered protocol."""
    tested = {(v.name, v.dialect, v.configuration) for case in CASES for v in laws.wire_variants(case.wire)}
    assert REGISTERED
    for protocol in REGISTERED.values():
        for dialect in protocol.dialects or [None]:
            for configuration in protocol.configurations or [None]:
                assert (protocol.name, dialect, configuration) in tested
    for case in CASES:
        (variant,) = laws.wire_variants(case.wire)
        ways: set[laws.Way] = {c.direction for c in CASES if c.wire is case.wire}
        heard = {m.name for way in ways for m in variant.messages_for(way)}
        assert heard == set(variant.messages), f"{variant}: no direction has {set(variant.messages) - heard}"


@pytest.mark.parametrize("name", ["hubo", "can_corners", "j1939_like"])
def test_python_can_messages_are_frames(name: str) -> None:
    """A scanner hears the same in python-can's messages as in `Frame`s, and takes impossible ones calmly."""
    variant = PROTOCOLS[name].variant()
    for seed in range(1, 12):
        (scene,) = drawn_arguments(LAWS[0], variant, None, seed)
        messages = [
            can.Message(
                timestamp=frame.timestamp or 0.0,
                arbitration_id=frame.arbitration_id,
                is_extended_id=frame.is_extended_id,
                is_remote_frame=frame.is_remote_frame,
                is_error_frame=frame.is_error_frame,
                is_fd=frame.is_fd,
                channel=frame.channel,
                data=None if frame.is_remote_frame else frame.data,
                dlc=frame.dlc,
                is_rx=frame.is_rx is not False,
            )
            for frame in scene.traffic
        ]
        frames = [msgspec.structs.replace(frame, timestamp=frame.timestamp or 0.0) for frame in scene.traffic]
        alike = Scene(tuple(frames), (), scene.sent_at)
        wanted = laws.scanned_items(laws.scanner_of(variant, None), alike)
        assert (
            laws.scanned_items(laws.scanner_of(variant, None), Scene(messages, (), scene.sent_at)) == wanted
        )
    scanner = make_scanner([variant], include_unknown=True)
    odd = [
        can.Message(arbitration_id=1, dlc=8),
        can.Message(arbitration_id=0x1FFFFFFF, dlc=64, is_fd=True, data=[0] * 64),
    ]
    odd[0].data = bytearray(20)
    assert len(scanner.feed(odd)) == 2
