"""What a check says of a spec: where, how bad, by which rule, and what to do.

1. An error is wrong whatever was meant; a warning is wrong unless it was meant; a note is worth knowing.
2. Every finding has a line. A rule's name never changes: programs and comments in specs refer to it.
3. `# aces: allow RULE` on the line of a finding, or on a line of its own above, says that it is meant: the finding is
   left out, and counted.
"""

from __future__ import annotations

import linecache
import re
from collections.abc import Hashable
from dataclasses import dataclass, field
from typing import ClassVar, Literal

from ..declare.place import SourceLine
from ..record import PlainValue

Level = Literal["error", "warning", "note"]
_ALLOWED = re.compile(r"#\s*aces:\s*allow\s+(?P<rules>[\w, -]+)")


@dataclass(frozen=True)
class Finding:
    """One remark about a spec. `witness` is a packet or frame that shows it, as `aces spec explain` takes it."""

    level: Level
    rule: str
    place: SourceLine
    text: str
    message: str | None = None
    witness: str | None = None
    #: Other places that have to do with it.
    others: tuple[SourceLine, ...] = field(default=())

    def __str__(self) -> str:
        return f"{self.place}: {self.level}: {self.text} [{self.rule}]"

    @property
    def is_allowed(self) -> bool:
        """True if a comment in the spec says that this is meant."""
        if self.level == "error":
            return False
        lines: list[str] = []
        for place in (self.place, self.place.inner):
            if place is None:
                continue
            lines.append(linecache.getline(place.file, place.line))
            above = linecache.getline(place.file, place.line - 1) if place.line > 1 else ""
            if above.lstrip().startswith("#"):
                lines.append(above)
        for line in lines:
            found = _ALLOWED.search(line)
            if found is not None and self.rule in re.split(r"[,\s]+", found["rules"].strip()):
                return True
        return False

    def as_dict(self) -> dict[str, PlainValue]:
        """Return it for JSON."""
        return {
            "file": self.place.file,
            "line": self.place.line,
            "level": self.level,
            "rule": self.rule,
            "message": self.message,
            "text": self.text,
            "witness": self.witness,
            "others": [str(place) for place in self.others],
        }

    LEVELS: ClassVar[tuple[Level, ...]] = ("error", "warning", "note")

    @staticmethod
    def sort_key(finding: Finding) -> tuple[Hashable, ...]:
        """Return what sorts by file and line, worse ones first."""
        return (
            finding.place.file,
            finding.place.line,
            Finding.LEVELS.index(finding.level),
            finding.rule,
            finding.text,
        )
