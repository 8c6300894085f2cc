"""The nine laws on every registered protocol × dialect × shipped configuration × direction, and on the specs of the tests.

The examples of a protocol are shared among its cases, so that a protocol of many dialects costs no more than one of one:
`EXAMPLES` a law and protocol in the short profile, `ACES_EXAMPLES` in the long one. For hundreds of thousands of examples
of one protocol there is `aces fuzz`.
"""

from __future__ import annotations

from typing import Any

import can
import msgspec
import pytest
from hypothesis import HealthCheck, Phase, given, settings

from aces_bus.protocol import make_scanner
from aces_bus.testing import laws, strategies
from aces_bus.testing._source import spread
from aces_bus.testing.laws import LAWS, Law
from tests.laws.wires import CASES, MIXED, PROTOCOLS, REGISTERED, Case

#: Examples a law and protocol in the short profile; each is a wire of some hundred bytes or some dozens of frames.
EXAMPLES = 10
#: All but the explanation, which runs a failing scene a hundred times more.
PHASES = (Phase.explicit, Phase.reuse, Phase.generate, Phase.shrink)


def _examples(case: Case) -> int:
    profile = settings()
    wanted = profile.max_examples if profile.max_examples > 100 else EXAMPLES
    return max(2, wanted // case.share)


@pytest.mark.parametrize("case", [*CASES, *MIXED], ids=str)
@pytest.mark.parametrize("law", LAWS, ids=str)
def test_law_holds(law: Law, case: Case) -> None:
    """Whatever comes over the wire, the law holds."""
    if law.streams_only and laws.variants_of(case.wire)[0].link == "can":
        pytest.skip("a law of streams")

    @settings(
        max_examples=_examples(case),
        suppress_health_check=(HealthCheck.too_slow, HealthCheck.data_too_large),
        phases=PHASES,
        print_blob=False,
    )
    @given(strategies.arguments(law, case.wire, case.direction))
    def holds(arguments: tuple[Any, ...]) -> None:
        law.holds(case.wire, case.direction, *arguments)

    holds()


def test_every_registered_protocol_is_tested() -> None:
    """The cases hold every dialect, configuration and direction of every registered protocol."""
    tested = {(v.name, v.dialect, v.configuration) for case in CASES for v in laws.variants_of(case.wire)}
    assert REGISTERED
    for protocol in REGISTERED.values():
        for dialect in protocol.dialects or [None]:
            for configuration in protocol.configurations or [None]:
                assert (protocol.name, dialect, configuration) in tested
    for case in CASES:
        (variant,) = laws.variants_of(case.wire)
        ways: set[laws.Way] = {c.direction for c in CASES if c.wire is case.wire}
        heard = {m.name for way in ways for m in variant.facing(way)}
        assert heard == set(variant.messages), f"{variant}: no direction has {set(variant.messages) - heard}"


@pytest.mark.parametrize("name", ["hubo", "can_corners", "j1939_like"])
def test_python_can_messages_are_frames(name: str) -> None:
    """A scanner hears the same in python-can's messages as in `Frame`s, and takes impossible ones calmly."""
    variant = PROTOCOLS[name].variant()
    for seed in range(1, 12):
        (scene,) = laws.draw_arguments(LAWS[0], variant, None, spread(seed))
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
            for frame in scene.words
        ]
        frames = [msgspec.structs.replace(frame, timestamp=frame.timestamp or 0.0) for frame in scene.words]
        alike = laws.Scene(tuple(frames), (), scene.sent_at)
        wanted = laws.heard(laws.scanner_of(variant, None), alike)
        assert laws.heard(laws.scanner_of(variant, None), laws.Scene(messages, (), scene.sent_at)) == wanted
    scanner = make_scanner([variant], everything=True)
    odd = [
        can.Message(arbitration_id=1, dlc=8),
        can.Message(arbitration_id=0x1FFFFFFF, dlc=64, is_fd=True, data=[0] * 64),
    ]
    odd[0].data = bytearray(20)
    assert len(scanner.feed(odd)) == 2
