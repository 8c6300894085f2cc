"""The reference pages: every public name has its entry, with all its keywords and an example; links find their headings."""

from __future__ import annotations

import inspect
import re
from pathlib import Path
from typing import Any

import pytest

import aces_bus
import aces_bus.protocol
from aces_bus.protocol import Protocol, Transport

ROOT = Path(__file__).resolve().parents[1]
FOLDER = ROOT / "docs" / "reference"
PAGES = sorted(path.name for path in FOLDER.glob("*.md"))
_ENTRY = re.compile(r"^## `(\w+)`\n(.*?)(?=^## |\Z)", re.MULTILINE | re.DOTALL)
#: What makes a thing whose own call nobody writes, and whose keywords are the entry's.
MADE_BY: dict[str, Any] = {
    "AnswerTimes": Transport.AnswerTimes,
    "FrameKind": Transport.Kind,
    "FrameNumber": Transport.Number,
    "FramePart": Transport.Part,
    "Message": Protocol.message,
    "Steering": Transport.Steering,
    "Variant": Protocol.variant,
}
#: Types that are given and not imported.
GIVEN = {
    "Framing",
    "RegisterMap",
    "Meta",
    "Register",
    "Request",
    "ScanCounts",
    "Scanner",
    "StreamScanner",
    *MADE_BY,
} - {
    "Message",
    "Variant",
}
#: What `aces_bus` itself has for reading.
READING = {"Frame", "Unknown", "as_dict", "list_protocols", "load_protocol", "make_scanner"}
#: Made by scanners only, or types: there is nothing to call.
UNCALLED = {
    "FlagSet",
    "Framing",
    "RegisterMap",
    "Meta",
    "Part",
    "Record",
    "Register",
    "Request",
    "ScanCounts",
    "Scanner",
    "StreamScanner",
}
#: Parameters that nobody gives.
PASSED_ON = {"self", "args", "kwds", "kwargs", "protocol"}


NAMES = sorted({*aces_bus.protocol.__all__, *GIVEN, *READING})


def entries() -> dict[str, tuple[str, str]]:
    """Each entry's page and text."""
    found: dict[str, tuple[str, str]] = {}
    for page in PAGES:
        for entry in _ENTRY.finditer((FOLDER / page).read_text(encoding="utf-8")):
            assert entry[1] not in found, f"{entry[1]} has two entries"
            found[entry[1]] = page, entry[2]
    return found


ENTRIES = entries()


def test_every_public_name_has_its_entry() -> None:
    """No name without an entry, no entry of a name that is gone, and each is in the list of the first page."""
    assert len(NAMES) > 50
    assert sorted(ENTRIES) == sorted(NAMES)
    index = (FOLDER / "README.md").read_text(encoding="utf-8")
    missing = [
        name for name, (page, _) in ENTRIES.items() if f"[`{name}`]({page}#{name.lower()})" not in index
    ]
    assert missing == []


@pytest.mark.parametrize("name", NAMES)
def test_an_entry_has_all_keywords_and_an_example(name: str) -> None:
    """What can be given is named, and an example (which the tests of prose run) shows it."""
    _, text = ENTRIES[name]
    assert "\n>>> " in text
    if name in UNCALLED:
        return
    home = aces_bus if name in READING else aces_bus.protocol
    parameters = inspect.signature(MADE_BY.get(name) or getattr(home, name)).parameters
    missing = [one for one in parameters if one not in PASSED_ON and not re.search(rf"\b{one}\b", text)]
    assert missing == []


def anchors(path: Path) -> set[str]:
    """The anchors of a page's headings, as GitHub makes them."""
    text = re.sub(r"^```.*?^```", "", path.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    return {
        re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-")
        for heading in re.findall(r"^#+ (.*)$", text, re.MULTILINE)
    }


@pytest.mark.parametrize(
    "page", sorted(path.relative_to(ROOT).as_posix() for path in (ROOT / "docs").rglob("*.md"))
)
def test_links_find_their_headings(page: str) -> None:
    """Files that are linked exist, and so do the headings named behind `#`."""
    path = ROOT / page
    text = re.sub(r"^```.*?^```", "", path.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    for target, anchor in re.findall(r"\]\((?!https?:)([^)#]*)(?:#([^)]+))?\)", text):
        file = path.parent / target if target else path
        assert file.exists(), f"{page}: {target}"
        if anchor and file.suffix == ".md":
            assert anchor in anchors(file), f"{page}: {target}#{anchor}"


def test_the_map_names_every_page() -> None:
    """docs/index.md leads to each page of the folder."""
    index = (ROOT / "docs" / "index.md").read_text(encoding="utf-8")
    linked = set(re.findall(r"\]\(([^)#]+\.md)", index))
    pages = {path.relative_to(ROOT / "docs").as_posix() for path in (ROOT / "docs").rglob("*.md")} - {
        "index.md"
    }
    assert pages - linked == set()
