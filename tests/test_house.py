"""The budgets of the house: what each ring may weigh. A budget is raised in the change that needs it, with its reason."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.house import House

pytestmark = pytest.mark.slow

#: Figure → its budget, and the reason of the last raise. Lower a budget when a figure falls well below it.
BUDGETS: dict[str, tuple[int, str]] = {
    "statements of aces_bus": (
        44_150,
        "pictures, notebooks and conversion of issue 34;"
        " e-stops, stops through the lock, parking, measured limits; the language of issue 30; C source left;"
        " fields by bits read where they stand;"
        " types instead of Any need imports; parking that waits for late answers",
    ),
    "statements of the kernel": (
        10_440,
        "nodes answer what readers ask; fields by bits, of any mask by one function; names of any kind in errors;"
        " two scales, payloads from the header;"
        " packets that come by two transports; answers without a head, judged while they are awaited;"
        " layouts with selectors beside fields by bits;"
        " types instead of Any need imports; records and names of flags in printed encoders",
    ),
    "public names": (180, "what a check covers of the request; quantities of two scales"),
    "members of public names": (900, ""),
    "names of seams": (
        412,
        "names that left the surface; what strangers' plug-ins need; proofs name what they read; files with bodies;"
        " C and Wireshark read plans from the lab;"
        " what a field, a packet, a frame is, by name",
    ),
    "files in a knot of imports": (16, ""),
    "files that ask nodes for their class": (12, ""),
    "bases with one subclass": (23, "the fetching and the decoder of fields by bits"),
    "test files that import the inside": (40, ""),
    "times that Any is written": (
        2_999,
        "proofs run generated text on values of any kind; tables of specs; rooms over libraries without types;"
        " a record's fields by name, and what construct parses, builds and asks (the struct knows, no checker does);"
        " packets of ports and gates (the link says which); keywords that are passed on; arrays of any dtype;"
        " what is checked at a door, as wrong calls get an answer; tables of TOML and JSON that tests index",
    ),
    "docstrings that begin with a riddle": (0, ""),
    "docstrings that do not begin with a verb": (0, ""),
}


@pytest.fixture(scope="module")
def figures() -> dict[str, int]:
    """The figures of this checkout."""
    house = House(Path(__file__).resolve().parents[1])
    statements, texts = house.statements(), house.docstrings()
    return {
        "statements of aces_bus": statements["aces_bus"],
        "statements of the kernel": statements["kernel"],
        "public names": house.public_names(),
        "members of public names": house.members(),
        "names of seams": house.seams(),
        "files in a knot of imports": len(house.knot()),
        "files that ask nodes for their class": len(house.node_readers()),
        "bases with one subclass": len(house.lone_bases()),
        "test files that import the inside": len(house.inside_tests()),
        "times that Any is written": house.any_words(),
        "docstrings that begin with a riddle": sum(texts.values()) - texts["functions with a docstring"],
        "docstrings that do not begin with a verb": house.not_imperative(),
    }


@pytest.mark.parametrize("name", BUDGETS)
def test_a_figure_keeps_its_budget(figures: dict[str, int], name: str) -> None:
    """No figure of `tests/house.py` grows past its budget unseen."""
    assert figures[name] <= BUDGETS[name][0], f"{name}: {figures[name]}"
