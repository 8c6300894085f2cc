"""The one door of set-points: each kind of writer is held to each rule, by what is heard on the bus."""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest

from tests.robot.leg import COUNTS, MS, RATE, WRITERS, Leg, check_sent

# ---------------------------------------------------------------------- each writer against each rule


def within_limits(writer: str) -> None:
    """900 ends at the limit, -900 at the other, to the count, and that is said."""
    with Leg() as leg:
        for wanted, limit in ((900.0, 1.0), (-900.0, -1.0)):
            leg.write(writer, "HIP", wanted)
            leg.pass_time(0.7)
            assert leg.sent("HIP")[-1][1] == pytest.approx(limit, abs=2 / COUNTS)
            assert leg.run.rig["HIP"].value == pytest.approx(limit, abs=0.01)
        assert {"limited", "clipped"} & {event.kind for event in leg.run.events}
        assert check_sent(leg) > 400


def within_the_rate(writer: str) -> None:
    """0.8 rad at 4 rad/s takes 0.2 s, all the way at that rate, and ends at the set-point."""
    with Leg() as leg:
        start = leg.run.clock.now() / 1e9
        begin = leg.sent("HIP")[-1][1]
        leg.write(writer, "HIP", 0.8)
        leg.pass_time(0.3)
        sent = [(at, value) for at, value in leg.sent("HIP") if at >= start]
        arrived = next(at for at, value in sent if value >= 0.8 - 2 / COUNTS)
        assert arrived - start == pytest.approx((0.8 - begin) / RATE, abs=0.02)
        assert sent[-1][1] == pytest.approx(0.8, abs=2 / COUNTS)
        check_sent(leg)


def finite(writer: str) -> None:
    """What is not a finite number does not leave and is counted; five in a row trip, and the board is off."""
    with Leg() as leg:
        leg.write(writer, "HIP", 0.1)
        leg.pass_time(0.3)
        at_rest = leg.sent("HIP")[-1][1]
        for _ in range(4):
            leg.write(writer, "HIP", math.nan if writer != "controller" else 0.1)
        if writer == "controller":
            leg.walk.wishes["HIP"] = math.nan
            leg.pass_time(0.018)
        assert not leg.motor_is_off()
        assert leg.run.rig.door.tripped == {}
        leg.write(writer, "HIP", math.inf)
        leg.pass_time(0.1)
        assert leg.motor_is_off()
        assert any("5 set-points in a row were not finite" in str(event) for event in leg.run.events)
        assert leg.sent("HIP")[-1][1] == at_rest
        leg.write(writer, "HIP", 0.5)
        leg.pass_time(0.1)
        assert leg.sent("HIP")[-1][1] == at_rest
        assert leg.refused


def one_owner(writer: str) -> None:
    """What a controller owns under one name no other writer moves under any; both are named."""
    with Leg(owner="arm") as leg:
        leg.pass_time(0.02)
        leg.write(writer, "HIP", 0.5)
        leg.pass_time(0.2)
        assert leg.sent("HIP")[-1][1] == leg.sent("HIP")[0][1]
        (said,) = {one for one in leg.refused if "HIP.position" in one}
        assert "arm" in said
        assert (
            writer not in ("controller", "udp", "zenoh") or {"controller": "walk"}.get(writer, writer) in said
        )
        leg.write("udp", "KNEE", 0.5)  # what is free can be moved
        leg.pass_time(0.5)
        if writer != "controller":
            assert leg.sent("KNEE")[-1][1] == pytest.approx(0.5, abs=2 / COUNTS)


def follows(writer: str) -> None:
    """A joint that is held up, on a board that says nothing of it, is found by where it is; the board is off."""
    with Leg() as leg:
        for fault in ("jam", "no_errors"):
            leg.run.world.twins["JMC0"].fault(fault, 1)
        leg.write(writer, "HIP", 0.15)
        leg.pass_time(0.7)
        assert not leg.motor_is_off()  # within the bound
        began = leg.run.clock.now()
        leg.write(writer, "HIP", 0.9)
        leg.run.clock.wait(leg.motor_is_off, 2_000 * MS)
        assert leg.run.clock.now() - began < 1_100 * MS
        leg.pass_time(0.02)
        (event,) = (one for one in leg.run.events if one.kind == "following error")
        assert event.source == "JMC0"
        assert event.detail.startswith("HIP.position stays at ")
        assert leg.run.supervisors[0].reason.startswith("JMC0: following error")
        leg.write(writer, "HIP", 0.2)
        assert leg.refused


RULES = (within_limits, within_the_rate, finite, one_owner, follows)


@pytest.mark.parametrize("rule", RULES, ids=lambda rule: rule.__name__)
@pytest.mark.parametrize("writer", WRITERS)
def test_a_writer_and_a_rule(writer: str, rule: Callable[[str], None]) -> None:
    """Every writer is held to every rule."""
    rule(writer)
