"""MiniHubo crouches and rises, by a table of phases with equations and guarded transitions that draws itself.

It waits, bends its knees until a hip is beyond 1.2 rad, rises until it is below 0.02 rad (a servo rests within two counts of
its goal), and begins again. It ends when somebody lifts its right arm, whose servo is not switched on.

After the original's demonstration (miniSM): 15 Hz, 0.02 rad a tick; there it waited 5 s, here 0.5 s.
"""

from __future__ import annotations

from aces_bus import load_robot
from aces_bus.controller import Phase, StateMachine, Transition
from aces_bus.robot import run_virtual
from aces_devices.robotis_rx.driver import STEP

BEND = """
    LHP[0] = a
    LKP[0] = 2*a
    LAP[0] = a
    RHP[0] = a
    RKP[0] = 2*a
    RAP[0] = a
"""


def crouching() -> StateMachine:
    """Return the table as a state machine."""
    return StateMachine(
        "crouch",
        rate_hz=15,
        memory={"a": 0.0},
        phases=[
            Phase("wait"),
            Phase("crouch", each="a += 0.02" + BEND),
            Phase("rise", each="a = max(0, a - 0.02)" + BEND),
            Phase("stand", each="a = max(0, a - 0.02)" + BEND),
            Phase("done", final=True),
        ],
        table=[
            Transition("wait", "crouch", after_s=0.5),
            Transition("crouch", "rise", "LHP[0] > 1.2"),
            Transition("rise", "crouch", "LHP[0] < 0.02"),
            Transition("crouch", "stand", "RSP[0] > 0.3"),
            Transition("rise", "stand", "RSP[0] > 0.3"),
            Transition("stand", "done", "LHP[0] < 0.02"),
        ],
    )


def main() -> None:
    machine = crouching()
    print(machine.mermaid())
    run = run_virtual(load_robot("minihubo_2"), [machine], rate_hz=15)
    with run:
        run.do("enable", devices=machine.writes)
        shoulder = run.rig.robot.joint("RSP")
        servo = run.world.twins[shoulder.device]

        def is_over() -> bool:
            if run.seconds > 10:  # somebody lifts the arm: 0.5 rad, in the servo's counts
                servo.motion.at = (shoulder.direction * 0.5 + (shoulder.zero or 0.0)) / STEP
            return machine.mode == "done"

        ended = run.run(60.0, until=is_over)
    for instant, source, target in machine.trail:
        print(f"{machine.seconds(instant):6.2f} s  {source} → {target}")
    end = ", ".join(ended.tripped.values()) or "nothing went wrong"
    print(f"{machine.phase} after {ended.seconds:.1f} s; {machine.transitions} transitions; {end}")


if __name__ == "__main__":
    main()
