"""Logs of `aces run` and `aces teleop` as a LeRobotDataset: `python -m lerobot_robot_aces.convert LOG… --root FOLDER`.

1. A log is an episode. Its rows are resampled to the dataset's rate: of each instant the newest row.
2. An observation is where joints are, an action their set-points; rows without one of them (before the first set-point,
   after a value has become unknown) are left out and counted.
3. LeRobot writes the dataset (`LeRobotDataset.create`): its format is LeRobot's own affair.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from typing import Any

import numpy as np


def frames_of(
    path: str, joints: Sequence[str], fps: float
) -> tuple[list[tuple[list[float], list[float]]], int]:
    """Return (positions, set-points) of a log at `fps`, and how many instants were left out."""
    from aces_bus.controller.log import read_log

    log = read_log(path)
    times = np.asarray(log.time_s, dtype=float)
    if not len(times):
        return [], 0
    instants = np.arange(times[0], times[-1] + 0.5 / fps, 1.0 / fps)
    rows = np.clip(np.searchsorted(times, instants + 1e-9, side="right") - 1, 0, None)
    found: list[tuple[list[float], list[float]]] = []
    left_out = 0
    for row in rows:
        state = [float(log[name][row]) for name in joints]
        action = [float(log[f"{name}.setpoint"][row]) for name in joints]
        if all(map(math.isfinite, (*state, *action))):
            found.append((state, action))
        else:
            left_out += 1
    return found, left_out


def joints_of(path: str) -> list[str]:
    """Return the joints of a log that have set-points."""
    from aces_bus.controller.log import read_log

    names = list(read_log(path).names)
    return [name for name in names if f"{name}.setpoint" in names]


def convert(
    logs: Sequence[str], root: str, repo_id: str, *, fps: int, task: str, robot: str
) -> tuple[int, int]:
    """Write a dataset of these logs; return how many frames it has and how many were left out."""
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    from aces_bus.errors import CallerError

    joints = joints_of(logs[0])
    if not joints:
        raise CallerError(f"{logs[0]} has no joint with its set-points: --log FILE of aces teleop has them")
    names = [f"{name}.pos" for name in joints]
    vector = {"dtype": "float32", "shape": (len(joints),), "names": names}
    dataset: Any = LeRobotDataset.create(
        repo_id,
        fps,
        root=root,
        robot_type=robot,
        features={"observation.state": vector, "action": dict(vector)},
        use_videos=False,
    )
    number = left_out = 0
    for path in logs:
        frames, missing = frames_of(path, joints, fps)
        left_out += missing
        for state, action in frames:
            dataset.add_frame(
                {
                    "observation.state": np.array(state, dtype=np.float32),
                    "action": np.array(action, dtype=np.float32),
                    "task": task,
                }
            )
        if frames:
            dataset.save_episode()
            number += len(frames)
    if hasattr(dataset, "finalize"):
        dataset.finalize()
    return number, left_out


def main(words: Sequence[str] | None = None) -> int:
    """Run the command line; return its exit status."""
    parser = argparse.ArgumentParser(prog="python -m lerobot_robot_aces.convert", description=__doc__)
    parser.add_argument(
        "logs", nargs="+", metavar="LOG", help="logs of aces run or aces teleop, an episode each"
    )
    parser.add_argument("--root", required=True, help="the folder of the dataset; must not exist")
    parser.add_argument("--repo-id", default="aces/recorded", help="the dataset's name")
    parser.add_argument("--fps", type=int, default=30, help="frames a second")
    parser.add_argument("--task", default="teleoperation", help="what was done, in words")
    parser.add_argument("--robot", default="aces", help="the robot's name in the dataset")
    asked = parser.parse_args(words)
    number, left_out = convert(
        asked.logs, asked.root, asked.repo_id, fps=asked.fps, task=asked.task, robot=asked.robot
    )
    print(f"episodes={len(asked.logs)} frames={number} left_out={left_out}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
