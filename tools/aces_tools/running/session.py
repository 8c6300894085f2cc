"""One run, from opening the buses to the summary.

1. Until `--tx` is said nothing that moves is sent on a real bus, and nothing at all until `--ask`: set-points are shown.
2. What is to be driven and is not there is found before anything moves.
3. However it ends, the runner's own end comes first: controllers, motion, buses, logs; then the summary, last on stderr.
"""

from __future__ import annotations

import argparse
import logging
import os
import sys
import time
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING, Any

from aces_bus import Frame, open_recording
from aces_bus.controller.base import ControllerLike
from aces_bus.controller.log import Logger
from aces_bus.device import Device, Robot
from aces_bus.errors import CallerError, DeviceError
from aces_bus.recordings.base import CanRecording
from aces_bus.robot import ActLog, Ended, Runner, run_real, run_replay, run_virtual

from ..console import abandon_stdout, say, say_note, terminal_width, wants_colour
from ..device_text import host_loss_text
from ..live_view import live_view, show_bus, show_event
from ..patience import Patience
from ..robot_arg import INTERFACE_HELP, NO_INTERFACE, bus_options, chosen_pose
from .figures import USUAL, Figures, Watch, event_text, often_clipped
from .loading import own_functions, reactions_of
from .panel import panel, plain_line, to_rich

if TYPE_CHECKING:
    from aces_bus.robot.run import RunLogger

    from ..live_view import LiveView

#: Between two pictures of the panel, and two lines (ns).
PANEL_EVERY, LINE_EVERY = 250_000_000, 1_000_000_000
#: After a home search some boards take no references for three seconds (Hubo's user's manual, homing); then it begins.
REST_S = 4.0
#: How long it may take (s) until devices have said whether they are homed.
HOMED_S = 2.0
#: How long devices may take to be enabled, and to find their home.
ENABLE_S, HOME_S = 30.0, 180.0
#: Threads of Python wait for each other so long (s) before they ask for their turn: the default, 5 ms, is a whole cycle.
SWITCH_S = 0.0001
#: Events of one kind and source that are printed.
FEW = 3
#: Modes of controllers that have come to their end.
ENDED = ("ended", "done", "failed")


class Session:
    """A run as the command line asks for it."""

    def __init__(
        self,
        arguments: argparse.Namespace,
        robot: Robot,
        controllers: Sequence[ControllerLike],
        loggers: Sequence[Logger],
        rate_hz: float,
        *,
        verb: str = "run",
    ) -> None:
        self.verb = verb
        #: Asked all the time: whether the run is to end for a reason of its verb's own.
        self.is_ended: Callable[[], bool] = lambda: False
        #: Called once the buses are open, before anything is enabled.
        self.opened: Callable[[Runner], object] = lambda runner: None
        self.arguments, self.robot, self.controllers = arguments, robot, list(controllers)
        self.loggers, self.rate_hz, self.duration = list(loggers), rate_hz, arguments.duration
        self.is_real = not (arguments.virtual or arguments.replay)
        self.patience = Patience(is_driving=self.is_real and arguments.tx)
        self.said: dict[tuple[str, str], int] = {}
        self._live: Any = None
        self._next = 0
        self._end: Ended | None = None
        #: Whether some of what was to be shown is lost.
        self._is_cut = False

    # ------------------------------------------------------------------ making

    def _make(self, stack: ExitStack, live: Sequence[RunLogger]) -> Runner:
        asked = self.arguments
        own = own_functions(asked.items)
        on_trip, reactions = reactions_of(asked.on_trip, self.robot, own, self.controllers)
        options: dict[str, Any] = {
            "loggers": [*self.loggers, *live],
            "on_trip": on_trip,
            "reactions": reactions,
            "own_reactions": own,
            "hold_s": None if asked.hold_ns is None else asked.hold_ns / 1e9,
            "at_end": asked.at_end,
            "unhomed": asked.unhomed,
        }
        if asked.virtual:
            return run_virtual(
                self.robot,
                self.controllers,
                rate_hz=self.rate_hz,
                seed=asked.seed,
                pose=chosen_pose(self.robot, asked.pose),
                physics=asked.physics,
                **options,
            )
        if asked.replay:
            frames = stack.enter_context(_frames(asked.replay))
            placed = {
                bus: chosen["channel"] for bus, chosen in bus_options(self.robot, asked).items() if chosen
            }
            channels = {channel: bus for bus, channel in placed.items()}
            return run_replay(self.robot, frames, self.controllers, channels=channels, **options)
        return run_real(
            self.robot,
            self.controllers,
            buses=bus_options(self.robot, asked),
            rate_hz=self.rate_hz,
            real_time=asked.real_time,
            transmit=asked.tx,
            passive=not (asked.ask or asked.tx),
            **options,
        )

    def _live_states(self, view: LiveView | None) -> list[RunLogger]:
        """Return what of the robot is shown live, beside its buses."""
        if view is None:
            return []
        from aces_bus.kinematics import load_body

        body = None if self.robot.body is None else load_body(self.robot.body)
        return [view.states(self.rate_hz, body)]

    @staticmethod
    def _show_live(view: LiveView, runner: Runner, stack: ExitStack) -> None:
        """Show buses, events, and what controllers log."""
        for name, host in runner.rig.hosts.items():
            show_bus(view, name, host, is_host=True)
        runner.handlers.append(lambda event: show_event(view, event))
        lines = view.lines()
        logging.getLogger().addHandler(lines)
        stack.callback(logging.getLogger().removeHandler, lines)

    @property
    def title(self) -> str:
        """Title of the run, for the head of the panel."""
        asked = self.arguments
        if asked.virtual:
            return f"{self.robot.name}, virtual"
        if asked.replay:
            return f"{self.robot.name}, replay of {os.path.basename(asked.replay)}"
        return self.robot.name if asked.tx else f"{self.robot.name}, only looking (no --tx)"

    # ------------------------------------------------------------------ running

    def run(self) -> int:
        """Run, and say how it was; the exit status."""
        with ExitStack() as stack:
            stack.enter_context(self.patience)
            view = stack.enter_context(live_view(self.verb, self.arguments, self.title))
            if view is not None:
                self.controllers += view.controllers(self.robot, self.rate_hz, self.controllers)
            runner = self._make(stack, self._live_states(view))
            if view is not None:
                self._show_live(view, runner, stack)
            acts = self._acts(runner, stack)
            runner.bind()
            watch = Watch(runner, real=self.is_real)
            if self.is_real:
                before = sys.getswitchinterval()
                sys.setswitchinterval(SWITCH_S)
                stack.callback(sys.setswitchinterval, before)
            status = 0
            missing: list[str] = []
            stack.callback(runner.stop)  # goes on where even this end was interrupted
            try:
                with self.patience.waiting():
                    runner.open()
                    missing = [] if self.arguments.replay else runner.missing
                    self.opened(runner)
                    ready = self._prepare(runner, missing)
                if ready:
                    self._start_showing(runner, watch)
                    seconds = None if self.duration is None else self.duration / 1e9
                    if seconds is None and not self.arguments.replay:
                        say_note("runs until its controllers are done, or until Ctrl-C; --for says how long")
                    self._end = runner.run(seconds, until=lambda: self._look(runner, watch))
                else:
                    status = 1
            except KeyboardInterrupt:
                status = 130
            except DeviceError as error:
                say(str(error))
                status = 1
            except CallerError as error:
                if NO_INTERFACE in str(error):  # python-can's own words
                    raise CallerError(f"{str(error).partition(NO_INTERFACE)[0]}{INTERFACE_HELP}") from error
                raise
            finally:
                self._say_what_falls(runner)
                ended, was_interrupted = self._stop(runner)
                status = 130 if was_interrupted else status
                self._stop_showing(watch, ended)
            if acts is not None:
                acts.note("end", self.robot.name, (self._end or ended).reason)
                (say if acts.failure else say_note)(str(acts))
            return self._summarise(runner, watch, self._end or ended, missing, status)

    def _acts(self, runner: Runner, stack: ExitStack) -> ActLog | None:
        """Return the log of who did what, if it is wanted; beside the first log of a run that moves a real robot."""
        path = self.arguments.acts
        if path is None and self.loggers and self.arguments.tx and self.is_real:
            path = f"{os.path.splitext(self.loggers[0].path)[0]}.acts.jsonl"
        if path is None:
            return None
        acts = stack.enter_context(ActLog(path, "aces run")).keep(runner)
        acts.note("begin", self.robot.name, " ".join(self.arguments.items))
        return acts

    @staticmethod
    def _stop(runner: Runner) -> tuple[Ended, bool]:
        """Stop; Ctrl-C shortens what hangs, and skips nothing. Return how the run ended, and whether there was one."""
        was_interrupted = False
        while True:
            try:
                return runner.stop(), was_interrupted
            except KeyboardInterrupt:
                was_interrupted = True

    @staticmethod
    def _say_what_falls(runner: Runner) -> None:
        """Name what this end does not hold, before it lets go."""
        for name, why in runner.letting_go.items():
            say(f"{name} cannot be held, and may fall: without this program it {why}")

    def _prepare(self, runner: Runner, missing: Sequence[str]) -> bool:
        """Home and enable the driven devices; return False when some of them are not there."""
        asked = self.arguments
        if missing and self.is_real and not (asked.ask or asked.tx):
            say(f"nothing came from {', '.join(missing)}: no other program asks; --ask does")
        elif missing:
            say(f"no answer from {', '.join(missing)}: powered, on this bus, and of this number?")
        if not runner.drives:
            return True
        driven = {
            device.name: device for supervisor in runner.supervisors for device in runner.driven(supervisor)
        }
        if any(name in driven for name in missing):
            say("nothing was moved: the driven devices must answer first")
            return False
        devices: list[Device] = list(driven.values())
        for name, why in runner.unparkable.items():
            say(f"{name} cannot be parked: {why}")
        self._say_what_falls(runner)
        if self.is_real and asked.enable:
            for device in devices:
                if device.host_loss.lacks_watchdog:
                    say_note(host_loss_text(device))
        if asked.home:
            homed = runner.do("home", HOME_S, devices=devices)
            if homed:
                say_note(f"homed: {', '.join(homed)}")
                runner.clock.wait(lambda: False, round(REST_S * 1e9))
        if not self._is_homed(runner):
            return False
        if asked.enable:
            runner.do("enable", ENABLE_S, devices=devices)
        return True

    def _is_homed(self, runner: Runner) -> bool:
        """Return whether what is driven is homed, where it has to be; says who is not."""
        if self.arguments.replay:
            return True
        runner.clock.wait(lambda: not runner.unhomed, round(HOMED_S * 1e9))
        if runner.unhomed:
            say(f"not homed, so that it is not known where they are: {', '.join(runner.unhomed)}")
            say("nothing was moved: --home homes them, --unhomed drives them all the same")
        elif self.arguments.unhomed and runner.rig.door.unhomed:
            say(f"driven although not homed: {', '.join(runner.rig.door.unhomed)}")
        return not runner.unhomed

    def _look(self, runner: Runner, watch: Watch) -> bool:
        """Show, and keep the pace; return whether the run is to end. Called every millisecond."""
        if self.patience.is_over or self.is_ended() or self._is_played(runner):
            return True
        now = time.monotonic_ns()
        if self.arguments.real_time and not self.is_real:
            ahead = self._began + round(runner.seconds * 1e9) - now
            if ahead > 0:
                time.sleep(ahead / 1e9)
        if now >= self._next:
            self._next = now + (PANEL_EVERY if self._live is not None else LINE_EVERY)
            if not self.arguments.quiet:
                self._show(watch.look(now))
        return False

    def _is_played(self, runner: Runner) -> bool:
        """Return whether all that has an end is at it, or the recording is."""
        if self.arguments.replay and runner.world.is_over:
            return True
        if self.duration is not None or runner.held:
            return False
        modes = [getattr(controller, "mode", None) for controller in self._bare]
        finite = [mode for mode in modes if isinstance(mode, str)]
        return bool(finite) and all(mode in ENDED for mode in finite)

    @property
    def _bare(self) -> Iterator[Any]:
        return (getattr(controller, "controller", controller) for controller in self.controllers)

    # ------------------------------------------------------------------ showing

    def _start_showing(self, runner: Runner, watch: Watch) -> None:
        self._began = time.monotonic_ns()
        watch.begin(self._began)
        self._next = self._began + (PANEL_EVERY if self._on_terminal else LINE_EVERY)
        if self.arguments.quiet:
            return
        if not self._on_terminal:
            runner.handlers.append(self._happened)
            return
        from rich.console import Console
        from rich.live import Live

        console = Console(no_color=not wants_colour(None, True), highlight=False)
        self._live = Live(console=console, auto_refresh=False, transient=False)
        with self._while_shown():
            self._live.start()

    @property
    def _on_terminal(self) -> bool:
        out = sys.stdout
        return (
            not self.arguments.quiet and out is not None and out.isatty() and os.environ.get("TERM") != "dumb"
        )

    def _show(self, figures: Figures) -> None:
        with self._while_shown():
            if self._live is None:
                print(plain_line(figures), flush=True)
                return
            size = self._live.console.size
            lines = panel(figures, self.title, min(size.width, terminal_width()), size.height - 1)
            self._live.update(to_rich(lines), refresh=True)

    @contextmanager
    def _while_shown(self) -> Generator[None]:
        """Survive a failing output: a closed reader ends the run as Ctrl-C does; a full disk does not."""
        try:
            yield
        except BrokenPipeError:
            abandon_stdout()
            self.patience.is_over = True
        except OSError as error:
            abandon_stdout()
            if not self._is_cut:
                say(
                    f"standard output: {error.strerror or error}: nothing more is shown there, which stops nothing"
                )
            self._is_cut = True

    def _stop_showing(self, watch: Watch, ended: Ended) -> None:
        if self._live is not None:
            self._show(watch.total(time.monotonic_ns(), ended.seconds))
            with self._while_shown():
                self._live.stop()
            self._live = None

    def _happened(self, event: Any) -> None:
        """Report events at once, without a panel; of repeated events the first."""
        if event.kind in USUAL:
            return
        key = event.kind, event.source
        self.said[key] = self.said.get(key, 0) + 1
        if self.said[key] <= FEW:
            say(event_text(event))

    # ------------------------------------------------------------------ the end

    def _summarise(
        self, runner: Runner, watch: Watch, ended: Ended, missing: Sequence[str], status: int
    ) -> int:
        for (kind, source), number in self.said.items():
            if number > FEW:
                say(f"{source}: {kind}: {number - FEW} more times")
        for name, reason in ended.tripped.items():
            say(f"{name} was {'held' if name in runner.held else 'stopped'}: {reason}")
        waiting = {controller.name: getattr(controller, "waiting", "") for controller in self._bare}
        idle = [name for name, what in waiting.items() if what and not runner.set_points]
        for name in idle:
            say(f"{name} gave no set-point: it waited for {waiting[name]}")
        if self.arguments.replay and (unmatched := runner.world.unmatched):
            say(f"{unmatched}; --bus BUS=CHANNEL says which is which")
        if self.arguments.replay and runner.missing:
            say(f"not in the recording: {', '.join(runner.missing)}")
        if ended.held:
            say(f"left enabled, where they are: {', '.join(ended.held)}")
            for name in ended.held:
                if runner.rig.devices[name].host_loss.after_s is not None:
                    say(host_loss_text(runner.rig.devices[name]))
        if ended.parked:
            say_note(f"parked: {', '.join(ended.parked)}")
        for name, why in ended.not_parked.items():
            say(f"NOT parked: {name}: {why}")
        if ended.let_go:
            say(f"not held, and switched off: {', '.join(ended.let_go)}")
        if ended.not_stopped:
            say(f"NOT switched off: {', '.join(ended.not_stopped)}")
        for text in ended.failed:
            say(f"at the end: {text}")
        tasks = runner.tasks.tasks
        for task in tasks if ended.seconds > 0 else ():
            if self.is_real:
                say_note(f"{task}{', SCHED_FIFO' if task.is_real_time else ''}")
        if self.is_real and self.arguments.real_time and not any(task.is_real_time for task in tasks):
            say_note("SCHED_FIFO is not allowed here (CAP_SYS_NICE, or an rtprio limit); it ran without")
        for logger in self.loggers:
            if logger.failure:
                say(f"{logger.path} is not whole: {logger.failure}; {logger}")
            else:
                say_note(str(logger))
        if often := often_clipped(runner):
            say(f"clipped again and again: {often}")
        clips = sum(c.total for s in runner.supervisors for c in s.guard.clips.values())
        counts = {
            "cycles": sum(task.ticks for task in tasks),
            "missed": sum(task.missed for task in tasks),
            "overruns": sum(task.overruns for task in tasks),
            "bus_ticks_missed": sum(host.counts.ticks_missed for host in runner.rig.hosts.values()),
            "set_points": runner.set_points,
            "clipped": clips,
            "events": sum(n for kind, n in watch.counts.items() if kind not in USUAL),
            "tripped": len(ended.tripped),
            "missing": len(missing),
        }
        sent = "" if runner.drives else " (set-points were not sent)"
        text = " ".join(f"{name}={number}" for name, number in counts.items())
        say(f"seconds={ended.seconds:.3f} {text}{sent}", who="")
        is_cut = self._is_cut or any(logger.failure for logger in self.loggers)
        return status or int(
            bool(ended.tripped or ended.failed or ended.not_parked or missing or idle or is_cut)
        )


@contextmanager
def _frames(path: str) -> Generator[Iterator[Frame]]:
    """Yield a CAN recording's frames, in order. Raises `CallerError` for one that is not CAN."""
    with open_recording(path) as capture:
        if not isinstance(capture, CanRecording):
            raise CallerError(f"{path}: a serial recording; --replay takes those of CAN")
        yield (frame for frames in capture.batches(1024) for frame in frames)
        if capture.lines_unreadable:
            say(f"{capture.name}: {capture.lines_unreadable} unreadable lines")
