"""SO-101: the follower goes where the leader is moved by hand, at 100 Hz.

The leader's torque stays off; its positions are the follower's set-points, which leave by the rig's door: a follower that is
elsewhere is led there at its largest speed. Here, in virtual time, the hand is simulated, too:

    python examples/teleoperation.py [SECONDS]

The same controller, on two real arms (it moves the follower):

    aces run -r so101 examples/teleoperation.py:follow --bus follower=/dev/ttyACM0 --bus leader=/dev/ttyACM1 --tx
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from math import isfinite, pi, sin

from aces_bus import load_robot
from aces_bus.controller import controller
from aces_bus.robot import VirtualRobot, run_virtual
from aces_bus.state import State
from aces_devices.feetech import FeetechTwin

SO101 = load_robot("so101")
JOINTS = tuple(name for name in SO101.joints if not name.startswith("leader_"))


@controller(rate_hz=100, states=[f"leader_{name}" for name in JOINTS], writes=JOINTS)
def follow(states: Mapping[str, State]) -> Mapping[str, float]:
    """Each joint to where the leader's is (rad); one whose leader is not known stays where it was sent."""
    wanted = {name: states[f"leader_{name}"][0] for name in JOINTS}
    return {name: position for name, position in wanted.items() if isfinite(position)}


def hand(name: str, t: float) -> float:
    """Return the angle to which a hand has moved a joint of the leader after `t` seconds (rad): to and fro,
    each joint at its own pace.
    """
    joint = SO101.joint(name)
    assert joint.lower is not None
    assert joint.upper is not None
    middle, reach = (joint.lower + joint.upper) / 2, (joint.upper - joint.lower) / 2
    return middle + 0.5 * reach * sin(2 * pi * t / (4 + JOINTS.index(name) / 2))


class Hand:
    """Moves the leader's twins 200 times a second; notes how far from them the follower is, and how old its goals are."""

    name, rate_hz, states = "hand", 200.0, ()

    def __init__(self, twins: Mapping[str, FeetechTwin], now: Callable[[], int]) -> None:
        self.leader = {name: twins[SO101.joint(f"leader_{name}").device] for name in JOINTS}
        self.follower = {name: twins[SO101.joint(name).device] for name in JOINTS}
        self.now = now
        self.began = now()
        self.worst = 0.0

    def bind(self, states: Mapping[str, State]) -> None:
        """Nothing is read by way of states."""

    def start(self, now: int) -> None:
        """Make the first movement due now."""

    def step(self, now: int) -> None:
        """One movement, and where the follower is."""
        t = (self.now() - self.began) / 1e9
        for name, twin in self.leader.items():
            twin.turn_by_hand(hand(name, t))
            if t > 1.0:  # by then it has come
                gap = abs(self.follower[name].position(self.now()) - hand(name, t))
                self.worst = max(self.worst, gap)

    def stop(self, now: int) -> None:
        """Take the hand away."""


def main(arguments: Sequence[str]) -> float:
    """Return the follower's worst distance from the leader (rad)."""
    seconds = float(arguments[0]) if arguments else 5.0
    pose = {f"leader_{name}": hand(name, 0.0) for name in JOINTS}
    arms = VirtualRobot(SO101, rate_hz=follow.rate_hz, pose=pose)
    twins = {name: twin for name, twin in arms.twins.items() if isinstance(twin, FeetechTwin)}
    moving = Hand(twins, arms.clock.now)
    with run_virtual(arms, [follow], loggers=[moving]) as run:
        run.do("enable", devices=run.driven(run.supervisors[0]))
        moving.began = run.clock.now()
        ended = run.run(seconds)
    print(
        f"{ended.seconds:.1f} s, {run.set_points} set-points, the follower within {moving.worst:.3f} rad of the leader"
    )
    for name, host in run.rig.hosts.items():
        print(f"{name}: {host.counts.ticks} ticks, {host.counts.missed} unanswered")
    print(", ".join(ended.tripped.values()) or "nothing went wrong")
    return moving.worst


if __name__ == "__main__":
    main(sys.argv[1:])
