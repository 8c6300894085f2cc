"""What was tried at one place of the input: part by part, which templates were still possible, and why others were not.

1. Data only. `found` is the reference's own answer; the steps say how it comes about.
2. A part is a byte of a stream; of a frame its identifier, its kind, its length, and then each byte.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from ...frames import Frame
from ..declare.examples import frame_text
from ..reference import ReferenceItem


@dataclass(frozen=True)
class Death:
    """A template that is ruled out. `why` is a class of reasons ("identifier"), `detail` says what was wanted."""

    template: str
    why: str
    detail: str = ""


@dataclass(frozen=True)
class FieldRead:
    """A field whose last bit has come, by the template that reads it so."""

    template: str
    name: str
    value: Any
    unit: str = ""


@dataclass(frozen=True)
class Step:
    """One part: its place ("7", "id"), its text ("FF", "063"), what it is to the template that lived longest."""

    place: str
    part: str
    what: str
    died: tuple[Death, ...]
    read: tuple[FieldRead, ...]
    #: Templates that are possible behind this part.
    alive: tuple[str, ...]


@dataclass(frozen=True)
class TemplateTrace:
    """A template over the parts of an attempt: what it expects at each, up to where it dies."""

    template: str
    cells: tuple[str, ...]
    #: The number of the part that kills it; None: none does.
    dies_at: int | None
    is_chosen: bool = False
    #: The class of the reason for which it dies.
    why: str = ""


@dataclass(frozen=True)
class Attempt:
    """One decision of the scanner: from `start` (offset or frame number) on, what is it?"""

    start: int
    templates: tuple[str, ...]
    steps: tuple[Step, ...]
    rows: tuple[TemplateTrace, ...]
    found: ReferenceItem
    #: Where the search goes on.
    resumes: int
    #: What was asked before, where that decides: the request's name and raw fields.
    request: tuple[str, Mapping[str, Any]] | None = None
    is_can: bool = False
    frame: Any = None
    #: Parts that are not shown, because there are too many.
    left_out: int = 0
    #: A run of attempts that failed alike: so many.
    run: int = 1
    raw: bytes = field(default=b"", repr=False)

    @property
    def verdict(self) -> str:
        """One line: the message, or why there is none."""
        found = self.found
        return found.message if found.message is not None else found.reason

    @property
    def label(self) -> str:
        """`offset 12`, `bytes 3…9`, `frame 4  063#78 00`."""
        if self.is_can:
            return f"frame {self.start}" + (f"  {candump_text(self.frame)}" if self.frame is not None else "")
        size = self.found.size * self.run
        return f"offset {self.start}" if size == 1 else f"offset {self.start}…{self.start + size - 1}"


def candump_text(frame: Frame) -> str:
    """Return a frame as candump writes it, its bytes apart."""
    from ..declare.examples import ExampleFrame

    shown = ExampleFrame(
        bytes(frame.data),
        int(frame.arbitration_id),
        bool(frame.is_extended_id),
        bool(frame.is_remote_frame),
        bool(frame.is_fd),
    )
    return frame_text(shown)
