"""State machines as tables: phases with equations, guarded transitions, and the same table as a diagram.

1. The table is data. It is checked when it is written down: targets that are missing, phases that cannot be reached and
   phases without a way out that are not final are named.
2. At most one transition a step, the first in the table's order whose guard holds; rows from "*" come before the others.
   So a step ends.
3. A transition runs the exit equations of the old phase and the entry equations of the new one; then the step evaluates the
   new phase's equations. Later set-points of a step win.

Guards and equations are the language of `aces_bus.controller.language`, or functions. A row with `on=` is taken by an
event of that kind (the paper's shortcut), a row with `after_s=` when the phase has lasted that long; with a guard too, both
must hold.
"""

from __future__ import annotations

import re
from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

from ..errors import CallerError
from .base import NOTHING, LawController, StateLike
from .events import EventLike
from .language import Compiled, EquationBlock, Program, Scope, as_states, condition, equations

#: A function in place of a text: takes the machine (its `bound` states, `values`, `phase_s`).
Action = Callable[["StateMachine"], Mapping[str, float] | None]
Test = Callable[["StateMachine"], bool]
ANY = "*"


class MachineError(CallerError):
    """A table is wrong: names all that is."""


@dataclass(frozen=True)
class Phase:
    """A phase: what is evaluated each step, on entry and on exit. `final` ends the machine."""

    name: str
    each: str | Action = ""
    entry: str | Action = ""
    exit: str | Action = ""
    final: bool = False


@dataclass(frozen=True)
class Transition:
    """A transition of the table; `source` "*" is any phase that is not final. `after_s` in seconds."""

    source: str
    target: str
    when: str | Test = ""
    on: str = ""
    after_s: float | None = None

    @property
    def label(self) -> str:
        """The condition, for diagrams."""
        parts = [f"on {self.on}"] if self.on else []
        parts += [f"after {self.after_s:g} s"] if self.after_s is not None else []
        when = self.when if isinstance(self.when, str) else getattr(self.when, "__name__", "guard")
        return " and ".join([*parts, *([when.strip()] if when else [])])


@dataclass
class _Arrow:
    """A row as the interpreter walks it."""

    target: _Room
    row: Transition
    test: Callable[[float, float], object] | None = None
    after_ns: int = -1


@dataclass
class _Room:
    """A phase as the interpreter walks it."""

    phase: Phase
    each: Compiled | None = None
    entry: Compiled | None = None
    exit: Compiled | None = None
    gives: bool = False  # whether `each` may set states
    arrows: tuple[_Arrow, ...] = ()  # those that need no event
    by_event: dict[str, list[_Arrow]] = field(default_factory=dict[str, "list[_Arrow]"])


Mode = Literal["ready", "running", "paused", "stopped", "done"]


class StateMachine(LawController):
    """A controller that is a table.

    >>> crouch = StateMachine(
    ...     "crouch", rate_hz=15, memory={"a": 0.0},
    ...     phases=[
    ...         Phase("wait"),
    ...         Phase("down", each="a += 0.5 \\n LKP[0] = 2*a"),
    ...         Phase("up", each="a -= 0.5 \\n LKP[0] = 2*a"),
    ...     ],
    ...     table=[
    ...         Transition("wait", "down", after_s=0.1),
    ...         Transition("down", "up", "a >= 1"),
    ...         Transition("up", "down", "a <= 0"),
    ...     ])
    >>> crouch.start(0)
    >>> [dict(crouch.step(n * 66_666_667)) for n in range(5)]
    [{}, {}, {'LKP': 1.0}, {'LKP': 2.0}, {'LKP': 1.0}]
    >>> print(crouch.mermaid())
    stateDiagram-v2
        [*] --> wait
        wait --> down: after 0.1 s
        down --> up: a >= 1
        up --> down: a <= 0

    The first phase is where it starts. `pause`, `resume` and `single` (one step while paused) are for whoever watches it;
    `stop` runs the phase's exit equations no more: it stands still. `transitions` counts, `trail` has the latest as
    (instant ns, from, to).
    """

    def __init__(
        self,
        name: str,
        *,
        phases: Sequence[Phase],
        table: Sequence[Transition],
        rate_hz: float,
        states: Iterable[str] | None = None,
        parameters: Mapping[str, float] | None = None,
        memory: Mapping[str, float] | None = None,
    ) -> None:
        self.phases, self.table = tuple(phases), tuple(table)
        faults = table_faults(self.phases, self.table)
        if faults:
            raise MachineError(f"state machine {name!r}: " + "; ".join(faults))
        scope = Scope(name, as_states(states), dict(parameters or {}), dict(memory or {}))
        blocks: dict[str, EquationBlock] = {}
        for i, phase in enumerate(self.phases):
            for part, text in (("each", phase.each), ("entry", phase.entry), ("exit", phase.exit)):
                if isinstance(text, str) and text.strip():
                    blocks[f"{part}_{i}"] = equations(scope, f"phase {phase.name!r}, {part}", text)
        for i, row in enumerate(self.table):
            if isinstance(row.when, str) and row.when.strip():
                place = f"transition {row.source!r} → {row.target!r}"
                blocks[f"guard_{i}"] = condition(scope, place, row.when)
        self._program = Program(scope, blocks)
        self._giving = {i for i, phase in enumerate(self.phases) if callable(phase.each)} | {
            int(place[5:]) for place, block in blocks.items() if place.startswith("each_") and block.setpoints
        }
        super().__init__(
            name,
            rate_hz=rate_hz,
            states=[*(states or ()), *scope.used],
            writes=[state for block in blocks.values() for state in block.setpoints],
            parameters=scope.parameters,
            memory=scope.memory,
        )
        self._law = self._cycle
        self.mode: Mode = "ready"
        self.transitions = 0
        self.trail: deque[tuple[int, str, str]] = deque(maxlen=64)
        self._events: deque[str] = deque(maxlen=64)  # filled from any thread
        self._kinds = {row.on for row in self.table if row.on}
        self._singles = 0
        self._rooms: list[_Room] = []
        self._room: _Room | None = None
        self._since = 0  # ns of entry
        self._now = 0

    # ---- the table as a picture ------------------------------------------------------------------------------------

    def mermaid(self) -> str:
        """Return the table as a Mermaid state diagram."""
        return mermaid(self.phases, self.table)

    def dot(self) -> str:
        """Return the table as a Graphviz graph."""
        return dot(self.name, self.phases, self.table)

    # ---- operations -------------------------------------------------------------------------------------------------

    @property
    def phase(self) -> str | None:
        """The name of the present phase; None before the start."""
        return self._room.phase.name if self._room else None

    @property
    def phase_s(self) -> float:
        """Seconds in the present phase, as of the last step."""
        return (self._now - self._since) / 1e9

    @property
    def is_idle(self) -> bool:
        """True if the machine has nothing to send and says so: in a phase without set-points, at its end, or paused."""
        return self.mode in ("paused", "done") or (self._room is not None and not self._room.gives)

    def pause(self) -> None:
        """Give no set-points until `resume`; time in the phase goes on."""
        if self.mode == "running":
            self.mode = "paused"

    def resume(self) -> None:
        """Go on after `pause`."""
        if self.mode == "paused":
            self.mode = "running"

    def single(self) -> None:
        """Let the next step happen although it is paused."""
        self._singles += 1

    def handle(self, event: EventLike) -> None:
        """Queue an event: rows with `on` of its kind are tried at the next step."""
        if event.kind in self._kinds:  # so that a flood of others pushes none of these out
            self._events.append(event.kind)

    # ---- the interpreter --------------------------------------------------------------------------------------------

    def bind(self, states: Mapping[str, StateLike]) -> None:
        """Take the states it reads."""
        super().bind(states)
        compiled = self._program.bind(self.bound, self.values)
        self._rooms = [_Room(phase) for phase in self.phases]
        by_name = {room.phase.name: room for room in self._rooms}
        for i, room in enumerate(self._rooms):
            room.gives = i in self._giving
            room.each = self._part(room.phase.each, compiled.get(f"each_{i}"))
            room.entry = self._part(room.phase.entry, compiled.get(f"entry_{i}"))
            room.exit = self._part(room.phase.exit, compiled.get(f"exit_{i}"))
            if room.phase.final:
                continue
            mine = [(j, row) for j, row in enumerate(self.table) if row.source == ANY != row.target]
            mine += [(j, row) for j, row in enumerate(self.table) if row.source == room.phase.name]
            timed: list[_Arrow] = []
            for j, row in mine:
                if row.source == ANY and row.target == room.phase.name:
                    continue  # it is there
                after = -1 if row.after_s is None else round(row.after_s * 1e9)
                test = self._part(row.when, compiled.get(f"guard_{j}"))
                arrow = _Arrow(by_name[row.target], row, test, after)
                (room.by_event.setdefault(row.on, []) if row.on else timed).append(arrow)
            room.arrows = tuple(timed)

    def _part(
        self, text: str | Callable[[StateMachine], object], printed: Compiled | None
    ) -> Compiled | None:
        if callable(text):
            action = text
            return lambda t, dt: action(self)
        return printed

    def start(self, now: int) -> None:
        """Begin a run in the first phase, with memory's first values; entry equations run at the first step."""
        super().start(now)
        if not self._rooms:
            self.bind({})
        self._events.clear()
        self._room, self._singles = None, 0
        self.mode, self.transitions = "running", 0
        self.trail.clear()

    def stop(self, now: int) -> None:
        """Stand still: nothing is evaluated any more."""
        self.mode = "stopped"

    def step(self, now_ns: int) -> Mapping[str, float]:
        """Run one cycle: at most one transition, then the phase's equations (rules 2 and 3)."""
        if self.mode != "running":
            if self.mode == "ready":
                self.start(now_ns)
            elif self.mode == "paused" and self._singles:
                self._singles -= 1
            else:
                return NOTHING
        self._now = now_ns
        return super().step(now_ns)

    def _cycle(self, t: float, dt: float) -> Mapping[str, float] | None:
        given: Mapping[str, float] | None = None
        room = self._room
        if room is None:
            room = self._rooms[0]
            given = self._enter(room, t, dt)
        else:
            arrow = self._open(room, self._now - self._since, t, dt)
            if arrow is not None:
                given = room.exit(t, dt) if room.exit is not None else None
                room = arrow.target
                given = self._enter(room, t, dt, given)
        if room.each is not None and self.mode != "done":
            given = _joined(given, room.each(t, dt))
        return given

    def _open(self, room: _Room, lasted: int, t: float, dt: float) -> _Arrow | None:
        while self._events:
            for arrow in room.by_event.get(self._events.popleft(), ()):
                if lasted >= arrow.after_ns and (arrow.test is None or arrow.test(t, dt)):
                    return arrow
        for arrow in room.arrows:
            if lasted >= arrow.after_ns and (arrow.test is None or arrow.test(t, dt)):
                return arrow
        return None

    def _enter(
        self, room: _Room, t: float, dt: float, given: Mapping[str, float] | None = None
    ) -> Mapping[str, float] | None:
        if self._room is not None:
            self.transitions += 1
            self.trail.append((self._now, self._room.phase.name, room.phase.name))
        self._room, self._since = room, self._now
        if room.phase.final:
            self.mode = "done"
        return given if room.entry is None else _joined(given, room.entry(t, dt))


def _joined(
    given: Mapping[str, float] | None, more: Mapping[str, float] | None
) -> Mapping[str, float] | None:
    return {**given, **more} if given and more else more or given


def table_faults(phases: Sequence[Phase], table: Sequence[Transition]) -> list[str]:
    """Return what is wrong with a table, one line each."""
    names = [phase.name for phase in phases]
    final = {phase.name for phase in phases if phase.final}
    if not names:
        return ["it has no phase"]
    listed = ", ".join(names)
    faults = [f"the phase {name!r} is there twice" for name in dict.fromkeys(names) if names.count(name) > 1]
    faults += [f"a phase cannot be called {name!r}" for name in names if name == ANY or not name.strip()]
    for number, row in enumerate(table, 1):
        where = f"row {number} ({row.source!r} → {row.target!r})"
        if row.source != ANY and row.source not in names:
            faults.append(f"{where}: there is no phase {row.source!r} (there are: {listed})")
        if row.target not in names:
            faults.append(f"{where}: there is no phase {row.target!r} (there are: {listed})")
        if row.source in final:
            faults.append(f"{where}: {row.source!r} is final")
        if not (row.when or row.on) and row.after_s is None:
            faults.append(f"{where}: says neither when, on nor after_s")
        if row.after_s is not None and not 0 <= row.after_s < 1e9:
            faults.append(f"{where}: after_s = {row.after_s!r} is not a time")
    if faults:
        return faults
    reached, todo = {names[0]}, [names[0]]
    while todo:
        here = todo.pop()
        for row in table:
            if row.source in (here, ANY) and here not in final and row.target not in reached:
                reached.add(row.target)
                todo.append(row.target)
    unreached = [name for name in names if name not in reached]
    if unreached:
        faults.append(f"no way leads from {names[0]!r} to {', '.join(map(repr, unreached))}")
    stuck = [
        name for name in names if name not in final and not any(row.source in (name, ANY) for row in table)
    ]
    if stuck and len(names) > 1:
        faults.append(f"no way leads out of {', '.join(map(repr, stuck))}; say final=True if that is meant")
    return faults


# ---- the table as a picture: names that a diagram language cannot write get an alias; none is left out


def _expanded(phases: Sequence[Phase], table: Sequence[Transition]) -> list[tuple[str, str, str]]:
    """Return the rows with "*" written out."""
    rows: list[tuple[str, str, str]] = []
    for row in table:
        sources = [phase.name for phase in phases if not phase.final and phase.name != row.target]
        rows += [
            (source, row.target, row.label) for source in (sources if row.source == "*" else [row.source])
        ]
    return rows


def mermaid(phases: Sequence[Phase], table: Sequence[Transition]) -> str:
    """Return a Mermaid state diagram."""
    lines = ["stateDiagram-v2"]
    ids: dict[str, str] = {}
    for phase in phases:
        plain = re.fullmatch(r"[A-Za-z]\w*", phase.name) and phase.name not in ("state", "note", "end")
        ids[phase.name] = phase.name if plain else f"phase_{len(ids)}"
        if not plain:
            lines.append(f'    state "{_quoted(phase.name)}" as {ids[phase.name]}')
    lines.append(f"    [*] --> {ids[phases[0].name]}")
    for source, target, label in _expanded(phases, table):
        # A colon or a semicolon would end the label.
        text = label.replace(";", ",").replace(":", "").replace("\n", " ")
        lines.append(f"    {ids[source]} --> {ids[target]}" + (f": {text}" if text else ""))
    lines += [f"    {ids[phase.name]} --> [*]" for phase in phases if phase.final]
    return "\n".join(lines)


def dot(name: str, phases: Sequence[Phase], table: Sequence[Transition]) -> str:
    """Return a Graphviz graph."""
    lines = [f'digraph "{_quoted(name)}" {{', "    start [shape=point];"]
    for phase in phases:
        shape = "doublecircle" if phase.final else "ellipse"
        lines.append(f'    "{_quoted(phase.name)}" [shape={shape}];')
    lines.append(f'    start -> "{_quoted(phases[0].name)}";')
    for source, target, label in _expanded(phases, table):
        lines.append(f'    "{_quoted(source)}" -> "{_quoted(target)}" [label="{_quoted(label)}"];')
    return "\n".join([*lines, "}"])


def _quoted(text: str) -> str:
    return text.replace("\\", "\\\\").replace('"', '\\"').replace("\n", " ")
