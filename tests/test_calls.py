"""Whoever calls what is public with values of the annotated types meets its errors, and no other.

1. Calls are drawn over the public surface: functions and constructors whose parameters have types that can be drawn.
2. An error is right when it is one of `aces_bus.errors`: it says who, where and what next. Anything else is a fault.
"""

from __future__ import annotations

import inspect
import types
import typing
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from enum import Enum
from importlib import import_module
from pathlib import Path
from typing import Any, Literal, Union

import can
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from aces_bus import Frame, load_protocol
from aces_bus.errors import AcesError
from aces_bus.protocol import Protocol, Variant
from aces_bus.runtime import VirtualClock
from aces_bus.runtime.clock import Clock, EventClock
from tests.interpreted import looks_at_parameters
from tests.test_surface import packages

#: What is not called, with the reason.
LEFT_OUT = {
    "as_dict": "takes a record, which only scanners make",
    "Controller.step": "raises what a controller's author left out: NotImplementedError",
    "AcesBus": "joins a bus of this process, which other tests use",
    "Fuzzer.run": "judges as many examples as it is told, which may be any number",
    "Loop.start": "starts a thread",
    "MotorDevice": "the base of drivers, which say what it asks for",
    "PacketSender": "takes a gate that is open",
    "SingleMotor": "the base of drivers, which say what it asks for",
    "StreamScanner": "made by make_scanner, which checks what it is given",
}

_TEXTS = st.text(max_size=8) | st.sampled_from(["hubo", "robotis", "a", "LKP", "x.log", "m/s", "1"])
_PLAIN: dict[Any, st.SearchStrategy[Any]] = {
    int: st.integers(-(2**40), 2**40) | st.integers(-3, 300),
    float: st.floats() | st.integers(-3, 300).map(float),
    bool: st.booleans(),
    str: _TEXTS,
    bytes: st.binary(max_size=12),
    type(None): st.none(),
    Any: st.none() | st.integers(-9, 9) | _TEXTS,
    object: st.none() | st.integers(-9, 9) | _TEXTS,
    Frame: st.builds(Frame, st.integers(0, 0x7FF), st.binary(max_size=8)),
    Protocol: st.sampled_from(["hubo", "robotis"]).map(load_protocol),
    Variant: st.sampled_from(["hubo", "robotis"]).map(lambda name: load_protocol(name).variant()),
    **dict.fromkeys((Clock, EventClock, VirtualClock), st.builds(VirtualClock)),
}


#: Arguments of a call: by position, by keyword.
Arguments = st.SearchStrategy[tuple[list[Any], dict[str, Any]]]


class CannotBeDrawnError(Exception):
    """No strategy for a type."""


def drawn(kind: Any) -> st.SearchStrategy[Any]:
    """Values of a type; raises `CannotBeDrawnError`."""
    if kind in _PLAIN:
        return _PLAIN[kind]
    origin, inner = typing.get_origin(kind), typing.get_args(kind)
    if origin in (Union, types.UnionType):
        found: list[st.SearchStrategy[Any]] = []
        for one in inner:
            try:
                found.append(drawn(one))
            except CannotBeDrawnError:
                continue
        if found:
            return st.one_of(found)
    elif origin is Literal:
        return st.sampled_from(inner)
    elif origin in (list, Sequence, Iterable, Collection) and inner:
        return st.lists(drawn(inner[0]), max_size=3)
    elif origin is tuple and inner:
        if inner[-1] is Ellipsis:
            return st.lists(drawn(inner[0]), max_size=3).map(tuple)
        return st.tuples(*(drawn(one) for one in inner))
    elif origin in (dict, Mapping) and inner:
        return st.dictionaries(drawn(inner[0]), drawn(inner[1]), max_size=3)
    raise CannotBeDrawnError(kind)


def arguments_of(thing: Callable[..., Any]) -> Arguments:
    """Arguments for a call, by position and by keyword; raises `CannotBeDrawnError`."""
    target = thing.__init__ if inspect.isclass(thing) else thing
    thing = getattr(thing, "__func__", thing)
    try:
        hints = {
            **(typing.get_type_hints(thing) if inspect.isclass(thing) else {}),
            **typing.get_type_hints(target),
        }
        signature = inspect.signature(thing)
    except (NameError, TypeError, ValueError) as error:
        raise CannotBeDrawnError(thing) from error
    positional: list[st.SearchStrategy[Any]] = []
    needed: dict[str, st.SearchStrategy[Any]] = {}
    optional: dict[str, st.SearchStrategy[Any]] = {}
    for name, one in signature.parameters.items():
        if name == "self" or one.kind in (one.VAR_POSITIONAL, one.VAR_KEYWORD):
            continue
        try:
            value = drawn(hints.get(name, Any))
        except CannotBeDrawnError:
            if one.default is one.empty:
                raise
            continue
        if one.kind is one.POSITIONAL_ONLY:
            positional.append(value)
        elif one.default is one.empty:
            needed[name] = value
        else:
            optional[name] = value
    return st.tuples(st.tuples(*positional).map(list), st.fixed_dictionaries(needed, optional=optional))


def callables() -> Iterator[Any]:
    """Each public function and class that can be called with what can be drawn."""
    seen: set[Any] = set()
    for package in packages():
        module = import_module(package)
        for name in module.__all__:
            thing = getattr(module, name)
            if (
                name in LEFT_OUT
                or not callable(thing)
                or not getattr(thing, "__module__", "").startswith("aces_bus")
            ):
                continue
            if getattr(thing, "_is_protocol", False):
                continue
            if (
                thing in seen
                or inspect.isabstract(thing)
                or (inspect.isclass(thing) and issubclass(thing, BaseException))
            ):
                continue
            seen.add(thing)
            try:
                yield pytest.param(
                    thing, arguments_of(thing), id=f"{package.removeprefix('aces_bus.')}.{name}"
                )
            except CannotBeDrawnError:
                continue


CALLABLES = list(callables())


@looks_at_parameters
@pytest.mark.parametrize(("thing", "arguments"), CALLABLES)
def test_calls_raise_errors_of_ours(
    thing: Callable[..., Any], arguments: Arguments, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Values of the annotated types are taken, or refused with an `AcesError`."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))  # what this machine serves is nobody's business here
    monkeypatch.chdir(tmp_path)  # a drawn text may be the name of a file that is written

    @settings(
        max_examples=max(4, settings().max_examples // 10),
        suppress_health_check=[HealthCheck.too_slow, HealthCheck.filter_too_much],
    )
    @given(arguments)
    def check(given_arguments: tuple[list[Any], dict[str, Any]]) -> None:
        by_position, by_name = given_arguments
        try:
            thing(*by_position, **by_name)
        except (AcesError, can.CanError):  # what python-can says of its backends
            pass

    check()


#: Packages whose methods are not called: connections and buses open and wait; fields have hooks that construct calls, and
#: answers for.
CONSTRUCTORS_ONLY = ("aces_bus.access", "aces_bus.hardware", "aces_bus.protocol")


def methods() -> Iterator[Any]:
    """Each public method that can be called with what can be drawn, of the classes that can be made."""
    for one in CALLABLES:
        kind, arguments = one.values
        if (
            not inspect.isclass(kind)
            or issubclass(kind, Enum)
            or kind.__module__.startswith(CONSTRUCTORS_ONLY)
        ):
            continue
        for name, value in sorted(vars(kind).items()):
            if (
                name.startswith("_")
                or not isinstance(value, types.FunctionType)
                or f"{kind.__name__}.{name}" in LEFT_OUT
            ):
                continue
            try:
                yield pytest.param(kind, arguments, name, arguments_of(value), id=f"{one.id}.{name}")
            except CannotBeDrawnError:
                continue


@looks_at_parameters
@pytest.mark.parametrize(("kind", "made_of", "name", "arguments"), list(methods()))
def test_methods_raise_errors_of_ours(
    kind: Any,
    made_of: Arguments,
    name: str,
    arguments: Arguments,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A method takes values of the annotated types, or refuses them with an `AcesError`."""
    monkeypatch.chdir(tmp_path)  # as above

    @settings(
        max_examples=max(4, settings().max_examples // 10),
        suppress_health_check=[HealthCheck.too_slow, HealthCheck.filter_too_much],
    )
    @given(made_of, arguments)
    def check(
        made: tuple[list[Any], dict[str, Any]], given_arguments: tuple[list[Any], dict[str, Any]]
    ) -> None:
        try:
            instance = kind(*made[0], **made[1])
            getattr(instance, name)(*given_arguments[0], **given_arguments[1])
        except (AcesError, can.CanError):
            pass

    check()
