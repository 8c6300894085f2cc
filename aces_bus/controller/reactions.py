"""Reactions: what is done about each kind of fault, as values and as the words of a robot's file and of `--on-trip`.

1. Kinds are those of devices' and buses' events, and of controllers: "raised", "failed",
   "dead-man", "not finite". "*" is any other.
2. A word that is not a reaction, a kind that no event has and a source that is not there are errors, never ignored.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass
from typing import ClassVar, Literal

from ..errors import CallerError, UnknownNameError
from .events import EventLike
from .trip import ACTIONS, Action


@dataclass(frozen=True)
class Reaction:
    """What to do about an event: nothing, go on in a worse way called `name`, or stop motion by `action`.

    `sources` narrows it to events from these (None: all); `do` is called with the event when it is carried out.
    """

    what: Literal["ignore", "degrade", "stop"]
    name: str = ""
    action: Action | None = None
    sources: frozenset[str] | None = None
    do: Callable[[EventLike], object] | None = None

    #: The ways to stop motion, by their words.
    ACTION_OF: ClassVar[Mapping[str, Action]] = {action: action for action in ACTIONS}

    @staticmethod
    def parse(
        texts: Mapping[str, str],
        *,
        kinds: Collection[str],
        sources: Collection[str] | None = None,
        own: Mapping[str, Callable[[EventLike], object]] | None = None,
    ) -> dict[str, tuple[Reaction, ...]]:
        """Parse reactions from words: `KIND` or `KIND@SOURCE,SOURCE` → `ignore`, `hold`, `park`, `disable`, `zero
        duty`, `degrade`, `degrade:NAME`, or the name of a function in `own`, which is called with the event
        while motion goes on.

        Raises `UnknownNameError` for a kind, source (None: any) or reaction that there is not.

        >>> Reaction.parse({"silent@FT": "degrade:no feet", "silent": "hold"}, kinds=["silent"])["silent"][1]
        Reaction(what='stop', name='', action='hold', sources=None, do=None)
        """
        found: dict[str, list[Reaction]] = {}
        for key, word in texts.items():
            kind, _, named = key.partition("@")
            among = [name.strip() for name in named.split(",") if name.strip()] or None
            if kind not in (*kinds, "*"):
                raise UnknownNameError("kind of fault", kind, (*kinds, "*"))
            for name in among or ():
                if sources is not None and name not in sources:
                    raise UnknownNameError(f"source of {kind!r} (bus, device or controller)", name, sources)
            made = _reaction(word, kind, among, own or {})
            # Who is named goes before all others.
            found.setdefault(kind, []).insert(len(found.get(kind, ())) if among is None else 0, made)
        return {kind: tuple(reactions) for kind, reactions in found.items()}


#: Go on as if nothing had happened; it is counted.
IGNORE = Reaction("ignore")


def degrade(
    name: str, do: Callable[[EventLike], object] | None = None, *, sources: Iterable[str] | None = None
) -> Reaction:
    """Go on in a worse way; `do` makes it so (a gain to zero, another controller)."""
    return Reaction("degrade", name, None, None if sources is None else frozenset(sources), do)


def stop(action: Action | None = None, *, sources: Iterable[str] | None = None) -> Reaction:
    """Stop motion by "hold", "park", "zero duty" or "disable"; None: the guard's own action."""
    if action is not None and action not in ACTIONS:
        raise CallerError(f"the action is one of {', '.join(ACTIONS)}, not {action!r}")
    return Reaction("stop", "", action, None if sources is None else frozenset(sources))


#: What happens on any bus on a good day.
HARMLESS = (
    "opened",
    "reopened",
    "closed",
    "error-active",
    "answers",
    "alarm over",
    "late reply",
    "overrun",
    "stalled",
    "duplicate reply",
    "garbled",
    "limited",
    "clipped",
    "late",
    "unnamed",
    "recovered",
    "estop clear",
    "reduced",
    "full speed",
)
DEFAULT_REACTIONS: Mapping[str, Reaction | tuple[Reaction, ...]] = {
    **dict.fromkeys(HARMLESS, IGNORE),
    "*": stop(),
}

#: Kinds of faults of controllers and logs; those of devices and buses are `aces_bus.device.events.Kind`.
CONTROL_KINDS = ("raised", "failed", "dead-man", "unnamed", "not finite", "log-failed", "log-dropped")
#: Words for reactions.
WORDS = ("ignore", "degrade", *ACTIONS)


def _reaction(
    word: str, kind: str, sources: Iterable[str] | None, own: Mapping[str, Callable[[EventLike], object]]
) -> Reaction:
    action = Reaction.ACTION_OF.get(word)
    if action is not None:
        return stop(action, sources=sources)
    name, _, more = word.partition(":")
    if word == "ignore":
        return Reaction("ignore", sources=None if sources is None else frozenset(sources))
    if name == "degrade":
        return degrade(more or kind, sources=sources)
    if word not in own:
        kind = f"reaction ({', '.join(WORDS)}), or function of a controller's file,"
        raise UnknownNameError(kind, word, (*WORDS, *own))
    return degrade(word, own[word], sources=sources)
