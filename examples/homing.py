"""Hubo 2 finds its homes: force sensors are nulled, then limbs search in parallel, joint after joint.

A joint's driver tries its search twice (legs, waist) or three times (arms). What still fails is a failure of the phase: it
is reported by name, nothing behind it begins, and an operator may mend it and have the phase tried again.
Here the right knee's switch does not close until somebody plugs it in; the left elbow's is a loose contact.

The order: acesHubo autoZero.osd. There the step after the ankles looked at the hips twice, and a failure at the waist had
no way out; both are not repeated here.
"""

from __future__ import annotations

from collections.abc import Callable

from aces_bus import load_robot
from aces_bus.device import Device, Job, Steps, together
from aces_bus.errors import AcesError
from aces_bus.robot import VirtualRobot

#: Each phase with its limbs; limbs search together, the joints of a limb one after the other.
PHASES: dict[str, list[str]] = {
    "hips and ankles": ["LHY LHR", "LAP LAR", "RHY RHR", "RAP RAR"],
    "hip pitch and knees": ["LHP LKP", "RHP RKP"],
    "arms": ["LSP LSR", "LSY LEP", "RSP RSR", "RSY REP"],
    "waist": ["WST"],
}
WORKS_AGAIN = 5_000_000_000  # ns
#: Force sensors, and how often each is nulled.
SENSORS = {"FT_LF": 3, "FT_RF": 3, "FT_RH": 1}


class Homing:
    """The sequence. `state` is the phase, "failed: …", or "ready"; `say` gets each change, `mend` each failure."""

    def __init__(self, robot: VirtualRobot, say: Callable[[str], None], mend: Callable[[str], bool]) -> None:
        self.robot, self.say, self.mend = robot, say, mend
        self.state = "new"

    def enter(self, state: str) -> None:
        self.state = state
        self.say(state)

    def start(self) -> Job:
        """Begin; the job is over when the robot is ready, or has failed."""
        return Job(self.robot.clock, "homing", self.steps)

    def steps(self, job: Job) -> Steps:
        self.enter("nulling")
        for name, times in SENSORS.items():
            for _ in range(times):
                yield self.robot.rig.device(name).null()  # type: ignore[attr-defined]
        for phase, limbs in PHASES.items():
            self.enter(phase)
            left = [limb.split() for limb in limbs]
            while True:
                try:
                    yield together(self.robot.clock, phase, [self.limb(joints) for joints in left])
                    break
                except AcesError as error:
                    self.enter(f"failed: {error}")
                    left = [joints for joints in left if joints]  # those that are not home yet
                    if not self.mend(str(error)):
                        raise
                    self.enter(f"{phase}, again")
        self.enter("switching on")
        boards = {
            self.board(name).name: self.board(name)
            for limbs in PHASES.values()
            for name in " ".join(limbs).split()
        }
        yield together(self.robot.clock, "enable", [board.enable() for board in boards.values()])  # type: ignore[attr-defined]
        self.enter("ready")

    def board(self, joint: str) -> Device:
        return self.robot.rig.device(joint)

    def limb(self, joints: list[str]) -> Job:
        """Joint after joint; each is struck off the list when it is home."""

        def steps(job: Job) -> Steps:
            while joints:
                board = self.board(joints[0])
                search = board.home(self.robot.robot.joint(joints[0]).name)  # type: ignore[attr-defined]
                yield search
                if "try 1" not in search.text:
                    self.say(f"{search.text}: found")
                joints.pop(0)

        return Job(self.robot.clock, " ".join(joints), steps)


def main() -> list[str]:
    # Without a rate nothing is polled; a board is asked while it searches.
    robot = VirtualRobot(load_robot("hubo2"))
    knee, elbow = robot.twins["JMC2"], robot.twins["JMC11"]
    said: list[str] = []

    def say(state: str) -> None:
        said.append(state)
        print(f"{robot.clock.now() / 1e9:7.2f} s  {state}")
        if state == "arms":  # a loose contact, for so long
            robot.clock.call_in(WORKS_AGAIN, lambda: elbow.fault("no_switch", on=False))

    def mend(error: str) -> bool:
        knee.fault("no_switch", on=False)
        return "RKP" in error

    with robot:
        knee.fault("no_switch")
        elbow.fault("no_switch", 2)
        Homing(robot, say, mend).start().wait(120)
        now = robot.clock.now()
        homed = [
            robot.robot.joint(name).name for limbs in PHASES.values() for name in " ".join(limbs).split()
        ]
        worst = max(abs(robot.simulation.world.joints[name].position(now)) for name in homed)
        print(f"{len(homed)} joints, at most {worst:.4f} rad from their true zeros")
    return said


if __name__ == "__main__":
    main()
