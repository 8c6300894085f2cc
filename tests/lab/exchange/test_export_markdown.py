"""Pages of protocols: every message and field is there, links lead somewhere, text is text."""

from __future__ import annotations

import re

import pytest
from construct import Byte, Struct

from aces_bus.protocol import Enumeration, Protocol, Quantity, Variant
from aces_bus.protocol.draw.table import FieldRow
from aces_bus.protocol.plan.flatten import flatten
from aces_lab.exchange import print_markdown
from aces_protocols.hubo.spec import hubo
from aces_protocols.minihubo_adc.spec import minihubo_adc
from aces_protocols.robotis.spec import robotis
from tests.specs.catalogue import SPECS

PROTOCOLS = [hubo, robotis, minihubo_adc, *SPECS.values()]


def anchors(text: str) -> set[str]:
    """What GitHub makes of the headings."""
    found: list[str] = []
    for heading in re.findall(r"^#+ (.*)$", text, re.MULTILINE):
        plain = re.sub(r"[^\w\- ]", "", heading.replace("\\", "").lower()).replace(" ", "-")
        found.append(plain if plain not in found else f"{plain}-{found.count(plain)}")
    return set(found)


@pytest.mark.parametrize("variant", [p.variants()[0] for p in PROTOCOLS], ids=lambda v: v.name)
def test_every_message_and_field_is_there(variant: Variant) -> None:
    """A heading a message, a row a field; every link within the page leads to a heading; tables are even."""
    text = print_markdown(variant)
    for message in variant.messages.values():
        part = re.split(rf"^## {re.escape(message.name).replace('_', '.?_')}$", text, flags=re.MULTILINE)[1]
        part = part.partition("\n## ")[0]
        for row in FieldRow.table(flatten(message), FieldRow.captured(message)):
            assert f"| `{row.name}` |" in part, (message.name, row.name)
    assert set(re.findall(r"\]\(#([^)]*)\)", text)) <= anchors(text)
    width = 0
    fenced = False
    for line in text.splitlines():
        fenced ^= line.startswith("```")
        cells = len(re.findall(r"(?<!\\)\|", line)) if line.startswith("|") and not fenced else 0
        assert not (cells and width) or cells == width, line
        width = cells


def test_text_of_a_spec_stays_text() -> None:
    """No tag, no link, no cell and no heading of its own."""
    nasty = "a | b <script>x</script> [l](http://x) `c` `two words` *d* _e_ # f\n\n## g www.h.example ~~i~~ $j$ a@b"
    protocol = Protocol("nasty", link="can", doc=nasty, source=nasty)
    payload = Struct(
        "mode" / Enumeration(Byte, {nasty: 1}), "x" / Quantity(Byte, unit=nasty, doc=nasty, source="page | 7")
    )
    protocol.message("Only", id=1, payload=payload, doc=nasty, source=nasty)
    text = print_markdown(protocol.variant())
    assert re.findall(r"^#+ .*$", text, re.MULTILINE) == ["# nasty", "## Identifiers", "## Only"]
    assert "<" not in text
    assert re.search(r"(?<!\\)\]\(http", text) is None
    assert "`c`" in text
    assert "(source: page \\| 7)" in text
    assert "\\`two words\\`" in text
    rows = [line for line in text.splitlines() if line.startswith("| `x`")]
    assert len(re.findall(r"(?<!\\)\|", rows[0])) == 7
