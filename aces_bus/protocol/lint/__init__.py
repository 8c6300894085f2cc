"""What is wrong or doubtful in a spec that can be imported: rules over protocols, messages, fields, framings and buses.

1. A rule only reads; nothing is changed, printed or generated.
2. What an import refuses is not asked again here: `SpecError` says it, with its line.

The rules, by the name in brackets behind a finding:

    ambiguous         two messages accept one packet, and nothing settles which it is (an import's error)
    byte-order        one number the other way round than all others
    check-constant    a check over bytes that never change
    check-range       a check over nothing, over its own bytes, or one that leaves bytes out
    collision         two protocols on one bus claim one frame
    dialect           a dialect without a difference
    direction         requests and replies that go the same way; what only a direction tells apart
    enumeration       names that cannot occur; runs of names with holes
    example           a worked example that does not hold; messages without one
    gap               bits that belong to no field; framings without a longest pause
    mask              fields in another order than the bits by which they are there
    over              precedence over a message that is not there, or with which nothing is shared
    range             a range beyond what the bits hold
    request           a request that cannot have been
    size              packets that cannot be as long as their fields
    unchecked         packets without a check
    unit              a unit that is none
    unreachable       messages that no packet can be, or that others always take first
"""

from __future__ import annotations

from collections.abc import Iterator

from ..protocol import Protocol
from .examples import check_examples
from .fields import check_fields
from .finding import Finding
from .framings import check_framings
from .templates import check_templates


def check_protocol(protocol: Protocol) -> list[Finding]:
    """Return all findings of one protocol, by file and line, but those that comments allow."""
    return sorted(
        (finding for finding in every_finding(protocol) if not finding.is_allowed), key=Finding.sort_key
    )


def every_finding(protocol: Protocol) -> Iterator[Finding]:
    """Yield the findings, also those that comments in the spec allow; each once."""
    seen: set[tuple[object, ...]] = set()
    for rule in (check_templates, check_framings, check_fields, check_examples):
        for finding in rule(protocol):
            key = (finding.rule, finding.place, finding.text)
            if key not in seen:
                seen.add(key)
                yield finding


__all__ = ["check_protocol"]
