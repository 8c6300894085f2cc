"""`--foxglove`: what sniff, run, sim and play show live, how wrong calls are answered, and how it ends."""

from __future__ import annotations

import contextlib
import itertools
import json
import os
import re
import resource
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Generator, Sequence
from pathlib import Path
from typing import Any

import pytest

from tests.access.viewing import WAIT_S, Viewer, free_port
from tests.tools.conftest import Aces
from tests.tools.live import Node, Opened

pytest.importorskip("foxglove")
pytest.importorskip("websockets")

HUBO = Path(__file__).parents[2] / "examples" / "captures" / "hubo2plus.log"


class Looker(threading.Thread):
    """A viewer beside a command of this process, until the command ends."""

    def __init__(self, port: int, ready: Callable[[Viewer], object]) -> None:
        super().__init__(daemon=True)
        self.viewer = Viewer(f"ws://127.0.0.1:{port}")
        self._ready = ready
        self.start()

    def run(self) -> None:
        """Look on."""
        with self.viewer as viewer:
            self._ready(viewer)
            viewer.to_the_end()

    def messages(self, topic: str) -> list[dict[str, Any]]:
        """What came on a topic."""
        self.join(WAIT_S)
        return [message for _, message in self.viewer.messages[topic]]


@pytest.mark.slow
def test_play_shows_a_recording_without_sending_it() -> None:
    """Records at the recording's own times; no bus, no --tx."""
    port = free_port()
    looker = Looker(port, lambda viewer: None)
    process = subprocess.Popen(
        [
            sys.executable,
            "-m",
            "aces_tools",
            "play",
            HUBO,
            "-p",
            "hubo",
            "--foxglove",
            str(port),
            "--loop",
            "0",
        ],
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        for _ in range(600):
            if looker.viewer.has("/hubo/Encoder", 20):
                break
            threading.Event().wait(0.1)
        process.send_signal(signal.SIGINT)
        _, said = process.communicate(timeout=WAIT_S)
    finally:
        process.kill()
    assert process.returncode == 0, said
    assert "nothing was sent" in said
    assert "sent=0" in said
    assert looker.messages("/hubo/Encoder")[0]["position"]
    assert 1000 < looker.viewer.messages["/hubo/Encoder"][0][0] / 1e9 < 1001


@pytest.mark.slow
def test_sniff_shows_what_it_prints(aces: Aces, monkeypatch: pytest.MonkeyPatch) -> None:
    """What filters let pass, also with -q; frames without a protocol are on /_lost."""
    opened, node, port = Opened(monkeypatch), Node(), free_port()
    looker = Looker(
        port,
        lambda viewer: viewer.until(
            lambda: viewer.has("/hubo/Encoder", 2), lambda: node.send(0x063, "78000000FCFFFFFF")
        ),
    )

    def end() -> None:
        for _ in range(600):
            if looker.viewer.has("/hubo/Encoder", 2):
                break
            threading.Event().wait(0.1)
        os.kill(os.getpid(), signal.SIGINT)

    opened.then(end)
    made = aces("sniff", *node.options, "-p", "hubo", "-q", "--foxglove", str(port), "--where", "board=3")
    opened.join()
    node.close()
    assert made.status == 0
    assert made.out == ""
    assert looker.messages("/hubo/Encoder")[0]["position"] == [120, -4]
    assert "/hubo/SendEncoder" not in looker.viewer.channels


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (("sim", "-r", "minihubo_1", "--foxglove", "nine"), "--foxglove nine: write PORT or HOST:PORT"),
        (
            ("run", "-r", "minihubo_1", "--virtual", "--foxglove", "wave.py"),
            "before other words --foxglove=8765",
        ),
        (("sniff", "-i", "virtual", "-c", "x", "--foxglove-origin", "http://a"), "is for --foxglove: add it"),
        (("play", str(HUBO), "-p", "hubo"), "-p is for a live view (--foxglove)"),
    ],
)
def test_wrong_calls(aces: Aces, call: tuple[str, ...], said: str) -> None:
    """One line, and status 2."""
    made = aces(*call)
    assert made.status == 2
    assert len(made.messages) == 1
    assert said in made.messages[0]


def test_a_port_that_is_taken_ends_a_command_before_it_touches_a_bus(aces: Aces) -> None:
    """Status 2, the port, and another one."""
    import socket

    with socket.create_server(("127.0.0.1", 0)) as one:
        port = one.getsockname()[1]
        made = aces("sim", "-r", "minihubo_1", "--foxglove", str(port))
    assert made.status == 2
    assert made.messages == [
        f"live view: 127.0.0.1:{port} cannot be served (Address already in use); another port is free, such as {port + 1}"
    ]


@pytest.mark.slow
def test_who_else_can_look_is_said(aces: Aces) -> None:
    """An address that is not this machine's own warns, also with -q."""
    made = aces("play", HUBO, "-p", "hubo", "-q", "--foxglove", f"0.0.0.0:{free_port()}")
    assert made.status == 0
    assert made.messages[0].startswith("live view: every program that reaches 0.0.0.0 sees it")


LAYOUT = HUBO.parents[1] / "foxglove" / "robot.json"


def test_the_layout_is_one_of_foxglove() -> None:
    """Each panel is placed once, and has settings that foxglove-sdk knows of its kind.

    *Source* of the file's shape: layouts that Foxglove and Lichtblick export (configById, globalVariables, userNodes,
    playbackConfig, layout); the SDK's own layouts have another shape around the same settings."""
    from foxglove import layouts

    kinds: dict[str, Any] = {
        "3D": layouts.ThreeDeeConfig(),
        "Plot": layouts.PlotConfig(),
        "StateTransitions": layouts.StateTransitionsConfig(),
        "RosOut": layouts.LogConfig(),
        "RawMessages": layouts.RawMessagesConfig(),
    }
    inner: dict[str, Any] = {
        "cameraState": layouts.ThreeDeeCameraState(),
        "publish": layouts.ThreeDeePublishSettings(),
        "scene": layouts.BaseRendererSceneSettings(),
    }
    paths: dict[str, Any] = {"Plot": layouts.PlotSeries, "StateTransitions": layouts.StateTransitionsSeries}

    def check(given: dict[str, Any], known: Any, *others: str) -> None:
        assert set(given) <= {*known._to_dict(), *others}

    made = json.loads(LAYOUT.read_text())
    assert set(made) == {"configById", "globalVariables", "userNodes", "playbackConfig", "layout"}
    for name, config in made["configById"].items():
        kind = name.partition("!")[0]
        check(config, kinds[kind], "foxglovePanelTitle")
        for path in config.get("paths", ()):
            check(path, paths[kind](value="/states"))
        for part in inner.keys() & config.keys():
            check(config[part], inner[part])
        check(config.get("scene", {}).get("transforms", {}), layouts.BaseRendererTransforms())
    placed: list[str] = []

    def walk(node: Any) -> None:
        if isinstance(node, str):
            placed.append(node)
            return
        assert set(node) == {"direction", "splitPercentage", "first", "second"}
        assert node["direction"] in ("row", "column")
        assert 0 < node["splitPercentage"] < 100
        walk(node["first"])
        walk(node["second"])

    walk(made["layout"])
    assert sorted(placed) == sorted(made["configById"])


# ---------------------------------------------------------------------- a running simulation


@contextlib.contextmanager
def running(*words: str) -> Generator[subprocess.Popen[str]]:
    """A command as a process."""
    process = subprocess.Popen(
        [sys.executable, "-m", "aces_tools", *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


def looked_at(words: Sequence[str], *, is_watched: bool) -> tuple[Viewer, float, str]:
    """A command with a viewer of everything, until it has 400 rows of states, or one of nothing, for two seconds.

    The viewer, the seconds of CPU that the command took, and what it said."""
    port = free_port()
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    with running(*words, "--foxglove", str(port)) as process:
        with Viewer(f"ws://127.0.0.1:{port}", wants=lambda topic: is_watched) as viewer:
            viewer.until(lambda: "/states" in viewer.channels)
            if is_watched:
                viewer.until(lambda: viewer.has("/states", 400))
            else:
                threading.Event().wait(2.0)
        process.send_signal(signal.SIGINT)
        _, said = process.communicate(timeout=WAIT_S)
    assert process.returncode == 0, said
    now = resource.getrusage(resource.RUSAGE_CHILDREN)
    return viewer, now.ru_utime + now.ru_stime - before.ru_utime - before.ru_stime, said


@pytest.mark.slow
def test_the_layout_shows_what_the_robot_sends(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each topic, field and frame that the layout names is in the channels, schemas and messages of a running MiniHubo."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    port = free_port()
    panels = json.loads(LAYOUT.read_text())["configById"]

    def parents(viewer: Viewer) -> set[str]:
        return {
            one["parent_frame_id"] for message in viewer.messages["/tf"] for one in message[1]["transforms"]
        }

    with (
        running(
            "run", "-r", "minihubo_1", "--virtual", "--real-time", "--for", "1h", "--foxglove", str(port)
        ),
        Viewer(f"ws://127.0.0.1:{port}") as viewer,
    ):
        # On a busy machine the first transforms are of those joints that have answered.
        viewer.until(
            lambda: (
                viewer.has("/states")
                and viewer.has("/tf")
                and panels["3D!robot"]["followTf"] in parents(viewer)
            )
        )
    named = [path["value"] for panel in panels.values() for path in panel.get("paths", ())]
    named += [
        panel[key] for panel in panels.values() for key in ("topicPath", "topicToRender") if key in panel
    ]
    assert len(named) >= 9
    for path in named:
        # A topic, and a field of its messages; in quotes where the name has a dot.
        found = re.fullmatch(r'(/\w+)(?:\.(?:(\w+)|"([\w.]+)"))?', path)
        assert found is not None, path
        topic, field = found[1], found[2] or found[3]
        assert topic in viewer.channels, path
        if field is not None:
            assert field in viewer.schema(topic)["properties"], path
            if topic == "/states":
                assert field in viewer.messages[topic][0][1], path
    assert viewer.channels["/log"]["schemaName"] == "foxglove.Log"
    assert viewer.channels["/tf"]["schemaName"] == "foxglove.FrameTransforms"
    assert panels["3D!robot"]["followTf"] in parents(viewer)


@pytest.mark.slow
@pytest.mark.parametrize("verb", ["sim", "run"])
def test_a_simulation_at_200_hz(verb: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Channels and schemas of Hubo are read by a client of foreign make; Ctrl-C ends it with the count. The CPU that
    it takes is printed, alone and with a viewer of everything."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    words = [verb, "-r", "hubo2plus", *(("--virtual", "--real-time", "--for", "1h") if verb == "run" else ())]
    _, alone_s, _ = looked_at(words, is_watched=False)
    viewer, watched_s, said = looked_at(words, is_watched=True)
    assert re.search(r"live view: \d+ messages sent", said)
    rows = viewer.messages["/states"]
    seconds = (rows[-1][0] - rows[0][0]) / 1e9
    if verb == "run":  # virtual time is exact; of real time only the order is sure
        assert seconds == pytest.approx((len(rows) - 1) / 200, abs=0.01)
    assert all(later[0] > earlier[0] for earlier, later in itertools.pairwise(rows))
    assert viewer.schema("/states")["properties"]["RHY"] == {
        "type": "number",
        "unit": "rad",
        "description": "in rad",
    }
    topics = {topic: len(messages) for topic, messages in sorted(viewer.messages.items())}
    print(
        f"aces {verb} -r hubo2plus at 200 Hz: {alone_s:.1f} s of CPU with its start and 2 s of nobody looking,"
        f" {watched_s:.1f} s with its start and {seconds:.1f} s watched: {topics}"
    )
