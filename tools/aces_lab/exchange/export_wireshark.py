"""A Wireshark dissector in Lua, printed from the plans of a variant: one file to drop into the plug-in folder.

1. The printed file is data, a table `P`, and behind it the same program for every protocol (`dissector*.lua`), which walks
   the table. What is decided is decided here.
2. It recognizes messages as the scanner does: constants, lengths, checks, requests and their replies, in the same order.
3. A field is `protocol.message.field`. One with scale or offset shows the quantity, with the raw number below it as
   `….raw`; all others show the raw number, with the names of its values.

*Facts*: Wireshark's Lua reference (Proto, ProtoField, DissectorTable), versions 3.6 and later: Lua 5.2 and 5.4 both read it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib.resources import files
from typing import Any, Literal

from aces_bus.protocol import (
    Check,
    Cobs,
    Crc,
    CutZeros,
    DataIds,
    Extra,
    IdBytes,
    Insert,
    Message,
    Slip,
    Sum,
    Variant,
)
from aces_bus.protocol.declare.ambiguity import needing_context, ordered, request_names
from aces_bus.protocol.declare.bits import whole_bits
from aces_bus.protocol.declare.checks import Covered
from aces_bus.protocol.declare.framing import Framing, WideLength
from aces_bus.protocol.declare.message import Direction, way_of
from aces_bus.protocol.exchange.names import PythonNames
from aces_bus.protocol.exchange.problems import Loss, ProblemText
from aces_bus.protocol.plan import nodes as p
from aces_bus.protocol.plan.flatten import fixed_leaves

from .dissector_tables import bit_pieces, crc_table, id_pattern, is_a_table, transport_table, value_set

#: Who may speak, as the dissector's preference has it.
Way = Direction | Literal["both", "by port"]
PREFERENCES: dict[Way, int] = {"by port": 0, "to device": 1, "from device": 2, "both": 3}
#: Bits of numbers that Wireshark shows as numbers, and of CRCs that the dissector computes.
WIDEST, WIDEST_CRC = 64, 32
#: Values that are listed one by one.
MOST_LISTED = 65536


def print_dissector(
    variant: Variant, *, direction: Way | Literal["to", "from"] = "by port", port: int = 0
) -> tuple[str, list[Loss]]:
    """Return the dissector's source, and what it does not show as the scanner does.

    `direction` and `port` (TCP and UDP, 0: none) are what the preferences begin with; both are for streams.
    """
    way: Way | None = direction if direction == "by port" else way_of(direction)
    return _Printer(variant).print(way or "by port", port)


class _Printer:
    def __init__(self, variant: Variant) -> None:
        self.variant = variant
        self.losses: list[Loss] = []
        self.fields: list[list[Any]] = []
        self.taken: set[str] = {"message", "problem", "skipped", "packet_frames", "packet_in"}
        self.is_can = variant.link == "can"
        modes: dict[str, Any] = {"both": None if self.is_can else "both"}
        if not self.is_can:
            modes |= {"to device": "to device", "from device": "from device"}
        #: By mode: the messages, names of those that need their request, of what is asked, of what answers.
        self.modes: dict[str, tuple[list[Message], frozenset[str], frozenset[str], frozenset[str]]] = {}
        for mode, messages_for in modes.items():
            messages = ordered(
                m
                for m in variant.messages_for(messages_for)
                if m.transport is None or is_a_table(m.transport)
            )
            contextual = needing_context(messages)
            self.modes[mode] = (messages, contextual, *request_names(messages, contextual))
        for message in variant.messages.values():
            if message.transport is not None and not is_a_table(message.transport):
                title = message.transport.title
                self._lose(
                    message.name, "", f"carried by {title}, whose packets are not put together: left out"
                )
            elif message.ways[-1] is not message.transport and message.ways[-1] is not None:
                title = message.ways[-1].title
                self._lose(message.name, "", f"packets that come by {title} are not put together")
        carried = (m.transport for m in self.modes["both"][0] if m.transport is not None)
        self.transports = list(dict.fromkeys(carried))
        self.framings = list(dict.fromkeys(m.framing for m in self.modes["both"][0] if m.framing is not None))

    def print(self, direction: Way, port: int) -> tuple[str, list[Loss]]:
        variant = self.variant
        messages = [self._message(message) for message in self.modes["both"][0]]
        table: dict[str, Any] = {
            "name": PythonNames.snake(variant.name),
            "title": ProblemText.one_line(
                f"{variant.label}: {variant.protocol.doc}" if variant.protocol.doc else variant.label
            ),
            "broadcast": dict(variant.protocol.broadcast),
        }
        if not self.is_can:
            table["direction"], table["port"] = PREFERENCES[direction], port
            table["framings"] = [self._framing(framing) for framing in self.framings]
            table["extras"] = {
                number: list(extra)
                for message in self.modes["both"][0]
                for number, extra in (message.extras or {}).items()
            }
        if self.transports:
            table["transports"] = [
                transport_table(transport, n) for n, transport in enumerate(self.transports, 1)
            ]
        table["fields"] = self.fields
        table["messages"] = messages
        head = [
            f"-- {ProblemText.one_line(variant.label)} as a Wireshark dissector,"
            " printed by aces-bus from the spec: change that instead."
        ]
        head += ["-- Put it into the folder of personal Lua plug-ins (Help, About Wireshark, Folders)."]
        if self.losses:
            head += ["--", "-- Not as the scanner has it:"]
            head += [f"--   {ProblemText.one_line(str(loss))}" for loss in self.losses]
        text = "\n".join([*head, "", f"local P = {lua_literal(table)}", ""])
        programs = ["dissector.lua", "dissector_can.lua" if self.is_can else "dissector_stream.lua"]
        if self.transports:
            programs.insert(1, "dissector_transport.lua")
        return text + "".join(map(_program, programs)), self.losses

    def _lose(self, message: str, field: str, reason: str) -> None:
        self.losses.append(Loss(message, field, reason))

    # ------------------------------------------------------------------ messages

    def _message(self, message: Message) -> dict[str, Any]:
        plan = message.plan
        own = PythonNames.unused(PythonNames.snake(message.name), self.taken)
        table: dict[str, Any] = {"name": message.name}
        if self.is_can:
            table["id"] = id_pattern(message.identifier)
            table |= {"extended": message.extended, "remote": message.remote, "fd": message.fd}
            if message.any_format:
                table["any_format"] = True
            if message.transport is not None:
                table["transport"] = self.transports.index(message.transport) + 1
                table["extra"] = list(message.check_extra)
        else:
            assert message.framing is not None
            table["framing"] = self.framings.index(message.framing) + 1
        table |= _shape(plan)
        if plan.split is not None:
            split = plan.split
            table["split"] = {
                "start": split.start,
                "stop": split.end,
                "separator": split.separator,
                "lead": split.lead,
                "least": split.least,
                "most": split.most,
            }
        table["one_of"] = [self._one_of(choice) for choice in plan.one_of]
        if message.check is not None:
            table["check"] = self._own_check(message)
        self._requests(message, table)
        table["fields"] = self._fields(message, plan, own)
        return table

    def _one_of(self, choice: p.OneOf) -> dict[str, Any]:
        bits = choice.number.place
        return {"pieces": bit_pieces(bits), "last": max(bits) // 8, "values": value_set(choice.values)}

    def _requests(self, message: Message, table: dict[str, Any]) -> None:
        """Write the requests that a message answers, and the messages that answer it."""
        table["bound"] = {
            mode: message.name in contextual
            for mode, (messages, contextual, *_) in self.modes.items()
            if message in messages
        }
        table["answers"] = {
            mode: True for mode, (*_, answers) in self.modes.items() if message.name in answers
        }
        if any(table["bound"].values()) or table["answers"]:
            links = [(request, False) for request in message.reply_to] + [
                (request, True) for request in message.after
            ]
            if not any(table["bound"].values()):
                links = [link for link in links if not link[1]]
            table["links"] = [
                {
                    "request": request.message.name,
                    "shared": sorted(message.outer_names & request.message.outer_names),
                    "sticky": is_sticky,
                    "values": {name: value_set(sorted(values)) for name, values in request.values},
                }
                for request, is_sticky in links
            ]
            table["within"] = message.within
        if any(message.name in asked for _, _, asked, _ in self.modes.values()):
            kinds = {
                tuple(sorted(other.outer_names & request.message.outer_names))
                for other in self.modes["both"][0]
                for request in (*other.reply_to, *other.after)
                if request.message.name == message.name
            }
            table["noted"] = [{"shared": list(kind)} for kind in sorted(kinds)]

    # ------------------------------------------------------------------ checks and framings

    def _own_check(self, message: Message) -> dict[str, Any] | None:
        assert message.check is not None
        if message.framing is not None:
            self._lose(message.name, "", f"its own check ({message.check.describe}) is not verified")
            return None
        offset, size, order = message.check_span
        check = self._check(message.check, message.name, message.check_extra, message.check_over)
        if "kind" not in check:
            return None
        return {**check, "at": offset, "pieces": bit_pieces(whole_bits(offset, size, order))}

    def _check(
        self, check: Check, where: str, extra: bytes = b"", over: Sequence[Covered] = ()
    ) -> dict[str, Any]:
        table: dict[str, Any] = {"size": check.size, "is_big": check.order == "big"}
        if check.over is not None:
            table["over"] = [_covered(part) for part in over or check.over]
        table["extra"] = list(extra)
        table["is_seeded"] = not extra and any(isinstance(part, Extra) for part in check.over or ())
        if check.text is not None:
            if check.bytes != 1:
                self._lose(where, "", f"the check ({check.describe}, as text) is not verified")
                return table
            texts = [check.text.format(number) for number in range(256)]
            if check.digits is not None:
                # Hexadecimal digits are compared in upper case.
                at, to = check.digits.start, check.digits.stop
                texts = [text[:at] + text[at:to].upper() + text[to:] for text in texts]
                table["digits"] = value_set(range(at + 1, to + 1))
            table["texts"] = texts
        if isinstance(check, Crc):
            if check.parameters[0] > WIDEST_CRC:
                self._lose(
                    where, "", f"the check ({check.describe}) is not verified: {check.parameters[0]} bits"
                )
                return table
            table |= {"kind": "crc", **crc_table(check)}
        elif check.kind in ("sum", "xor", "fletcher"):
            table["kind"] = check.kind
            table["sign"] = check.sign if isinstance(check, Sum) else ""
        else:
            self._lose(where, "", f"the check ({check.describe}) is not verified: a kind of its own")
        return table

    def _framing(self, framing: Framing) -> dict[str, Any]:
        table: dict[str, Any] = {"name": framing.name, "sync": list(framing.sync)}
        if framing.not_next:
            table["not_next"] = value_set(sorted(framing.not_next))
        if framing.match:
            table["match"] = [
                {"at": head.offset, "values": value_set(sorted(numbers))} for head, numbers in framing.match
            ]
        if framing.not_inside:
            table["not_inside"] = value_set(framing.not_inside)
        if framing.affine is not None:
            head = framing.affine.length
            bits = whole_bits(head.offset, head.size, head.order)
            table["length"] = {
                "pieces": bit_pieces(bits),
                "last": head.offset + head.size - 1,
                "factor": framing.affine.factor,
                "constant": framing.affine.constant,
                "escape": framing.affine.escape,
            }
            wide = framing.affine.wide
            if wide is not None:
                table["length"]["wide"] = bit_pieces(whole_bits(wide.offset, wide.size, wide.order))
                table["length"]["wide_size"] = wide.size
            flags, mask = framing.affine.flags, framing.affine.mask
            if flags is not None:
                bit = whole_bits(flags.offset, flags.size, flags.order)[mask.bit_length() - 1]
                table["length"] |= {"flags": bit_pieces((bit,)), "more": framing.affine.more}
                table["length"]["last"] = framing.affine.reach - 1
        table["size"] = framing.fixed_size
        if framing.multiple > 1:
            table["multiple"] = framing.multiple
        table["stop"] = list(framing.end)
        if framing.short_end:
            self._lose(
                "", "", f"packets that {framing.short_end.hex(' ').upper()} alone closes are not found"
            )
        table["is_silent"] = framing.is_silent
        table |= {"min_size": framing.min_size, "max_size": framing.max_size, "head_end": framing.head_end}
        if framing.check is not None and framing.check_head is not None:
            self._lose("", "", f"the check in the header ({framing.check.describe}) is not verified")
        elif framing.check is not None and (framing.covers_request or framing.check_behind):
            where = "over the request" if framing.covers_request else "behind the end"
            self._lose(
                "", "", f"the check {where} ({framing.name}: {framing.check.describe}) is not verified"
            )
        elif framing.check is not None:
            table["check"] = self._check(framing.check, "")
        extra = framing.extra_head
        if extra is not None:
            table["extra"] = bit_pieces(whole_bits(extra.offset, extra.size, extra.order))
        stuffing = framing.stuffing
        if isinstance(stuffing, Insert):
            table["stuffing"] = {
                "kind": "insert",
                "pattern": list(stuffing.pattern),
                "bytes": list(stuffing.byte),
            }
        elif isinstance(stuffing, WideLength):
            table["stuffing"] = {"kind": "wide"}
        elif isinstance(stuffing, CutZeros):
            table["stuffing"] = {"kind": "zeros", "sizes": framing.sizes}
        elif isinstance(stuffing, (Slip, Cobs)):
            table["stuffing"] = {"kind": "slip" if isinstance(stuffing, Slip) else "cobs"}
        return table

    # ------------------------------------------------------------------ fields

    def _fields(self, message: Message, plan: p.MessagePlan, own: str) -> list[dict[str, Any]]:
        found: list[dict[str, Any]] = []
        taken: set[str] = set()
        if plan.opaque:
            reason = f"recognized by its head and constants alone, not all of it dissected: {plan.opaque}"
            self._lose(message.name, "", reason)
        outer = message.outer_names
        listed, rest = fixed_leaves(message)
        for leaf in listed:
            if leaf.node.is_opaque:
                self._lose(message.name, leaf.path, "part of payload, which is shown as bytes")
                continue
            table = self._leaf(leaf, message, plan, f"{own}.{PythonNames.unused(leaf.identifier, taken)}")
            table["is_outer"] = leaf.path in outer or None
            if leaf.whens:
                selector, when = leaf.conditions[-1]
                table["when"] = [selector, dict.fromkeys(when.values, True)]
            found.append(table)
        if plan.opaque:
            field = p.PlanField("payload", p.Scalar("bytes", rest, None), f"not taken apart: {plan.opaque}")
            (leaf,) = p.walk([field])
            found.append(self._leaf(leaf, message, plan, f"{own}.{PythonNames.unused('payload', taken)}"))
        return found

    def _field(self, abbr: str, label: str, kind: str, base: str | None, names: Any, doc: str) -> int:
        self.fields.append([abbr, label, kind, base, names, ProblemText.one_line(doc) or None])
        return len(self.fields)

    def _leaf(self, leaf: p.NodePath, message: Message, plan: p.MessagePlan, abbr: str) -> dict[str, Any]:
        node, table = leaf.node, {"path": leaf.path}
        more: dict[str, Any] = {}
        match node:
            case p.FromIdentifier():
                if node.number is None:
                    more = {"kind": "identifier"}
                else:
                    bits = node.number.place
                    part: dict[str, Any] = {"constant": node.constant, "shift": node.shift}
                    # Alone in its number it is (number − constant) ÷ 2^shift: what the program takes without a width.
                    part["width"] = None if node.is_alone else node.width
                    more = {"kind": "uint", "pattern": part, **_placed(bits)}
                width = node.width
                more["width"] = width
                more |= self._number(leaf, node, abbr, f"uint{_size(width)}", width)
            case p.FromRequest():
                more = {
                    "kind": "request",
                    "field": self._field(abbr, leaf.path, "uint32", "DEC", None, leaf.doc),
                }
            case p.Rest():
                more = self._rest(leaf, node, message, abbr)
            case p.DelimitedField() | p.MoreCells():
                index = node.index if isinstance(node, p.DelimitedField) else node.start
                kind = "cell" if isinstance(node, p.DelimitedField) else "cells"
                number = self._field(abbr, leaf.path, "string", None, None, leaf.doc)
                more = {"kind": kind, "index": index + 1, "field": number}
            case p.TaggedItems() | p.Repeated():
                more = self._list(leaf, node, message, plan.tail, abbr)
            case _:
                assert isinstance(node, p.Scalar)
                more = self._scalar(leaf, node, plan, message, abbr)
        return {**table, **more}

    def _list(
        self, leaf: p.NodePath, node: p.TaggedItems | p.Repeated, message: Message, tail: int, abbr: str
    ) -> dict[str, Any]:
        """Return a list of items: each is a tree of the fields of its data."""
        number = self._field(abbr, leaf.path, "bytes", None, None, leaf.doc)
        table: dict[str, Any] = {"field": number, "start": node.offset, "tail": tail}
        if isinstance(node, p.Repeated):
            count = None if node.count is None else bit_pieces(node.count.place)
            inside = self._inside(node.plan, message, leaf.path.rpartition(".")[2], f"{abbr}.each")
            return {"kind": "groups", **table, "width": node.width, "count": count, "inside": inside}
        kinds = {
            kind.number: {
                "name": kind.name,
                "size": kind.size,
                **self._inside(kind.plan, message, kind.name, f"{abbr}.{kind.name}"),
            }
            for kind in node.kinds
        }
        sizes = None if node.size is None else bit_pieces(node.size.place)
        more = {"head": node.head, "counted": node.counted, "tag": bit_pieces(node.tag.place), "sizes": sizes}
        return {"kind": "items", **table, **more, "kinds": kinds}

    def _inside(self, plan: p.MessagePlan, message: Message, name: str, own: str) -> dict[str, Any]:
        """Return what an item's data or a group are, as the program reads a message; `name` is what its value is called."""
        table: dict[str, Any] = {**_shape(plan, "data."), "one_of": [], "fields": []}
        before = len(self.fields)
        for leaf in plan.leaves:
            made = self._leaf(leaf, message, plan, f"{own}{leaf.path[4:]}")
            if leaf.whens:
                selector_path, when = leaf.conditions[-1]
                made["when"] = [selector_path, dict.fromkeys(when.values, True)]
            table["fields"].append(made)
        for field in self.fields[before:]:
            if field[1].partition(".")[0] == "data":  # the plan's word for the whole of it
                field[1] = name + field[1][4:]
        return table

    def _rest(self, leaf: p.NodePath, node: p.Rest, message: Message, abbr: str) -> dict[str, Any]:
        if node.size > 8:
            self._lose(
                message.name, leaf.path, "bits without a field are not shown in layouts of more than 8 bytes"
            )
            return {"kind": "request"}

        def masks(mask: int) -> list[int]:
            return list(mask.to_bytes(node.size, "little"))

        always = next((mask for value, mask in node.claimed if value is None), 0)
        more: list[Any] = []
        # The selectors of a layout stand beside its bits without a field.
        inside = leaf.path.removesuffix("reserved")
        if node.selector is not None:
            sets = {value: masks(mask) for value, mask in node.claimed if value is not None}
            more.append([inside + node.selector.name, sets])
        for selector, by_value in node.more:
            more.append([inside + selector.name, {value: masks(mask) for value, mask in by_value}])
        return {
            "kind": "rest",
            "field": self._field(abbr, leaf.path, "uint64", "HEX", None, leaf.doc),
            "start": node.offset,
            "size": node.size,
            "always": masks(always),
            "more": more,
        }

    def _scalar(
        self, leaf: p.NodePath, node: p.Scalar, plan: p.MessagePlan, message: Message, abbr: str
    ) -> dict[str, Any]:
        if node.is_bytes:
            kind = "bytes" if node.kind == "bytes" else "string"
            number = self._field(abbr, leaf.path, kind, None, None, leaf.doc)
            return {
                "kind": node.kind,
                "field": number,
                "start": node.offset,
                "size": node.size,
                "tail": plan.tail,
                "ends": list(node.ends.encode("latin-1")),
            }
        bits = node.place
        width = len(bits)
        if width > WIDEST:
            self._lose(message.name, leaf.path, f"a number of {width} bits is shown as bytes")
            number = self._field(abbr, leaf.path, "bytes", None, None, leaf.doc)
            first, last = min(bits) // 8, max(bits) // 8
            return {"kind": "bytes", "field": number, "start": first, "size": last - first + 1, "tail": 0}
        more: dict[str, Any] = {"kind": node.kind, "width": width, **_placed(bits)}
        if node.kind == "float":
            return more | self._number(leaf, node, abbr, "double", width)
        is_signed = node.kind == "int" or node.is_magnitude
        if node.is_magnitude:
            more["magnitude"] = True
        kind = f"{'int' if is_signed else 'uint'}{_size(width)}"
        more |= self._number(leaf, node, abbr, kind, width)
        more["is_signed"] = is_signed or None
        if node.by_bit is not None:
            more["unit"] = ""
            self._lose(message.name, leaf.path, "two scales, of which its highest bit chooses: shown as raw")
        if flags := node.flag_names:
            more["flags"] = [
                [bit, self._field(f"{abbr}.{name}", name, "boolean", None, None, "")]
                for bit, name in flags.items()
            ]
        return more

    def _number(
        self, leaf: p.NodePath, node: p.Scalar | p.FromIdentifier, abbr: str, kind: str, width: int
    ) -> dict[str, Any]:
        """Return the fields of a number: the quantity with the raw number below it, or the raw number alone."""
        scale, names = node.scale, node.value_names
        more: dict[str, Any] = {"unit": ProblemText.one_line(node.unit)}
        if kind != "double" and width > 32:
            more["is_wide"] = True
        is_table = kind != "double" and width <= 32 and all(0 <= value < 1 << 31 for value in names)
        table = {value: ProblemText.one_line(name) or "?" for value, name in names.items()} if names else None
        base = None if kind == "double" else "DEC"
        if scale is not None and (scale.scale != 1 or scale.offset):
            more["field"] = self._field(abbr, leaf.path, "double", None, None, leaf.doc)
            more["raw"] = self._field(f"{abbr}.raw", "raw", kind, base, None, "the number on the wire")
            more |= {"scale": float(scale.scale), "offset": float(scale.offset), "names": table}
        else:
            more["field"] = self._field(abbr, leaf.path, kind, base, table if is_table else None, leaf.doc)
            if table is not None and not is_table:
                more |= {"names": table, "is_named": True}
        if scale is not None and scale.unknown:
            # (least, greatest) of each run of values
            more["unknown"] = [list(run) for run in scale.unknown_runs if run[0] == run[0]]
        return more


# ---------------------------------------------------------------------- data


def _shape(plan: p.MessagePlan, inside: str = "") -> dict[str, Any]:
    """Return how long a message may be and which of its bytes are constant; selectors have paths that begin with
    `inside`.
    """
    table: dict[str, Any] = {"least": plan.least}
    if plan.lengths is not None:
        table["lengths"] = value_set(plan.lengths)
    if plan.lengths_by is not None:
        selector, sizes, otherwise = plan.lengths_by
        table["by"] = {"selector": inside + selector.name, "sizes": dict(sizes), "otherwise": otherwise}
    table["constants"] = [[constant.offset, constant.mask, constant.value] for constant in plan.constants]
    return table


def _program(name: str) -> str:
    return files(__name__.rpartition(".")[0]).joinpath(name).read_text(encoding="utf-8")


def _covered(part: Any) -> dict[str, Any]:
    if isinstance(part, slice):
        return {"slice": True, "from": part.start, "to": part.stop}
    if isinstance(part, IdBytes):
        return {"id": part.size, "is_big": part.order == "big", "mask": part.mask}
    if isinstance(part, DataIds):
        offset, shift, mask = part.place
        return {"ids": list(part.ids), "at": offset, "below": 2**shift, "values": mask + 1}
    return {"bytes": list(part)} if isinstance(part, bytes) else {"extra": True}


def _placed(bits: Sequence[int]) -> dict[str, Any]:
    return {"pieces": bit_pieces(bits), "first": min(bits) // 8, "last": max(bits) // 8}


def _size(width: int) -> int:
    """Return the size of Wireshark's number for one of so many bits."""
    return next(size for size in (8, 16, 24, 32, 64) if width <= size)


#: Columns of a line before a table is broken over several.
WIDTH = 110
# fmt: off
_NAMES = frozenset((
    "and", "break", "do", "else", "elseif", "end", "false", "for", "function", "goto", "if", "in", "local", "nil", "not",
    "or", "repeat", "return", "then", "true", "until", "while",
))
# fmt: on


def lua_string(text: str | bytes) -> str:
    """Return a string literal; characters beyond ASCII as their UTF-8 bytes."""
    data = text.encode("utf-8", "surrogatepass") if isinstance(text, str) else text
    out = [chr(byte) if 0x20 <= byte < 0x7F and byte not in b'"\\' else f"\\{byte:03d}" for byte in data]
    return '"' + "".join(out) + '"'


def lua_literal(value: Any, indent: int = 0) -> str:
    """Return a value as a Lua expression: tables over several lines where they are long."""
    flat = _flat(value)
    if len(flat) + indent <= WIDTH or not isinstance(value, (Mapping, Sequence)) or isinstance(value, str):
        return flat
    pad = "  " * (indent // 2 + 1)
    if isinstance(value, Mapping):
        items = [(f"{_key(key)} = ", inner) for key, inner in value.items() if inner is not None]
    else:
        items = [("", inner) for inner in value]
    lines = [f"{pad}{start}{lua_literal(inner, indent + 2)}," for start, inner in items]
    return "\n".join(["{", *lines, "  " * (indent // 2) + "}"])


def _flat(value: Any) -> str:
    match value:
        case None:
            return "nil"
        case bool():
            return "true" if value else "false"
        case int():
            return str(value)
        case float():
            return repr(value)
        case str() | bytes():
            return lua_string(value)
        case Mapping():
            inner = ", ".join(
                f"{_key(key)} = {_flat(content)}" for key, content in value.items() if content is not None
            )
        case _:
            inner = ", ".join(map(_flat, value))
    return f"{{ {inner} }}" if inner else "{}"


def _key(key: Any) -> str:
    if isinstance(key, str) and key.isascii() and key.isidentifier() and key not in _NAMES:
        return key
    return f"[{_flat(key)}]"
