"""The live screen: what stands on the terminal, what keys do, how it is started."""

from __future__ import annotations

import asyncio
import io
import os
import select
import subprocess
import sys
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from aces_bus import Frame
from aces_bus.errors import CallerError
from aces_bus.hardware.gate import Received
from aces_bus.hardware.gate_events import BusEvent, GateCounters
from aces_bus.hardware.queues import Inbox
from aces_bus.runtime import VirtualClock
from aces_tools.screen import check_screen, make_screen
from tests.tools.screening import (
    MS,
    S,
    encoder,
    model,
    only,
    scanner,
    wire,
)


@dataclass
class Gate:
    """What the screen looks at of a gate; time is virtual."""

    name: str = "can0"
    state: str = "open"
    counters: GateCounters = field(default_factory=GateCounters)
    clock: VirtualClock = field(default_factory=VirtualClock)


@dataclass
class Stage:
    """A screen in a terminal that is none, with hands to feed it."""

    app: Any
    pilot: Any
    gate: Gate
    inbox: Inbox[Received[Frame]]

    async def hear(self, *frames: Frame, seconds: float = 0.1) -> None:
        """Frames come, time goes on, a picture is made."""
        self.gate.clock.advance(round(seconds * S))
        self.inbox.put([Received(frame, self.gate.clock.now()) for frame in frames])
        await self.look()

    async def look(self) -> None:
        await self.app.turn()
        await self.pilot.pause()

    async def press(self, *keys: str) -> None:
        await self.pilot.press(*keys)
        await self.look()

    async def until(self, holds: Callable[[], bool]) -> None:
        """Look until it holds: what scrolls or is laid out anew takes more than one turn, as many as it likes."""
        for _ in range(100):
            if holds():
                return
            await self.look()
        raise AssertionError("it never comes to that")

    @property
    def head(self) -> str:
        return str(self.app.query_one("#head").text)

    @property
    def rows(self) -> list[str]:
        return [row.identifier for row in self.app.table.rows]

    @property
    def picture(self) -> str:
        """What stands on the terminal."""
        svg: str = self.app.export_screenshot()
        return svg.replace("&#160;", " ")


Scene = Callable[[Stage], Awaitable[None]]


def play(scene: Scene, size: tuple[int, int] = (100, 24), **more: Any) -> None:
    """Run a scene on a screen of this size."""
    app_module = pytest.importorskip("aces_tools.screen.app")

    async def run() -> None:
        gate, inbox = Gate(), Inbox[Received[Frame]]()
        app = app_module.LiveScreen(model(), gate, inbox, **more)
        async with app.run_test(size=size) as pilot:
            await scene(Stage(app, pilot, gate, inbox))

    pytest.importorskip("textual")
    asyncio.run(run())


async def three(stage: Stage) -> None:
    """Two boards and an unknown identifier, for two seconds."""
    for tick in range(20):
        await_frames = [encoder(n, tick * (n + 1), at_ms=100 * tick) for n in (0, 1)]
        stage.gate.clock.advance(100 * MS)
        stage.inbox.put([Received(f, stage.gate.clock.now()) for f in (*await_frames, Frame(0x7FF, b"\xde"))])
        await stage.app.take_in()
    await stage.look()


@pytest.mark.slow
@pytest.mark.parametrize("size", [(80, 24), (60, 20)])
def test_the_screen_shows_the_bus(size: tuple[int, int]) -> None:
    """Bus, rates, messages, data and values stand on terminals of any size, and the keys below."""

    async def scene(stage: Stage) -> None:
        await three(stage)
        await stage.press("down")
        picture = stage.picture
        for part in ("can0", "open", "frames/s", "Encoder", "unknown", "060", "061", "7FF", "board=", "Quit"):
            assert part in picture, part
        assert "13" in picture  # 19 as hexadecimal

    play(scene, size)


@pytest.mark.slow
def test_keys_sort_filter_and_hide() -> None:
    """s sorts, / filters while typing, Enter keeps and Esc ends the filter, u shows the unknown only."""

    async def scene(stage: Stage) -> None:
        await three(stage)
        assert stage.rows == ["060", "061", "7FF"]
        await stage.press("S")
        assert stage.rows == ["7FF", "061", "060"]
        await stage.press("s")
        assert stage.app.view.sort == "rate"
        await stage.press("slash", *"61")
        assert stage.rows == ["061"]
        await stage.press("enter")
        assert stage.rows == ["061"]
        assert "/61" in stage.head
        await stage.press("escape")
        assert len(stage.rows) == 3
        await stage.press("u")
        assert stage.rows == ["7FF"]
        assert "unknown only" in stage.head

    play(scene)


@pytest.mark.slow
def test_freeze_stops_the_picture_and_not_the_counting() -> None:
    """f freezes rows; frames still count; f again shows what is now."""

    async def scene(stage: Stage) -> None:
        await three(stage)
        await stage.press("f")
        await stage.hear(encoder(3))
        assert stage.rows == ["060", "061", "7FF"]
        assert "FROZEN" in stage.head
        assert stage.app.model.total == 61
        await stage.press("space")
        assert stage.rows == ["060", "061", "063", "7FF"]
        assert "FROZEN" not in stage.head

    play(scene)


@pytest.mark.slow
def test_clear_counts_anew() -> None:
    """c forgets rows and losses; new losses are counted from there."""

    async def scene(stage: Stage) -> None:
        await three(stage)
        stage.gate.counters.dropped = 5
        await stage.look()
        assert "5 lost" in stage.head
        await stage.press("c")
        assert stage.rows == []
        assert "nothing lost" in stage.head
        stage.gate.counters.kernel_dropped = 2
        await stage.hear(encoder(0))
        assert "2 lost" in stage.head
        assert stage.rows == ["060"]

    play(scene)


@pytest.mark.slow
def test_details_follow_the_selected_row_wherever_it_goes() -> None:
    """d opens them, the arrows choose, sorting moves the row and not the choice, Esc closes."""

    async def scene(stage: Stage) -> None:
        await three(stage)
        await stage.press("down", "down", "d")
        await stage.look()
        await stage.look()
        about = stage.app.query_one("#detail")
        assert "061 Encoder" in about.text
        assert "position.0" in about.text
        pane = stage.app.query_one("#pane")
        await stage.press("J", "J")
        await stage.until(lambda: pane.scroll_offset.y > 0)
        await stage.press("K", "K")
        await stage.until(lambda: pane.scroll_offset.y == 0)
        await stage.press("S")
        await stage.look()
        assert stage.app.table.selected.identifier == "061"
        await stage.press("home")
        await stage.look()
        await stage.look()
        assert "7FF" in about.text
        await stage.press("escape")
        assert not stage.app.has_class("detailed")

    play(scene, (100, 24))


@pytest.mark.slow
def test_highlighting_can_be_switched_off() -> None:
    """h takes the marks away and brings them back."""

    async def scene(stage: Stage) -> None:
        await three(stage)
        fresh = "#ffd166"
        assert fresh in stage.picture
        await stage.press("h")
        assert fresh not in stage.picture
        await stage.press("h")
        assert fresh in stage.picture

    play(scene)


def test_without_colour_nothing_is_coloured() -> None:
    """On a terminal without colours the rows have none, and stand there all the same."""

    async def scene(stage: Stage) -> None:
        await three(stage)
        picture = stage.picture
        assert "#ffd166" not in picture
        assert "#6cc7e0" not in picture
        assert "Encoder" in picture

    play(scene, has_colour=False)


@pytest.mark.slow
@pytest.mark.parametrize("key", ["q", "ctrl+c"])
def test_help_opens_and_closes_and_q_quits(key: str) -> None:
    """? tells the keys, Esc goes back, q and Ctrl-C end with status 0."""

    async def scene(stage: Stage) -> None:
        await three(stage)
        await stage.press("question_mark")
        assert "freeze what is shown" in stage.picture
        await stage.press("escape")
        assert "freeze what is shown" not in stage.picture
        await stage.pilot.press(key)
        assert (stage.app.return_code or 0) == 0
        assert stage.app._exit

    play(scene)


@pytest.mark.slow
def test_resizing_keeps_rows_and_moves_the_details() -> None:
    """From wide to narrow and back: the details stand beside the table where there is room."""

    async def scene(stage: Stage) -> None:
        await three(stage)
        await stage.press("down", "d")
        for width, height, is_wide in ((170, 40, True), (60, 20, False), (100, 30, False)):
            await stage.pilot.resize_terminal(width, height)
            await stage.look()
            assert stage.app.has_class("wide") is is_wide
            assert "060" in stage.picture

    play(scene)


@pytest.mark.slow
def test_a_long_list_scrolls_with_the_cursor() -> None:
    """The last of 300 rows is reached, and stands on the terminal."""

    async def scene(stage: Stage) -> None:
        await stage.hear(*[Frame(0x100 + n, bytes(8)) for n in range(300)])
        await stage.press("end")
        await stage.look()
        assert stage.app.table.selected.identifier == "22B"
        assert "22B" in stage.picture
        await stage.press("pageup", "up", "home")
        await stage.look()
        assert "100" in stage.picture

    play(scene)


def test_a_backlog_is_worked_off_in_pieces() -> None:
    """Ten thousand frames at once are all counted, and events that came meanwhile too."""

    async def scene(stage: Stage) -> None:
        stage.app.model.emit(BusEvent("dropped", stage.gate.clock.now(), "can0", "7 frames", 7))
        await stage.hear(*[encoder(n % 4, n) for n in range(10_000)])
        assert stage.app.model.total == 10_000
        assert "dropped: 7 frames" in stage.head

    play(scene, (160, 24))


def test_the_screen_ends_when_it_is_told_to() -> None:
    """A signal, or the end of a duration, ends it."""
    is_over = False

    async def scene(stage: Stage) -> None:
        nonlocal is_over
        await three(stage)
        assert not stage.app._exit
        is_over = True
        await stage.app.turn()
        assert stage.app._exit

    play(scene, end=lambda: is_over)


# ---------------------------------------------------------------------- how it is started


def test_without_textual_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    """The extra is named."""
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(CallerError, match=r"aces-bus\[screen\]"):
        check_screen()


def test_without_a_terminal_it_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    """A screen into a pipe is refused, before anything is opened."""
    monkeypatch.setattr("importlib.util.find_spec", lambda name: object())
    monkeypatch.setattr(sys, "__stderr__", io.StringIO())
    with pytest.raises(CallerError, match="terminal"):
        check_screen()


@pytest.mark.parametrize("kind", ["can", "serial"])
def test_a_screen_is_made_for_a_gate(kind: str) -> None:
    """A gate gives the screen its frames or bytes, its events, its bit rate; nothing is opened yet."""
    pytest.importorskip("textual")
    from aces_bus.hardware import CanGate, SerialGate

    gate: Any
    if kind == "can":
        gate, made_scanner = CanGate({}, name="bus", listen_only=True), scanner()
    else:
        gate, made_scanner = SerialGate("loop://", baud=57_600, listen_only=True), scanner(wire)
    app = make_screen(gate, made_scanner, title="arm", show=["Encoder"])
    assert app.model.bitrate == (1_000_000 if kind == "can" else 57_600)
    assert app.view.text == "Encoder"
    assert gate.state == "new"
    gate.events.emit(BusEvent("lost", 0, "bus"))
    app.model.take_events()
    assert app.model.event_counts == {"lost": 1}
    item = Received(bytes([0xAA, 1, 2, 3, 4]), 5) if kind == "serial" else Received(encoder(0), 5)
    gate._put([item])
    asyncio.run(app.take_in())
    assert only(app.model).name == ("Encoder" if kind == "can" else "Sample")


@pytest.mark.parametrize(
    ("options", "why"),
    [
        (["-i", "virtual", "-c", "x", "--format", "jsonl"], "--format is about lines"),
        (["-i", "virtual", "-c", "x", "-n", "5"], "--count is about lines"),
        (["--serial", "loop://"], "name one: -p NAME"),
        (["-i", "virtual", "-c", "x"], "needs a terminal"),
    ],
)
def test_a_wrong_call_leaves_nothing_behind(
    options: list[str], why: str, aces: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Options of lines, bytes without a protocol, no terminal: one message, status 2, and no recording begun."""
    monkeypatch.setattr("importlib.util.find_spec", lambda name: object())
    monkeypatch.setattr(sys, "__stderr__", io.StringIO())
    log = tmp_path / "x.log"
    result = aces("sniff", *options, "--screen", "--record", log)
    assert result.status == 2
    assert why in result.err
    assert not list(tmp_path.iterdir())


LOG = "".join(f"({1000 + n / 1000:.6f}) can0 060#{n:02X}000000F6FFFFFF\n" for n in range(200))


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="needs a terminal as POSIX has them")
def test_a_recording_is_seen_on_a_terminal_and_recorded_again(tmp_path: Path) -> None:
    """The command on a real terminal: it shows rows, q ends it, the summary and the recording are those of the lines."""
    pytest.importorskip("textual")
    import pty
    import termios

    log, copy = tmp_path / "walk.log", tmp_path / "copy.log"
    log.write_text(LOG)
    mine, its = pty.openpty()
    termios.tcsetwinsize(mine, (24, 100))
    command = ["sniff", "-i", "aces-replay", "-c", str(log), "-p", "hubo", "--screen", "--record", str(copy)]
    with subprocess.Popen(
        [sys.executable, "-m", "aces_tools", *command],
        stdin=its,
        stdout=its,
        stderr=its,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path), "TERM": "xterm-256color"},
    ) as process:
        os.close(its)
        seen, is_asked = b"", False
        try:
            while select.select([mine], [], [], 30)[0]:
                seen += os.read(mine, 65536)
                if not is_asked and b"Encoder" in seen and b"200 in all" in seen:
                    is_asked = os.write(mine, b"q") == 1
        except OSError:  # the other side has gone
            pass
        os.close(mine)
        said = seen.decode(errors="replace")
        assert process.wait(30) == 0, said
    assert "frames=200 decoded=200" in said
    assert "recorded 200 frames" in said
    assert [at.split()[2] for at in copy.read_text().splitlines()] == [
        at.split()[2] for at in LOG.splitlines()
    ]
