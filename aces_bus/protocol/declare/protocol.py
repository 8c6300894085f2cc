"""A protocol: a list of messages on one kind of link, with its dialects and configurations.

1. A message is checked, alone and against the others, when it is declared: a wrong spec fails at import.
2. A `Variant` is a protocol with everything decided: one dialect, one configuration. Plans, scanners and encoders are
   made from variants only.
"""

from __future__ import annotations

import copy
from collections.abc import Collection, Hashable, Iterable, Mapping
from functools import cached_property
from itertools import chain
from typing import TYPE_CHECKING, Any, Literal

import construct as c

from ...errors import CallerError, SpecError, UnknownNameError
from . import ambiguity
from .checks import Check
from .framing import Framing
from .message import (
    DIRECTIONS,
    ConfigurationCondition,
    Direction,
    GivenWay,
    Message,
    as_requests,
    share_dialect,
    way_of,
)
from .pattern import as_pattern
from .place import SourceLine, caller, caller_scope
from .transport import Transport

if TYPE_CHECKING:
    from ..encoder import Encoder
    from .examples import Example
    from .registers import RegisterMap

Link = Literal["can", "serial", "datagram"]
Configuration = Mapping[str, Mapping[int, Any]]


class DeclaredProtocol:
    """The declarations of a protocol, and its variants; see `Protocol`, which has scanners and columns too."""

    def __init__(
        self,
        name: str,
        *,
        link: Link,
        bitrate: int | None = None,
        baud: int | None = None,
        half_duplex: bool = False,
        dialects: Mapping[str, str] | None = None,
        dialect: str | None = None,
        configurations: Mapping[str, Configuration] | None = None,
        configuration: str | None = None,
        broadcast: Mapping[str, int] | None = None,
        doc: str = "",
        source: str = "",
    ) -> None:
        self.place = caller()
        self._scope = caller_scope()
        self.broadcast = dict(broadcast or {})
        self.name = name
        if link not in ("can", "serial", "datagram"):
            raise SpecError(f"{self.place}: a link is 'can', 'serial' or 'datagram', not {link!r}")
        self.link: Link = link
        self.bitrate, self.baud, self.half_duplex = bitrate, baud, half_duplex
        self.dialects = dict(dialects or {})
        self.dialect = dialect if dialect is not None else next(iter(self.dialects), None)
        if self.dialect is not None and self.dialect not in self.dialects:
            raise SpecError(
                f"{self.place}: default dialect {self.dialect!r} is not among {', '.join(self.dialects)}"
            )
        self.configurations = dict(configurations or {})
        self.configuration = (
            configuration if configuration is not None else next(iter(self.configurations), None)
        )
        if self.configuration is not None and self.configuration not in self.configurations:
            raise SpecError(f"{self.place}: default configuration {self.configuration!r} is not declared")
        self.doc, self.source = doc, source
        self.messages: dict[str, Message] = {}
        self.declared: list[Message] = []
        self._by_name: dict[str, list[Message]] = {}
        self.framings: list[Framing] = []
        #: Maps of registers, in the order of their declaration: one for each kind of device that has its own.
        self.register_maps: list[RegisterMap] = []
        self._variants: dict[Hashable, Variant] = {}
        self._neighbours, self._on_stream = ambiguity.Neighbours(), ambiguity.StreamNeighbours()
        #: Of each transport that has identifiers of its own, the first message.
        self._carried: dict[Transport, Message] = {}

    # ------------------------------------------------------------------ declaring

    def configured(self, key: str, by: str) -> Any:
        """Return a function that makes conditions.

        `channels = p.configured("channels", by="board")`, then `when=channels(1, 2)`.
        """
        for name, tables in self.configurations.items():
            if key not in tables:
                raise SpecError(f"{caller()}: configuration {name!r} has no table {key!r}")

        def condition(*values: Any) -> ConfigurationCondition:
            return ConfigurationCondition(key, by, frozenset(values))

        return condition

    def framing(self, **declared: Any) -> Framing:
        """Declare how packets are laid out in the stream; see `Framing` for the keywords."""
        if self.link == "can":
            raise SpecError(f"{caller()}: CAN frames need no framing")
        made = Framing(self, **declared)
        self.framings.append(made)
        return made

    @property
    def has_fd(self) -> bool:
        """True if the protocol has CAN FD frames: its bus is then opened for them."""
        return any(message.fd for message in self.messages.values())

    def message(
        self,
        name: str,
        *,
        payload: c.Construct | None = None,
        payload_from: str | None = None,
        id: Any = None,
        framing: Framing | None = None,
        transport: Transport | None = None,
        prefix: c.Struct | None = None,
        match: Mapping[str, Any] | None = None,
        length: int | Collection[int] | None = None,
        extended: bool = False,
        remote: bool = False,
        fd: bool = False,
        any_format: bool = False,
        direction: Direction | None = None,
        dialect: str | Collection[str] | None = None,
        when: ConfigurationCondition | Collection[ConfigurationCondition] | None = None,
        reply_to: Any = None,
        after: Any = None,
        within: float | None = None,
        overrides: str | Collection[str] = (),
        check: Check | None = None,
        check_extra: bytes = b"",
        doc: str = "",
        source: str = "",
        examples: Iterable[Any] = (),
    ) -> Message:
        """Declare a message; raises `SpecError` with file and line when it cannot be right.

        `id` is the CAN identifier (a number or a pattern with captures), `transport` carries its packets in several frames
        (`IsoTp`, `FastPacket`, …), `match` gives head fields their value or
        pattern, `length` the data lengths that occur when the fields leave a choice. With `any_format` frames of up to 8
        bytes are taken in both formats, classic and CAN FD, and sent as `fd` says. `direction`, `dialect`, `when`,
        `reply_to`, `after` (with `within` seconds) say what bytes cannot: see the architecture page. `overrides` names
        messages that this one takes precedence over. `payload_from` names a field of the framing's header at which the
        payload begins, so that numbers may have bits in both: `match` says what these bytes may be, the payload what
        they mean. `examples` are worked ones, `(bytes, {field: value})`: see
        `declare.examples`.
        """
        place = caller(self._scope)
        if transport is not None:
            if self.link != "can" or not isinstance(transport, Transport):  # pyright: ignore[reportUnnecessaryIsInstance]
                raise SpecError(
                    f"{place}: a transport carries packets in CAN frames, such as IsoTp(); not {transport!r}"
                )
            id = transport.identifier(direction) if id is None else id
        if (self.link == "can") != (id is not None):
            raise SpecError(f"{place}: a message on CAN needs id=…, one on a stream a framing")
        if self.link != "can" and framing is None:
            raise SpecError(f"{place}: {name} needs a framing; declare it by calling one")
        if not isinstance(overrides, str) and not all(isinstance(other, str) for other in _listed(overrides)):
            raise SpecError(f"{place}: overrides= names messages, as text; {overrides!r} does not")
        if direction is not None and direction not in DIRECTIONS:
            raise SpecError(f"{place}: direction is {' or '.join(map(repr, DIRECTIONS))}, not {direction!r}")
        dialects = None if dialect is None else frozenset([dialect] if isinstance(dialect, str) else dialect)
        for known in dialects or ():
            if known not in self.dialects:
                raise SpecError(
                    f"{place}: no dialect {known!r} (there are: {', '.join(self.dialects) or 'none'})"
                )
        made = Message(
            self,
            name,
            place=place,
            identifier=as_pattern(id, "identifier") if id is not None else None,
            framing=framing,
            transport=transport,
            prefix=prefix,
            payload=payload,
            payload_from=payload_from,
            match=match or {},
            length=length,
            extended=extended,
            remote=remote,
            fd=fd,
            any_format=any_format,
            direction=direction,
            dialects=dialects,
            when=() if when is None else (when,) if isinstance(when, ConfigurationCondition) else tuple(when),
            reply_to=as_requests(reply_to, self, place),
            after=as_requests(after, self, place),
            within=within,
            overrides=(overrides,) if isinstance(overrides, str) else tuple(overrides),
            check=check,
            check_extra=check_extra,
            doc=doc,
            source=source,
            examples=self._examples(examples, place, transport, check_extra) if examples else (),
        )
        for other in self._by_name.get(name, ()):
            # Also where `when` keeps them apart: a variant with boards of both kinds has one message of a name.
            if share_dialect(made, other):
                raise SpecError(f"{place}: message {name!r} is declared twice; the other is at {other.place}")
        self._check_order(made)
        if made.framing is None:
            ambiguity.check_against(made, self._neighbours.of(made.identifier))
            self._neighbours.add(made)
            self._check_carriers(made)
        else:
            ambiguity.check_against(made, self._on_stream.of(made))
            self._on_stream.add(made)
        self.declared.append(made)
        self._by_name.setdefault(name, []).append(made)
        self.messages.setdefault(name, made)
        # Scanners that exist keep what they know; the next one knows this message too.
        self._variants.clear()
        return made

    def _examples(
        self, given: Iterable[Any], place: SourceLine, transport: Transport | None, extra: bytes
    ) -> tuple[Example, ...]:
        from .examples import as_examples

        return as_examples(given, place, is_can=self.link == "can", transport=transport, extra=extra)

    def _check_carriers(self, made: Message) -> None:
        """Raise `SpecError` where a message is of a transport's own frames, or has a transport that takes another's."""
        for carried in self._carried.values():
            ambiguity.check_carrier(carried, made, made.place)
        for transport in made.ways:
            if transport is not None and transport.patterns and transport not in self._carried:
                for other in self.declared:
                    ambiguity.check_carrier(made, other, made.place)
                self._carried[transport] = made

    def _check_order(self, made: Message) -> None:
        """Raise `SpecError` when `overrides=` goes in a circle: no order of trial would be right."""
        reached, left = {made.name}, [made]
        if made.name in made.overrides:
            raise SpecError(f"{made.place}: message {made.name!r} cannot override itself")
        while left:
            inner = left.pop()
            for other in chain.from_iterable(self._by_name.get(name, ()) for name in inner.overrides):
                if not share_dialect(made, other):
                    continue
                if made.name in other.overrides:
                    raise SpecError(
                        f"{made.place}: overrides= goes in a circle: {made.name!r} is before {other.name!r} ({other.place}),"
                        f" which is before {made.name!r}"
                    )
                if other.name not in reached:
                    reached.add(other.name)
                    left.append(other)

    def _check_names(self) -> None:
        """Raise `SpecError` when `overrides=` names a message that was never declared."""
        for message in self.declared:
            for name in message.overrides:
                if name not in self.messages:
                    raise SpecError(
                        f"{message.place}: {message.name} overrides {name!r}, and no message has that name"
                        f" (there are: {', '.join(self.messages)})"
                    )

    def check_keywords(self, name: str, declared: Mapping[str, Any], heads: Collection[str | None]) -> None:
        """Raise `SpecError` for keywords that `message` has not; `heads` are fields that `match` could name."""
        known = DeclaredProtocol.message.__kwdefaults__ or {}
        for keyword, value in declared.items():
            if keyword in known:
                continue
            import difflib

            near = difflib.get_close_matches(keyword, known, n=1)
            hint = f"; near: {near[0]}" if near else ""
            if keyword in heads:
                hint = f"; for the field of the header: match={{{keyword!r}: {value!r}}}"
            raise SpecError(f"{caller()}: a message has no keyword {keyword!r} ({name}){hint}")

    def family(self, prefix: c.Struct, **shared: Any) -> Any:
        """Declare messages with the same first fields: `Command("Stop", opcode=0x0F, payload=…)`.

        Keywords named like a prefix field say what it must be; all others are those of `message`.
        """
        names = {item.name for item in prefix.subcons if item.name}

        def declare(name: str, **declared: Any) -> Message:
            match = {
                **declared.pop("match", {}),
                **{k: declared.pop(k) for k in list(declared) if k in names},
            }
            framing = shared.get("framing")
            self.check_keywords(name, declared, {head.name for head in framing.heads} if framing else set())
            return self.message(name, prefix=prefix, match=match, **{**shared, **declared})

        return declare

    def registers(self, **declared: Any) -> RegisterMap:
        """Declare a register map; see `RegisterMap`. A protocol may have several, for devices with different tables."""
        from .registers import RegisterMap

        made = RegisterMap(self, **declared)
        self.register_maps.append(made)
        return made

    @property
    def register_map(self) -> RegisterMap | None:
        """The map that was declared last; None without any."""
        return self.register_maps[-1] if self.register_maps else None

    def __getitem__(self, name: str) -> Message:
        try:
            return self.messages[name]
        except KeyError:
            raise UnknownNameError(f"message of {self.name}", name, self.messages) from None

    # ------------------------------------------------------------------ using

    def variant(
        self, dialect: str | None = None, configuration: str | Configuration | None = None
    ) -> Variant:
        """Return the protocol with dialect and configuration decided (the defaults when not given)."""
        dialect = dialect if dialect is not None else self.dialect
        if dialect is not None and dialect not in self.dialects:
            raise UnknownNameError(f"dialect of {self.name}", dialect, self.dialects)
        name: str | None
        if configuration is None or isinstance(configuration, str):
            name = configuration if configuration is not None else self.configuration
            if name is not None and name not in self.configurations:
                raise UnknownNameError(f"configuration of {self.name}", name, self.configurations)
            tables = self.configurations[name] if name is not None else {}
        else:
            name, tables = "custom", configuration
            needed = {c.key for m in self.declared for c in m.when}
            for key in needed - set(tables):
                raise CallerError(
                    f"the configuration of {self.name} needs a table {key!r} (it has: {', '.join(tables) or 'none'})"
                )
        wanted = (dialect, name, repr(sorted((k, sorted(t.items())) for k, t in tables.items())))
        if wanted not in self._variants:
            self._check_names()
            self._variants[wanted] = Variant(self, dialect, name, tables)
        return self._variants[wanted]

    def variants(self) -> list[Variant]:
        """Return every shipped dialect with every shipped configuration."""
        dialects: list[str | None] = [*self.dialects] or [None]
        names: list[str | None] = [*self.configurations] or [None]
        return [self.variant(dialect, name) for dialect in dialects for name in names]

    def encode(
        self,
        message: str,
        *,
        dialect: str | None = None,
        configuration: str | Configuration | None = None,
        **fields: Any,
    ) -> Any:
        """Return a frame or a packet (bytes) from field values in the sheet's units; see `Encoder.encode`.

        Raises `UnknownNameError` for names that do not exist and `FieldError` for values that do not fit.
        """
        return self.variant(dialect, configuration).encoder.encode(message, **fields)

    def __repr__(self) -> str:
        return f"<protocol {self.name}: {len(self.declared)} messages on {self.link}>"


class Variant:
    """A protocol in one dialect and one configuration: the messages that can occur, narrowed to where they can."""

    def __init__(
        self,
        protocol: DeclaredProtocol,
        dialect: str | None,
        configuration: str | None,
        tables: Configuration,
    ) -> None:
        self.protocol = protocol
        self.name = protocol.name
        self.link = protocol.link
        self.dialect, self.configuration, self.tables = dialect, configuration, tables
        messages = []
        for message in protocol.declared:
            if message.dialects is not None and dialect not in message.dialects:
                continue
            allowed: dict[str, Collection[int]] = {}
            for condition in message.when:
                numbers = condition.allowed(tables.get(condition.key, {}))
                known = allowed.get(condition.capture)
                allowed[condition.capture] = numbers if known is None else frozenset(known) & numbers
            narrow = message.narrowed(allowed) if allowed else message
            if narrow is not None:
                messages.append(narrow)
        self.messages: dict[str, Message] = {m.name: m for m in messages}
        #: The only channel whose frames it decides about; None: all.
        self.channel: str | None = None
        self._bound: dict[str, Variant] = {}

    def on(self, channel: str) -> Variant:
        """Return the same variant, bound to a channel: scanners ask it about that channel's frames only (CAN)."""
        if self.link != "can":
            raise CallerError(f"{self.label}: only protocols on CAN are bound to a channel")
        if channel not in self._bound:
            self._bound[channel] = bound = copy.copy(self)
            bound.channel = channel
        return self._bound[channel]

    @property
    def label(self) -> str:
        """`hubo:D12@hubo2plus`, as the command line takes it."""
        text = self.name
        if self.dialect is not None:
            text += f":{self.dialect}"
        return f"{text}@{self.configuration}" if self.configuration is not None else text

    def messages_for(self, direction: GivenWay | None) -> list[Message]:
        """Return the messages that can occur in `direction`, in declared order."""
        way = way_of(direction)
        if way is None or way == "both":
            return list(self.messages.values())
        return [m for m in self.messages.values() if m.direction in (None, way)]

    def readable(self, direction: GivenWay | None) -> list[Message]:
        """Return the messages that scanners read in `direction`. Without one, frames (CAN) that two messages of opposite
        direction claim are left unread: a pair of messages costs only itself.
        """
        messages = self.messages_for(direction)
        if direction is not None or self.link != "can":
            return messages
        unclear = {message.name for pair in self.direction_conflicts for message in pair}
        return [message for message in messages if message.name not in unclear]

    def __getitem__(self, name: str) -> Message:
        try:
            return self.messages[name]
        except KeyError:
            raise UnknownNameError(f"message of {self.label}", name, self.messages) from None

    @cached_property
    def encoder(self) -> Encoder:
        """The stateless encoder of this variant."""
        from ..encoder import Encoder

        return Encoder(self)

    @cached_property
    def direction_conflicts(self) -> list[tuple[Message, Message]]:
        """Pairs of messages of opposite direction that bytes alone cannot tell apart."""
        from .ambiguity import opposite_conflicts

        return list(opposite_conflicts(list(self.messages.values())))

    @property
    def direction_conflict(self) -> tuple[Message, Message] | None:
        """The first of `direction_conflicts`, or None."""
        return next(iter(self.direction_conflicts), None)

    def __repr__(self) -> str:
        return f"<{self.label}: {len(self.messages)} messages>"


def _listed(given: Any) -> list[Any]:
    """Return a list of what a spec may write as a list, or as one item."""
    return list(given) if isinstance(given, Iterable) else [given]
