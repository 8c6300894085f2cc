"""Equations as text: checked when they are written down, then compiled to one Python function each.

1. Only what is listed here can be said: numbers, states at a time, names, arithmetic, comparisons, the functions of
   `FUNCTIONS`. Nothing of Python comes through: no attribute, no call of anything else, so a text may come from anywhere.
2. Whatever is wrong is found at definition, with its line and the names that exist.
3. Numbers are floats, so that no text can ask for a number of a million digits.

The notation is the paper's, in ASCII:

    error = goal - LKP[0]                  a quantity of this step
    LKP[0] = LKP[0] + kp*error - kd*d(LKP) a set-point for LKP, from its value and derivative now
    RAP[0] = 0.5*LAP[-0.02]                a value 20 ms ago
    theta["left.AP"][0] = …                a state whose name is not an identifier

`d(x)` is the state's `rate()` now, `d(x)[-0.1]` a while ago, `integral(x)` its `integral()`; `t` are seconds since the
start, `dt` since the last step.
An assignment sets: `x[0] = …` gives a set-point when all lines are through, so that `x[0]` on a right side is the value
measured, in every line.
"""

from __future__ import annotations

import ast
import linecache
import math
import warnings
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from types import CodeType
from typing import Any

from ..errors import CallerError

#: More text than is ever written; parsing is quadratic in the worst case.
LONGEST = 20_000


def sat(x: float, low: float, high: float) -> float:
    """Return `x` limited to [low, high]."""
    return low if x < low else high if x > high else x


def quantize(x: float, step: float, base: float = 0.0) -> float:
    """Return `x` rounded to the grid base + n·step."""
    return base + step * round((x - base) / step)


FUNCTIONS: dict[str, Callable[..., Any]] = {
    **{
        function: getattr(math, function)
        for function in ("sin", "cos", "tan", "asin", "acos", "atan", "atan2", "sqrt", "exp")
    },
    **{function: getattr(math, function) for function in ("log", "log10", "ceil", "floor", "fmod", "hypot")},
    "abs": abs,
    "min": min,
    "max": max,
    "sat": sat,
    "quantize": quantize,
}
CONSTANTS = {"pi": math.pi, "true": 1.0, "false": 0.0}
TIMES = ("t", "dt")
#: The derivative and the integral of a state, and the method of a state that gives them.
OF_A_STATE = {"d": "rate", "integral": "integral"}
GROUP = "theta"
RESERVED = {*FUNCTIONS, *CONSTANTS, *TIMES, *OF_A_STATE, GROUP}

BINARY: dict[type[ast.operator], str] = {
    ast.Add: "+",
    ast.Sub: "-",
    ast.Mult: "*",
    ast.Div: "/",
    ast.FloorDiv: "//",
    ast.Mod: "%",
    ast.Pow: "**",
}
COMPARE: dict[type[ast.cmpop], str] = {
    ast.Lt: "<",
    ast.LtE: "<=",
    ast.Gt: ">",
    ast.GtE: ">=",
    ast.Eq: "==",
    ast.NotEq: "!=",
}


class EquationError(CallerError):
    """An equation is wrong: says where, and what there is."""


@dataclass
class Scope:
    """The names that equations of one controller may use, and the states they turned out to use.

    `states` None lets them name any; `parameters` stay the same unless the user changes them, `memory` keeps its value from
    step to step and may be assigned.
    """

    owner: str
    states: tuple[str, ...] | None = None
    parameters: Mapping[str, float] = field(default_factory=dict[str, float])
    memory: Mapping[str, float] = field(default_factory=dict[str, float])
    #: State that is read → its name in the printed code.
    used: dict[str, str] = field(default_factory=dict[str, str])
    #: The same for what a method of a state gives.
    derived: dict[tuple[str, str], str] = field(default_factory=dict[tuple[str, str], str])

    def __post_init__(self) -> None:
        for name in (*self.parameters, *self.memory):
            if not name.isidentifier() or name.startswith("_") or name in RESERVED:
                raise EquationError(f"{self.owner}: {name!r} cannot be the name of a parameter or of memory")
            if name in self.memory and name in self.parameters:
                raise EquationError(f"{self.owner}: {name!r} is both a parameter and memory")

    def is_state(self, name: str) -> bool:
        """Return whether there may be a state of that name."""
        return name in self.states if self.states is not None else True

    def read(self, name: str) -> str:
        """Return how the printed code calls a state that is read."""
        return self.used.setdefault(name, f"S{len(self.used)}")

    def derive(self, name: str, method: str) -> str:
        """Return the same for what a method of the state gives."""
        self.read(name)
        return self.derived.setdefault((name, method), f"Q{len(self.derived)}")

    def names(self) -> str:
        """Return what there is, for people."""
        parts = [
            ("states", self.states if self.states is not None else self.used),
            ("parameters", self.parameters),
            ("memory", self.memory),
            ("always", [*TIMES, "pi"]),
        ]
        return "; ".join(f"{title}: {', '.join(names)}" for title, names in parts if names)


class _Printer:
    """One text, checked and printed."""

    def __init__(self, scope: Scope, place: str, text: str) -> None:
        self.scope, self.place, self.text = scope, place, text.splitlines()
        self.locals: set[str] = set()
        self.lines: list[str] = []
        self.setpoints: dict[str, str] = {}

    def fail(self, node: ast.AST, what: str, there_are: str = "") -> EquationError:
        line = getattr(node, "lineno", 1)
        text = self.text[line - 1][:80] if line <= len(self.text) else ""
        return EquationError(
            f"{self.scope.owner}: {self.place}, line {line} ({text}): {what} ({there_are or self.scope.names()})"
        )

    # ---- expressions ----------------------------------------------------------------------------------------------

    def expression(self, node: ast.expr) -> str:
        """Return the Python text of an expression."""
        match node:
            case ast.Constant(value=bool(value)):
                return str(value)
            case ast.Constant(value=int() | float() as value):
                number = float(value) if abs(value) < 1e300 else math.inf
                if math.isinf(number):
                    raise self.fail(node, f"{str(value)[:20]} is too large a number")
                return repr(number)
            case ast.Name(id=name):
                return self.name(node, name)
            case ast.Subscript(value=value, slice=index):
                state = self.quantity(value)
                zero = isinstance(index, ast.Constant) and index.value == 0
                return f"{state}[{'0' if zero else self.expression(index)}]"
            case ast.Call(func=ast.Name(id=name), args=arguments, keywords=[]):
                return self.call(node, name, arguments)
            case ast.UnaryOp(op=ast.USub(), operand=operand):
                return f"(-{self.expression(operand)})"
            case ast.UnaryOp(op=ast.UAdd(), operand=operand):
                return self.expression(operand)
            case ast.UnaryOp(op=ast.Not(), operand=operand):
                return f"(not {self.expression(operand)})"
            case ast.BinOp(left=left, op=op, right=right) if type(op) in BINARY:
                return f"({self.expression(left)} {BINARY[type(op)]} {self.expression(right)})"
            case ast.BoolOp(op=op, values=values):
                word = " and " if isinstance(op, ast.And) else " or "
                return f"({word.join(self.expression(part) for part in values)})"
            case ast.Compare(left=left, ops=ops, comparators=rest) if all(type(op) in COMPARE for op in ops):
                text = self.expression(left)
                for sign, next_part in zip(ops, rest, strict=True):
                    text += f" {COMPARE[type(sign)]} {self.expression(next_part)}"
                return f"({text})"
            case ast.IfExp(test=test, body=body, orelse=orelse):
                return f"({self.expression(body)} if {self.expression(test)} else {self.expression(orelse)})"
            case _:
                raise self.fail(node, f"{ast.unparse(node)[:40]!r} is not part of an equation")

    def name(self, node: ast.AST, name: str) -> str:
        """Return a name on a right side."""
        if name in self.locals:
            return f"v_{name}"
        if name in TIMES:
            return name
        if name in CONSTANTS:
            return repr(CONSTANTS[name])
        if name in self.scope.parameters or name in self.scope.memory:
            return f"m.{name}"
        if name in (self.scope.states or self.scope.used):
            raise self.fail(node, f"{name} is a state: write {name}[0] for its value now")
        raise self.fail(node, f"nothing is called {name!r} here (a state's value is written {name}[0])")

    def state(self, node: ast.expr) -> str:
        """Return the state in front of an index, as its name or as theta["its name"]."""
        match node:
            case ast.Name(id=name) if name not in RESERVED and name not in self.locals:
                pass
            case ast.Subscript(value=ast.Name(id=group), slice=ast.Constant(value=str(name))) if (
                group == GROUP
            ):
                pass
            case _:
                raise self.fail(node, f"{ast.unparse(node)[:40]} is not a state")
        if name in self.scope.parameters or name in self.scope.memory:
            raise self.fail(node, f"{name} is a number, not a state: write it without an index")
        if not self.scope.is_state(name):
            raise self.fail(node, f"no state is called {name!r}")
        return name

    def quantity(self, node: ast.expr) -> str:
        """Return what can be read at a time: a state, d(state) or integral(state)."""
        match node:
            case ast.Call(func=ast.Name(id=name), args=arguments, keywords=[]) if name in OF_A_STATE:
                if len(arguments) != 1:
                    raise self.fail(node, f"{name}(state) takes one state")
                return self.scope.derive(self.state(arguments[0]), OF_A_STATE[name])
            case _:
                return self.scope.read(self.state(node))

    def call(self, node: ast.expr, name: str, arguments: list[ast.expr]) -> str:
        if name in OF_A_STATE:
            return f"{self.quantity(node)}[0]"
        if name not in FUNCTIONS:
            raise self.fail(
                node, f"there is no function {name!r}", f"there are: {', '.join([*OF_A_STATE, *FUNCTIONS])}"
            )
        return f"f_{name}({', '.join(self.expression(argument) for argument in arguments)})"

    # ---- lines ----------------------------------------------------------------------------------------------------

    def line(self, node: ast.stmt) -> None:
        """Print one equation."""
        match node:
            case ast.Assign(targets=[ast.Name(id=name)], value=value):
                text = self.expression(value)
                self.lines.append(f"{self.target(node, name)} = {text}")
            case ast.AugAssign(target=ast.Name(id=name), op=op, value=value) if type(op) in BINARY:
                before = self.name(node, name)
                text = f"({before} {BINARY[type(op)]} {self.expression(value)})"
                self.lines.append(f"{self.target(node, name)} = {text}")
            case ast.Assign(targets=[ast.Subscript(value=owner, slice=index)], value=value):
                if not (isinstance(index, ast.Constant) and index.value == 0):
                    raise self.fail(node, "only the present can be set: write [0] on the left")
                state = self.state(owner)
                if state in self.setpoints:
                    raise self.fail(node, f"{state} is set twice")
                target = f"p{len(self.setpoints)}"
                self.lines.append(f"{target} = {self.expression(value)}")
                self.setpoints[state] = target
            case _:
                raise self.fail(node, "an equation is 'name = …' or 'state[0] = …'")

    def target(self, node: ast.AST, name: str) -> str:
        if name in self.scope.memory:
            return f"m.{name}"
        for is_so, why in (
            (
                name in self.scope.parameters,
                f"{name} is a parameter; only memory and new names can be assigned",
            ),
            (name in RESERVED or name.startswith("_"), f"{name!r} cannot be assigned"),
            (name in (self.scope.states or self.scope.used), f"{name} is a state: write {name}[0] = …"),
        ):
            if is_so:
                raise self.fail(node, why)
        self.locals.add(name)
        return f"v_{name}"


def _parsed(scope: Scope, place: str, text: str, mode: str) -> ast.AST:
    if len(text) > LONGEST:
        raise EquationError(f"{scope.owner}: {place}: {len(text)} characters are more than {LONGEST}")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", SyntaxWarning)  # "1if" is not an equation either
            return ast.parse(text, mode=mode)
    except SyntaxError as error:
        line = f"line {error.lineno}" if error.lineno else "somewhere"
        raise EquationError(
            f"{scope.owner}: {place}, {line}: {error.msg}: {(error.text or '').strip()}"
        ) from None
    except (ValueError, RecursionError, MemoryError):
        raise EquationError(f"{scope.owner}: {place}: cannot be read as equations") from None


def flush(text: str) -> str:
    """Remove the indentation of the lines: nothing nests in equations, so it says nothing."""
    return "\n".join(line.strip() for line in text.splitlines())


@dataclass
class EquationBlock:
    """Printed equations or a printed condition; `setpoints` are the states it sets."""

    source: list[str]
    setpoints: tuple[str, ...] = ()


def equations(scope: Scope, place: str, text: str) -> EquationBlock:
    """Check and print lines of equations: a function's body that returns set-points."""
    text = flush(text)
    tree = _parsed(scope, place, text, "exec")
    assert isinstance(tree, ast.Module)
    printer = _Printer(scope, place, text)
    try:
        for node in tree.body:
            printer.line(node)
    except RecursionError:
        raise EquationError(f"{scope.owner}: {place}: nested too deeply") from None
    pairs = ", ".join(f"{state!r}: {target}" for state, target in printer.setpoints.items())
    return EquationBlock([*printer.lines, f"return {{{pairs}}}"], tuple(printer.setpoints))


def condition(scope: Scope, place: str, text: str) -> EquationBlock:
    """Check and print one expression: a function's body that returns its value."""
    text = flush(text).strip()
    tree = _parsed(scope, place, text, "eval")
    assert isinstance(tree, ast.Expression)
    try:
        return EquationBlock([f"return {_Printer(scope, place, text).expression(tree.body)}"])
    except RecursionError:
        raise EquationError(f"{scope.owner}: {place}: nested too deeply") from None


#: Seconds since the start, seconds since the last step → set-points, or a condition's value.
Compiled = Callable[[float, float], Any]


class Program:
    """All blocks of one controller as one Python text; `bind` gives its functions for states and memory.

    States are closed over, not looked up: an access costs what the state's own `[0]` costs.
    """

    def __init__(self, scope: Scope, blocks: Mapping[str, EquationBlock]) -> None:
        self.scope = scope
        names = [*scope.used.values(), *scope.derived.values()]
        lines = [f"def bind({', '.join([*names, 'm'])}):"]
        for name, block in blocks.items():
            lines.append(f"    def {name}(t, dt):")
            lines += [f"        {line}" for line in block.source]
        lines.append(f"    return {{{', '.join(f'{name!r}: {name}' for name in blocks)}}}")
        self.source = "\n".join(lines) + "\n"
        self.file = f"<equations of {scope.owner}>"
        try:
            self._code: CodeType = compile(self.source, self.file, "exec")
        except (SyntaxError, RecursionError, MemoryError):
            raise EquationError(f"{scope.owner}: its equations are nested too deeply") from None

    def bind(self, states: Mapping[str, Any], memory: object) -> dict[str, Compiled]:
        """Compile the functions; `states` has every used name, `memory` the parameters and memory as attributes."""
        quantities = [states[name] for name in self.scope.used]
        for name, method in self.scope.derived:
            if not hasattr(states[name], method):
                raise EquationError(f"{self.scope.owner}: the state {name!r} has no {method}()")
            quantities.append(getattr(states[name], method)())
        # So that a traceback shows the equation.
        linecache.cache[self.file] = (
            len(self.source),
            None,
            self.source.splitlines(keepends=True),
            self.file,
        )
        room: dict[str, Any] = {f"f_{name}": function for name, function in FUNCTIONS.items()}
        room["__builtins__"] = {}
        exec(self._code, room)
        bound: dict[str, Compiled] = room["bind"](*quantities, memory)
        return bound


def as_states(states: Iterable[str] | None) -> tuple[str, ...] | None:
    """Return the states that were declared; None leaves it to the equations."""
    return None if states is None else tuple(dict.fromkeys(states))
