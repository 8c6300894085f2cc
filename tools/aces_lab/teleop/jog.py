"""Joints moved one by one from a keyboard or a gamepad: the controller, and what reads the two.

1. A terminal reports no key-up: a joint moves while its key repeats, and for `KEY_S` after the last time.
2. A gamepad reports changes only: its joint moves while the dead-man button is held and the stick is out of its middle. A
   gamepad that goes away lets go of both.
3. Reading is a thread's; the controller does no I/O. What it gives passes guard and door as any controller's set-points.
"""

from __future__ import annotations

import os
import select
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping
from importlib import import_module
from types import ModuleType
from typing import Protocol

from aces_bus.controller import Controller
from aces_bus.controller.base import NOTHING
from aces_bus.errors import CallerError, UnknownNameError

#: Motion goes on for this long (s) after a key was reported; keyboards repeat 10 to 40 times a second.
KEY_S = 0.15
#: How often a thread looks whether it is to end (s).
LOOK_S = 0.1
#: Keys, as terminals send them: motion of the chosen joint, another joint, stop, end.
KEYS: Mapping[bytes, str] = {
    **dict.fromkeys((b"\x1b[C", b"l", b"+"), "forward"),
    **dict.fromkeys((b"\x1b[D", b"h", b"-"), "back"),
    **dict.fromkeys((b"\x1b[B", b"j", b"\t"), "next"),
    **dict.fromkeys((b"\x1b[A", b"k"), "previous"),
    b" ": "stop",
    **dict.fromkeys((b"q", b"\x04"), "end"),
}
#: Codes of linux/input-event-codes.h: kinds of events; left shoulder button; left stick up and down; cross left and right.
EV_KEY, EV_ABS = 1, 3
BTN_TL, ABS_Y, ABS_HAT0X = 0x136, 0x01, 0x10
#: So much of a stick's way is its middle.
MIDDLE = 0.15


class Jog(Controller):
    """Moves the chosen joint at `speed` (by joint: rad/s, m/s, or the unit of what it takes) while `press` says so.

    `writes` are states as `commanded` has them: "RHP" takes positions, all others stand still at 0. While a joint moves,
    those that moved before are given where they stand.
    """

    def __init__(self, writes: Mapping[str, str], speeds: Mapping[str, float], *, rate_hz: float) -> None:
        if not writes:
            raise CallerError("jog: there is no joint that can be moved")
        positions = [state for state in writes.values() if "." not in state]
        super().__init__("jog", rate_hz=rate_hz, states=positions, writes=writes.values())
        self.joints = list(writes)
        self._state_of, self._speeds = dict(writes), dict(speeds)
        self._lock = threading.Lock()
        self.chosen = self.joints[0]
        #: From -1 to 1; whether it lasts until it is changed; whether it has been said since the last step.
        self._direction, self._lasts, self._is_new = 0.0, False, False
        self._until = 0
        self._moving = ""
        self._goal = 0.0
        #: Set-points of the joints that have moved and stand still, by state.
        self._held: dict[str, float] = {}
        self._before = 0
        #: What has been asked for beside motion.
        self.is_over = False

    @property
    def is_idle(self) -> bool:
        """True while nothing moves."""
        return not self._moving

    def press(self, direction: float, *, lasts: bool = False) -> None:
        """Move the chosen joint in this direction (-1 to 1; 0 stops): for `KEY_S`, or while it `lasts`; any thread."""
        with self._lock:
            self._direction, self._lasts, self._is_new = max(-1.0, min(1.0, direction)), lasts, True

    def choose(self, step: int) -> None:
        """Choose another joint, which ends the motion of the one before; any thread."""
        with self._lock:
            place = self.joints.index(self.chosen) + step
            self.chosen = self.joints[place % len(self.joints)]
            self._direction, self._lasts, self._is_new = 0.0, False, True

    def end(self) -> None:
        """Stop the motion, and ask for the end of the run."""
        self.press(0.0)
        self.is_over = True

    def stop(self, now: int) -> None:
        """End: nothing moves."""
        super().stop(now)
        self._moving = ""
        self._held.clear()

    def step(self, now_ns: int) -> Mapping[str, float]:
        """Return the set-point of the joint that moves, and once that of one that is to stand still."""
        with self._lock:
            if self._is_new:
                self._is_new = False
                self._until = now_ns + round(KEY_S * 1e9)
            is_moving = self._direction != 0.0 and (self._lasts or now_ns <= self._until)
            joint, direction = self.chosen, self._direction
        dt, self._before = min((now_ns - self._before) / 1e9, 2 / self.rate_hz), now_ns
        given: dict[str, float] = {}
        if self._moving and (self._moving != joint or not is_moving):
            given.update(self._standing(self._moving))
            self._held.update(given)
            self._moving = ""
        if not is_moving:
            return given or NOTHING
        state, speed = self._state_of[joint], direction * self._speeds[joint]
        if "." in state:
            given[state] = speed
        else:
            if not self._moving:
                known = self.known(state)
                if known is None:
                    self.waiting = f"it is not known where {joint} is"
                    return given or NOTHING
                self.waiting, self._goal = "", known
            self._goal += speed * dt
            given[state] = self._goal
        self._moving = joint
        # A joint that is left out while others are given counts as forgotten (the guard's `unnamed`).
        self._held.pop(state, None)
        return {**self._held, **given}

    def _standing(self, joint: str) -> dict[str, float]:
        """Return the set-point at which a joint stands still: a position is held where it is measured."""
        state = self._state_of[joint]
        if "." in state:
            return {state: 0.0}
        known = self.known(state)
        return {state: self._goal if known is None else known}


class ReadingThread(ABC):
    """A thread that reads until it is closed; a context manager."""

    def __init__(self, name: str) -> None:
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._read_on, name=name, daemon=True)

    @abstractmethod
    def _read_on(self) -> None:
        """Read until `_closing` is set."""

    def __enter__(self) -> None:
        self._thread.start()

    def __exit__(self, *_: object) -> None:
        self._closing.set()
        self._thread.join(5.0)


class KeyReader(ReadingThread):
    """Keys of a terminal (or of anything that has a file descriptor) for a `Jog`; its end is that of the run."""

    def __init__(self, file: int, jog: Jog, chose: Callable[[str], object] = lambda joint: None) -> None:
        super().__init__("keys")
        self._file, self._jog, self._chose = file, jog, chose

    def _read_on(self) -> None:
        while not self._closing.is_set():
            if not select.select([self._file], [], [], LOOK_S)[0]:
                continue
            try:
                data = os.read(self._file, 256)
            except OSError:
                data = b""
            if not data:  # the terminal is gone
                self._jog.end()
                return
            for key in keys_of(data):
                self._pressed(key)

    def _pressed(self, key: str) -> None:
        jog = self._jog
        if key in ("forward", "back"):
            jog.press(1.0 if key == "forward" else -1.0)
        elif key in ("next", "previous"):
            jog.choose(1 if key == "next" else -1)
            self._chose(jog.chosen)
        elif key == "stop":
            jog.press(0.0)
        else:
            jog.end()


def keys_of(data: bytes) -> Iterable[str]:
    """Yield what the keys in some bytes of a terminal mean; any other key stops.

    >>> list(keys_of(b"l\\x1b[Dx"))
    ['forward', 'back', 'stop']
    """
    while data:
        size = 3 if data.startswith(b"\x1b[") else 1
        yield KEYS.get(data[:size], "stop")
        data = data[size:]


class Axis(Protocol):
    """What is known of an axis of a gamepad."""

    @property
    def min(self) -> int:
        """Its lowest value."""
        ...

    @property
    def max(self) -> int:
        """Its highest value."""
        ...


class InputEvent(Protocol):
    """An event of an input device (linux/input.h)."""

    type: int
    code: int
    value: int


class Gamepad(Protocol):
    """What of an `evdev.InputDevice` is used."""

    @property
    def fd(self) -> int:
        """Its file descriptor."""
        ...

    def read(self) -> Iterable[InputEvent]:
        """Return the events that have come; raises `OSError` when it is gone."""
        ...

    def absinfo(self, axis_num: int) -> Axis:
        """Return the range of an axis."""
        ...


class GamepadReader(ReadingThread):
    """Left shoulder held and left stick up or down moves the chosen joint; the cross chooses. See rule 2."""

    def __init__(self, pad: Gamepad, jog: Jog, chose: Callable[[str], object] = lambda joint: None) -> None:
        super().__init__("gamepad")
        self._pad, self._jog, self._chose = pad, jog, chose
        axis = pad.absinfo(ABS_Y)
        self._middle, self._reach = (axis.min + axis.max) / 2, max(1.0, (axis.max - axis.min) / 2)
        self._is_held, self._tilt = False, 0.0

    def _read_on(self) -> None:
        try:
            while not self._closing.is_set():
                if select.select([self._pad.fd], [], [], LOOK_S)[0]:
                    for event in self._pad.read():
                        self.happened(event)
        except (OSError, ValueError):  # unplugged, out of reach
            self._jog.end()
        finally:
            self._jog.press(0.0)

    def happened(self, event: InputEvent) -> None:
        """Take one event."""
        if event.type == EV_KEY and event.code == BTN_TL:
            self._is_held = event.value != 0
        elif event.type == EV_ABS and event.code == ABS_Y:
            tilt = (self._middle - event.value) / self._reach  # up is the lower number
            self._tilt = tilt if abs(tilt) > MIDDLE else 0.0
        elif event.type == EV_ABS and event.code == ABS_HAT0X:
            if event.value:
                self._jog.choose(event.value)
                self._chose(self._jog.chosen)
            return
        else:
            return
        self._jog.press(self._tilt if self._is_held else 0.0, lasts=True)


def open_gamepad(path: str, library: ModuleType | None = None) -> Gamepad:
    """Open an input device, or with "" the first that has a stick and a left shoulder button. Raises `CallerError`."""
    try:
        evdev = library or import_module("evdev")
    except ImportError as missing:
        raise CallerError(f"a gamepad needs evdev: pip install 'aces-bus[gamepad]' ({missing})") from missing
    paths: list[str] = [path] if path else list(evdev.list_devices())
    for candidate in paths:
        try:
            device: Gamepad = evdev.InputDevice(candidate)
            able: Mapping[int, Iterable[int]] = evdev.InputDevice(candidate).capabilities(absinfo=False)
        except OSError as error:
            if path:
                raise CallerError(f"{path} cannot be opened: {error.strerror or error}") from None
            continue
        if path or (BTN_TL in able.get(EV_KEY, ()) and ABS_Y in able.get(EV_ABS, ())):
            return device
    raise UnknownNameError("gamepad", path or "any", paths)
