"""The complete Hubo 2+ in virtual time: 38 joints on 18 boards, 7 sensors, two CAN buses of 1 Mbit/s, 200 cycles a second.

It homes, enables, and follows a sine with all joints that have references; fingers and neck, which have none in any program
that drove the robot, are given duties. Printed: what the buses carried, and what it would have cost to send one frame for
each thing that is wanted.
"""

from __future__ import annotations

import math
import sys

from msgspec.structs import replace

from aces_bus import load_robot
from aces_bus.device import Robot
from aces_bus.robot import VirtualRobot

RATE = 200.0


def complete() -> Robot:
    """Hubo 2+ with its neck, which no program's table has active: it is polled, and driven by duty."""
    robot = load_robot("hubo2plus")
    neck = {"EJMC2": replace(robot.devices["EJMC2"], active=True)}
    joints = {
        name: replace(joint, active=True, command="duty", max_duty=100.0)
        for name, joint in robot.joints.items()
        if joint.device == "EJMC2"
    }
    return replace(robot, devices={**robot.devices, **neck}, joints={**robot.joints, **joints})


def main(seconds: float = 3.0, *, home: bool = True) -> dict[str, float]:
    robot = complete()
    joints = [joint for joint in robot.joints.values() if joint.active]
    boards = {joint.device for joint in joints}
    sensors = [sensor for sensor in robot.sensors.values() if sensor.active]
    print(
        f"{robot.name}: {len(joints)} joints on {len(boards)} boards, {len(sensors)} sensors, {len(robot.buses)} buses"
    )
    with VirtualRobot(robot, rate_hz=RATE) as hubo:
        rig = hubo.rig
        if home:
            rig.each("home").wait(120)
            print(f"homed after {hubo.clock.now() / 1e9:.1f} s")
        rig.each("enable").wait(30)
        hubo.advance(0.2)
        begun = hubo.clock.now()
        before = {name: (host.counts.set_points, host.counts.polls) for name, host in rig.hosts.items()}
        for wire in hubo.wires.values():
            wire.load.busy_ns, wire.load.since, wire.load.frames = 0, begun, 0
        for host in rig.hosts.values():
            host.counts.cycle_ns = 0
        worst = 0.0
        for cycle in range(round(seconds * RATE)):
            t = cycle / RATE
            for joint in joints:
                if joint.command == "duty":
                    hubo[f"{joint.name}.duty"].set(10.0 * math.sin(2 * math.pi * 0.5 * t))
                else:
                    middle = ((joint.lower or 0.0) + (joint.upper or 0.0)) / 2
                    wanted = middle + 0.1 * math.sin(2 * math.pi * 0.5 * t) - middle * math.exp(-t)
                    hubo[f"{joint.name}.position"].set(wanted)
                    if t > 1.0:
                        worst = max(worst, abs(hubo[f"{joint.name}.position"].value - wanted))
            hubo.advance(1 / RATE)
        cycles = round(seconds * RATE)
        frames = sum(
            host.counts.set_points - before[name][0] + host.counts.polls - before[name][1]
            for name, host in rig.hosts.items()
        )
        motor = sum(
            turn.device.config.driver == "hubo_motor" and turn.poll.every_s is None
            for host in rig.hosts.values()
            for turn in host.slots
        )
        sent = (
            sum(host.counts.set_points - before[name][0] for name, host in rig.hosts.items()) / cycles + motor
        )
        alone = 2 * len(joints)  # a reference and an encoder request for each joint
        for name, host in rig.hosts.items():
            wire = hubo.wires[name]
            print(
                f"{name}: load {wire.load.ratio(hubo.clock.now()):.1%}, {wire.load.frames / cycles:.1f} frames a cycle,"
                f" worst answer {host.counts.latency_ns / 1e6:.2f} ms, worst cycle {host.counts.cycle_ns / 1e6:.2f} ms"
            )
        print(f"requests of all kinds: {frames / cycles:.1f} a cycle")
        print(
            f"joints: {sent:.1f} frames a cycle where one for each thing would be {alone}: {sent / alone:.2f}"
        )
        print(f"furthest from its set-point: {worst:.3f} rad")
        missed = sum(host.counts.missed for host in rig.hosts.values())
        print(
            f"unanswered: {missed}; events: {', '.join(sorted({event.kind for event in hubo.events.last})) or 'none'}"
        )
        return {"ratio": sent / alone, "missed": missed, "worst_rad": worst}


if __name__ == "__main__":
    main(float(sys.argv[1]) if len(sys.argv) > 1 else 3.0)
