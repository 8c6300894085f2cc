# The library is hidden where it is imported.
# pyright: reportPrivateUsage=false
"""What is watched live: the topics of an MCAP, nobody but lookers, nothing held up, and a clean end."""

from __future__ import annotations

import json
import logging
import socket
import sys
import threading
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest

from aces_bus import Frame, load_protocol, load_robot, make_scanner
from aces_bus.errors import CallerError
from aces_bus.export import open_export
from aces_bus.kinematics import load_body
from aces_bus.protocol.columns.scanner import RecordColumns
from aces_bus.robot import run_virtual
from aces_lab.foxglove.live import (
    FoxgloveView,
    LiveBus,
    LiveRecords,
    LiveStates,
    LogLines,
    parse_live_address,
)
from aces_lab.foxglove.origins import hidden_host, is_allowed
from tests.access.viewing import WAIT_S, Viewer

pytest.importorskip("foxglove")
pytest.importorskip("websockets")


@pytest.fixture
def view() -> Iterator[FoxgloveView]:
    """At a port of its own; what it reports is in `told`."""
    told: list[str] = []
    with FoxgloveView("0", name="test", report=told.append) as made:
        made.told = told  # type: ignore[attr-defined]
        yield made


def told(view: FoxgloveView) -> list[str]:
    """What it has reported."""
    found: list[str] = view.told  # type: ignore[attr-defined]
    return found


FRAMES = [
    Frame(0x063, bytes.fromhex("78000000FCFFFFFF"), 1436509052.25, channel="can0"),
    Frame(0x064, bytes.fromhex("0100000002000000"), 1436509052.26, channel="can0"),
    Frame(0x7F1, b"\x01\x02", 1436509052.27, channel="can0"),
    Frame(0x063, bytes.fromhex("79000000FBFFFFFF"), 1436509052.28, channel="can0"),
]


def test_a_viewer_has_what_an_mcap_has(view: FoxgloveView, tmp_path: Path) -> None:
    """The same records: the same topics, schemas, metadata, objects and times, also of what was not decoded."""
    reader = pytest.importorskip("mcap.reader")
    variants = [load_protocol("hubo").variant()]
    items = make_scanner(variants, include_unknown=True).feed(FRAMES)
    live = LiveRecords(view, variants, scanner=make_scanner(variants, include_unknown=True))
    with Viewer(view.address) as viewer:
        # The first messages of a topic make it known.
        viewer.until(lambda: viewer.has("/_lost") and viewer.has("/hubo/Encoder", 3), lambda: live.put(items))
    path = tmp_path / "same.mcap"
    with open_export(path, variants=variants) as export:
        columns = RecordColumns(variants, include_unknown=True)
        import numpy as np

        export.write(columns.tables(items, np.arange(len(items))))
    with open(path, "rb") as file:
        for schema, channel, message in reader.make_reader(file).iter_messages():
            mine = viewer.channels[channel.topic]
            assert mine["schemaName"] == schema.name
            assert viewer.schema(channel.topic) == json.loads(schema.data)
            assert (message.log_time, json.loads(message.data)) in viewer.messages[channel.topic]


def test_events_and_logs_arrive(view: FoxgloveView) -> None:
    """An event is one, and a line of the log; what a program logs is a line. Foxglove knows the schema by its name."""
    logger = logging.getLogger("walk")
    lines = LogLines(view)
    logger.addHandler(lines)
    try:
        with Viewer(view.address) as viewer:

            def happen() -> None:
                view.event(1_500_000_000, "silent", "JMC3", "no reply for 0.1 s", "error")
                logger.warning("the left foot is %s", "late")

            viewer.until(lambda: viewer.has("/log", 2) and viewer.has("/events"), happen)
    finally:
        logger.removeHandler(lines)
    assert viewer.channels["/log"]["schemaName"] == "foxglove.Log"
    instant, event = viewer.messages["/events"][-1]
    assert instant == 1_500_000_000 + view.epoch_ns
    assert event == {"kind": "silent", "source": "JMC3", "detail": "no reply for 0.1 s", "level": "error"}
    found = [line for _, line in viewer.messages["/log"]]
    assert {"name": "JMC3", "level": 4, "message": "silent: no reply for 0.1 s"}.items() <= found[0].items()
    assert {"name": "walk", "level": 3, "message": "the left foot is late"}.items() <= found[1].items()
    assert set(found[0]) == set(viewer.schema("/log")["properties"])


@pytest.mark.slow
def test_states_and_transforms_of_a_robot(view: FoxgloveView) -> None:
    """Joints, set-points, what sensors measure; and where the frames of its body are, as far as joints are known."""
    robot = load_robot("minihubo_1")
    states = LiveStates(view, 50, body=load_body("MiniHubo"))
    run = run_virtual(robot, [], loggers=[states], pose={"LKP": 0.5})
    host = next(iter(run.rig.hosts.values()))
    host.watch(LiveBus(view, list(host.variants.values()), name="can", link="serial").passed)
    with Viewer(view.address) as viewer, run:

        def is_known() -> bool:
            if not (viewer.has("/tf") and viewer.has("/states") and viewer.has("/robotis/Status")):
                return False
            children = {link["child_frame_id"] for link in viewer.messages["/tf"][-1][1]["transforms"]}
            rows = viewer.messages["/states"]
            return {"LKP", "LF"} <= children and any(row["LKP"] is not None for _, row in rows)

        viewer.until(is_known, lambda: run.run(0.04))
    properties = viewer.schema("/states")["properties"]
    assert properties["LKP"]["unit"] == "rad"
    assert "LKP.setpoint" in properties
    known = [row for _, row in viewer.messages["/states"] if row["LKP"] is not None]
    assert known[-1]["LKP"] == pytest.approx(0.5, abs=0.01)
    links = viewer.messages["/tf"][-1][1]["transforms"]
    assert viewer.channels["/tf"]["schemaName"] == "foxglove.FrameTransforms"
    assert {(link["parent_frame_id"], link["child_frame_id"]) for link in links} >= {
        *(("MiniHubo", "HY"), ("LHP", "LKP"), ("LAR", "LF")),
    }


def test_clients_only_look(view: FoxgloveView) -> None:
    """No capability is offered; what is published, asked or called is refused, and the view goes on."""
    with Viewer(view.address) as viewer:
        viewer.until(lambda: "/log" in viewer.channels)
        assert viewer.texts[0]["op"] == "serverInfo"
        assert viewer.texts[0]["capabilities"] == []
        viewer.say(
            op="advertise", channels=[{"id": 1, "topic": "/cmd", "encoding": "json", "schemaName": ""}]
        )
        viewer.say(op="setParameters", parameters=[{"name": "a", "value": 1}], id="x")
        viewer.say_bytes(b"\x02" + bytes(4) + bytes(4) + (4).to_bytes(4, "little") + b"json{}")
        viewer.until(
            lambda: len([t for t in viewer.texts if t["op"] in ("status", "serviceCallFailure")]) >= 3
        )
        said = " ".join(text.get("message", "") for text in viewer.texts)
        for what in ("clientPublish", "parameters", "services"):
            assert f"does not support {what}" in said
        viewer.until(lambda: viewer.has("/log"), lambda: view.log(0, "info", "test", "still here"))


@pytest.mark.parametrize(
    ("origin", "allowed"),
    [
        (None, True),
        ("https://app.foxglove.dev", True),
        ("http://localhost:8080", True),
        ("http://127.0.0.1:9999", True),
        ("https://evil.example", False),
        ("http://localhost.evil.example", False),
        ("https://app.foxglove.dev.evil.example", False),
        ("null", False),
    ],
)
def test_pages_of_other_sites_are_refused(view: FoxgloveView, origin: str | None, allowed: bool) -> None:
    """A browser says where its page is from; a program says nothing, and may look."""
    exceptions = pytest.importorskip("websockets.exceptions")
    if allowed:
        with Viewer(view.address, origin=origin) as viewer:
            viewer.until(lambda: "/log" in viewer.channels)
        return
    with pytest.raises(exceptions.InvalidStatus) as caught, Viewer(view.address, origin=origin):
        pass
    assert caught.value.response.status_code == 403
    assert told(view) == [f"a page of {origin} wanted to look on, and was refused"]


def test_origins_can_be_added() -> None:
    """As they are, and no others."""
    assert is_allowed("http://lab:8080", ["http://lab:8080"])
    assert not is_allowed("http://lab:8081", ["http://lab:8080"])
    assert not is_allowed("http://[", [])


@pytest.mark.skipif(sys.platform != "linux", reason="127.0.0.0/8 is this machine's")
def test_the_server_behind_is_where_no_page_can_guess_it() -> None:
    """One of 16 million addresses, each time another."""
    found = {hidden_host() for _ in range(20)}
    assert len(found) > 15
    assert all(host.startswith("127.") for host in found)


def test_a_port_that_is_taken(view: FoxgloveView) -> None:
    """Is said, with one that may be free; nothing is left running."""
    before = threading.active_count()
    with pytest.raises(CallerError, match=f"127.0.0.1:{view.port} cannot be served.*such as {view.port + 1}"):
        FoxgloveView(str(view.port))
    assert threading.active_count() == before


@pytest.mark.parametrize("text", ["wave.py", "localhost:", ":8765", "8765x", "70000", "1:2:x"])
def test_no_address(text: str) -> None:
    """Is said before anything is opened."""
    with pytest.raises(CallerError, match="write PORT or HOST:PORT"):
        parse_live_address(text)


def test_without_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    """One sentence that names it."""
    monkeypatch.setitem(sys.modules, "foxglove", None)
    with pytest.raises(CallerError, match=r"pip install 'aces-bus\[foxglove\]'"):
        FoxgloveView("0")


class Stuck:
    """A feed that takes nothing until it is let."""

    def __init__(self) -> None:
        self.begun, self.go_on = threading.Event(), threading.Event()
        self.items: list[int] = []

    def publish(self, items: Sequence[Any]) -> None:
        """Wait, and take them."""
        self.begun.set()
        assert self.go_on.wait(WAIT_S)
        self.items += items


def test_what_does_not_fit_is_dropped_and_counted() -> None:
    """The oldest goes; putting never waits, and it is reported once."""
    said: list[str] = []
    with FoxgloveView("0", report=said.append, waiting=10) as view, Viewer(view.address) as viewer:
        viewer.until(lambda: view.viewers)
        feed = Stuck()
        view.put(feed, -1)
        assert feed.begun.wait(WAIT_S)
        for number in range(100):
            view.put(feed, number)
        feed.go_on.set()
        view.close()
    assert feed.items == [-1, *range(90, 100)]
    assert view.dropped == 90
    assert "90 items dropped" in str(view)
    assert said == ["live view: more happens than can be shown; the oldest is dropped"]


def test_where_nobody_looks_nothing_is_done(view: FoxgloveView) -> None:
    """No record is kept or encoded."""
    feed = Stuck()
    view.put(feed, 1)
    view.event(0, "opened", "can0")
    view.close()
    assert not feed.items
    assert not feed.begun.is_set()
    assert view.published == 0


def test_a_feed_that_raises_ends_nothing(view: FoxgloveView) -> None:
    """It is reported once, and what comes next is shown."""

    class Broken:
        def publish(self, items: Sequence[Any]) -> None:
            """Raise."""
            raise ValueError("odd")

    with Viewer(view.address) as viewer:

        def happen() -> None:
            view.put(Broken(), 1)
            view.log(0, "info", "test", "after")

        viewer.until(lambda: viewer.has("/log"), happen)
    assert told(view)[0] == "live view: ValueError: odd"
    assert len(told(view)) == 1


def test_the_end_is_clean() -> None:
    """What was shown last arrives; the connection ends, the threads too, and the port is free."""
    before = set(threading.enumerate())
    with FoxgloveView("0") as view, Viewer(view.address) as viewer:
        viewer.until(lambda: view.is_wanted(view._log_feed.channel))
        view.log(0, "info", "test", "the end")
        view.close()
        viewer.to_the_end()
    assert viewer.messages["/log"][-1][1]["message"] == "the end"
    for thread in set(threading.enumerate()) - before:
        thread.join(WAIT_S)
        assert not thread.is_alive(), thread.name
    with socket.create_server(("127.0.0.1", view.port)):
        pass


@pytest.mark.parametrize(
    ("origin", "may"),
    [
        ("http://127.0.0.1:3000", True),
        ("https://localhost", True),
        ("http://[::1]:8080", True),
        ("https://127.evil.example.com", False),
        ("https://localhost.evil.example", False),
        ("null", False),
        ("https://app.foxglove.dev.evil.example", False),
    ],
)
def test_which_pages_may_look(origin: str, may: bool) -> None:
    """Pages of this machine; not of a name that looks like one of its addresses."""
    assert is_allowed(origin) is may
