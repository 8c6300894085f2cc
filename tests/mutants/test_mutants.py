"""The planting of faults: which there are, that each is one, and that a planted one is found where a test looks."""

from __future__ import annotations

import types
from pathlib import Path

import pytest

from tests.conftest import ROOT

pytest.importorskip("coverage")  # a development tool

from tests.mutants.__main__ import AREAS, draw, mutants_in, sources
from tests.mutants.operators import KINDS, mutants_of
from tests.mutants.serve import functions_by_place, plant

SOURCE = '''\
"""A text that is not touched."""
def bounded(values, low=1):
    """Another."""
    if not values:
        raise ValueError("none")
    found = []
    for value in values[1:]:
        if value < low and value != 0:
            found.append(pow(value, low))
    return found
'''
EXPECTED = {
    "arguments: value, low -> low, value",
    "and/or: and -> or",
    "comparison: < -> <=",
    "comparison: < -> >=",
    "comparison: != -> ==",
    "constant: 0 -> 3",
    "constant: 1 -> 5",
    "deleted: found.append(pow(value, low)) -> pass",
    "exception: ValueError -> ArithmeticError",
    "guard: not values -> False",
    "not: not values -> (values)",
    'return: if not values: raise ValueError("none") -> return',
    "slice: 1 -> (1) + 1",
    "slice: 1 -> (1) - 1",
    "±1: 0 -> (-1)",
    "±1: 0 -> 1",
    "±1: 1 -> 0",
    "±1: 1 -> 2",
}


def test_every_kind_of_fault_has_its_place() -> None:
    """A function of nine lines has these faults and no others; texts, annotations and assertions have none."""
    found = mutants_of("some.py", SOURCE.encode())
    assert {one.name.partition(" ")[2] for one in found} == EXPECTED
    assert {one.kind for one in found} == set(KINDS)
    assert {one.scope for one in found} == {"", "bounded"}


@pytest.mark.parametrize("path", ["aces_bus/device/stopping.py", "aces_bus/protocol/generate/source.py"])
def test_a_fault_compiles_and_keeps_its_lines(path: str) -> None:
    """Each mutant differs from the source in its own lines alone, and Python can compile it."""
    for one in draw(mutants_in([path]), 15, "test"):
        source = (ROOT / one.path).read_bytes()
        changed = one.of(source)
        was, now = source.splitlines(), changed.splitlines()
        assert len(was) == len(now), one
        differ = [number for number, (old, new) in enumerate(zip(was, now, strict=True), 1) if old != new]
        assert differ, one
        assert differ[0] >= one.line - one.before.count("\n") - 1, one
        compile(changed, one.path, "exec")


def test_the_same_seed_draws_the_same() -> None:
    """What is drawn depends on sources and seed, kinds are mixed, and nothing is drawn twice."""
    mutants = mutants_in(["aces_bus/device/stopping.py"])
    drawn = draw(mutants, 60, "abc")
    assert drawn == draw(mutants, 60, "abc")
    assert drawn != draw(mutants, 60, "abd")
    assert len(set(drawn)) == 60
    assert len({one.kind for one in drawn}) >= 8


def test_every_area_has_files() -> None:
    """A folder that was renamed leaves no area empty."""
    assert [area for area, paths in AREAS.items() if not any((ROOT / path).exists() for path in paths)] == []
    assert all(Path(ROOT / path).exists() for path in AREAS["stops"])
    assert all(list(sources(paths)) for paths in AREAS.values())


def test_a_fault_is_planted_in_functions_that_are_there() -> None:
    """A function that others hold already runs the changed code; the original comes back the same way."""
    module = types.ModuleType("planted")
    exec(compile(SOURCE, "/planted/some.py", "exec"), module.__dict__)
    held = module.bounded
    functions = functions_by_place()
    (mutant,) = (one for one in mutants_of("some.py", SOURCE.encode()) if one.after == "(1) + 1")
    assert held([9, 2, 3], 5) == [32, 243]
    assert plant("/planted/some.py", mutant.of(SOURCE.encode()), functions) == 1
    assert held([9, 2, 3], 5) == [243]
    assert plant("/planted/some.py", SOURCE.encode(), functions) == 1
    assert held([9, 2, 3], 5) == [32, 243]
