"""MiniHubo crouches and rises, by a table: phases with equations, guarded transitions, and whatever goes wrong in one row.

It waits, bends its knees until a hip is beyond 1.2 rad, rises until it is below 0.01 rad, and begins again; it ends when
somebody lifts its right arm, whose servo is not switched on. The table prints itself as a diagram.

After the original's state-machine demonstration (miniSM): 15 Hz, 0.02 rad a tick, 5 s of waiting (here 0.5 s).
"""

from __future__ import annotations

from aces_bus.assembly import run_virtual
from aces_bus.controller import Phase, Row, StateMachine
from aces_devices.robots import load_robot

BEND = """
    LHP[0] = a
    LKP[0] = 2*a
    LAP[0] = a
    RHP[0] = a
    RKP[0] = 2*a
    RAP[0] = a
"""


def crouching() -> StateMachine:
    """The table."""
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
            Row("wait", "crouch", after_s=0.5),
            Row("crouch", "rise", "LHP[0] > 1.2"),
            Row("rise", "crouch", "LHP[0] < 0.01"),
            Row("crouch", "stand", "RSP[0] > 0.3"),
            Row("rise", "stand", "RSP[0] > 0.3"),
            Row("stand", "done", "LHP[0] < 0.01"),
        ],
    )


def main() -> None:
    machine = crouching()
    print(machine.mermaid())
    run = run_virtual(load_robot("minihubo_2"), [machine])
    with run:
        run.do("enable", devices=[run.rig.device(name) for name in machine.writes])
        arm = run.world.twins[run.rig.device("RSP").name]

        def is_over() -> bool:
            if run.seconds > 10 and machine.phase == "crouch":  # somebody lifts the arm
                arm.motion.at = arm.at_joint(0.5)
            return machine.mode == "done"

        ended = run.run(60.0, until=is_over)
    for instant, source, target in machine.trail:
        print(f"{(instant - run.began) / 1e9:6.2f} s  {source} → {target}")
    print(f"{machine.phase} after {ended.seconds:.1f} s; {machine.transitions} transitions; {ended.tripped or 'no trips'}")


if __name__ == "__main__":
    main()
