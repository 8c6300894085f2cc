"""What a robot's buses must carry: how full they are, how late messages are.

  aces bus budget hubo2plus
  aces bus budget arm.toml --rate 500 -o budget.png
  aces bus budget arm.toml --json

Rows of the table are messages of several devices together; each one that may
miss its deadline is named. More: docs/budget.md.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from aces_bus.errors import CallerError
from aces_bus.plain_text import printable
from aces_bus.protocol.record import PlainValue
from aces_tools.console import print_json, say, say_note
from aces_tools.options import (
    JSON,
    Arguments,
    argument,
    at_least,
    duration,
    duration_or_none,
    flag,
    positive,
    several,
)
from aces_tools.robot_arg import DRIVER_FILES, chosen_robot

if TYPE_CHECKING:
    from . import Assumptions, BusBudget, MessageBudget, RobotBudget

#: So many of what misses its deadline are named.
NAMED = 3


SUMMARY = "what a robot's buses must carry: how full, how late at most"

ARGUMENTS: Arguments = (
    argument(
        "robot",
        nargs="?",
        metavar="ROBOT",
        help="a robot that is installed, or its file (default: $ACES_ROBOT)",
    ),
    argument(
        "-b",
        "--bitrate",
        type=at_least(1),
        metavar="N",
        help="bit rate of all CAN buses (default: the file's)",
    ),
    argument(
        "--data-bitrate",
        type=at_least(1),
        metavar="N",
        help="bit rate of the data of CAN FD frames (default: the file's)",
    ),
    argument(
        "--rate",
        type=positive,
        metavar="HZ",
        help="of the host's ticks, where the file states none for a bus (default: the robot's, else 100)",
    ),
    several(
        "--queue",
        metavar="NODE=KIND",
        help="how a node sends: fifo, or priority (default: host=fifo, devices by priority)",
    ),
    argument(
        "--errors",
        metavar="N,EVERY",
        help="CAN: number of frames destroyed at once, and one in each such time, as 2,100ms (default: none)",
    ),
    argument(
        "--jitter",
        type=duration_or_none,
        default=0,
        metavar="DURATION",
        help="a tick is so late at most",
    ),
    argument(
        "--answer",
        type=duration_or_none,
        default=0,
        metavar="DURATION",
        help="time that devices take to answer (default: as their twins)",
    ),
    argument(
        "--latency",
        type=duration_or_none,
        default=0,
        metavar="DURATION",
        help="time that the host takes from an answer to the next request, on half-duplex lines",
    ),
    flag("--together", help="polls that are not sent in each tick may all be due in one"),
    flag("--all", help="each message of each device in the table"),
    argument("-o", "--output", metavar="FILE", help="draw it, too: .png, .svg or .pdf"),
    DRIVER_FILES,
    JSON.but(help="one JSON object"),
)


def run(arguments: argparse.Namespace) -> int:
    """Print the budget of the robot that is named; 1 when a deadline cannot be kept."""
    if arguments.output is not None:
        from aces_tools.plotting.figure import check_output

        check_output(arguments.output)
    assumptions = _assumptions(arguments)
    robot = chosen_robot(
        arguments.robot,
        arguments.driver,
        how="aces bus budget NAME or FILE.toml",
    )
    from . import robot_budget, robot_traffic
    from .robot import at_bitrate

    traffic = at_bitrate(
        robot_traffic(robot, rate_hz=arguments.rate),
        bitrate=arguments.bitrate,
        data_bitrate=arguments.data_bitrate,
    )
    found, twice = robot_budget(traffic, assumptions), robot_budget(traffic.at(2), assumptions)
    if arguments.output is not None:
        from .picture import save_budget

        save_budget(found, arguments.output)
    if arguments.json:
        print_json(_object(found) | {"twice": _object(twice)})
    else:
        _print(found, twice, is_long=arguments.all)
    if arguments.output is not None:
        say_note(f"wrote {arguments.output}")
    for note in traffic.notes:  # without those the numbers are too low
        say(printable(note))
    return 0 if found.is_met else 1


def _assumptions(arguments: argparse.Namespace) -> Assumptions:
    from . import Assumptions, ErrorModel

    queues: dict[str, Any] = {}
    for text in arguments.queue:
        node, _, kind = text.partition("=")
        if kind not in ("fifo", "priority"):
            raise CallerError(f"--queue {text}: write NODE=fifo or NODE=priority, such as host=priority")
        queues[node] = kind
    errors = ErrorModel()
    if arguments.errors is not None:
        number, _, every = arguments.errors.partition(",")
        try:
            errors = ErrorModel(int(number), duration(every))
        except (ValueError, argparse.ArgumentTypeError):
            raise CallerError(
                f"--errors {arguments.errors}: write how many at once, and the time between two: 2,100ms"
            ) from None
    return Assumptions(
        queues=queues,
        errors=errors,
        jitter_ns=arguments.jitter,
        answer_ns=arguments.answer,
        latency_ns=arguments.latency,
        together=arguments.together,
    )


# ---------------------------------------------------------------------- as a table


def _print(found: RobotBudget, twice: RobotBudget, *, is_long: bool) -> None:
    from aces_tools.output.columns import Page

    page = Page(None)
    for index, (name, bus) in enumerate(found.buses.items()):
        if index:
            page.lines([""])
        page.beside(f"{name}:", [_head(bus)], "message")
        if bus.utilisation is None:
            continue
        rows = [_row(label, some, is_long) for label, some in _grouped(bus.messages, is_long)]
        page.table(("message", "from", "no.", "every", "wire", "at most", "deadline", "latest"), rows)
        for line in _missed(bus, "misses its deadline", "miss their deadlines"):
            page.beside("missed:", [line], "place")
        page.beside("at twice the rate:", [_twice(twice.buses[name])], "place")


def _head(bus: BusBudget) -> str:
    """Return the bus in a line: how full, and how long a tick's traffic takes."""
    traffic = bus.traffic
    if bus.utilisation is None or traffic.bitrate is None:
        return "datagrams: they have no bit rate, and nothing is computed"
    kind = "CAN" if traffic.link == "can" else "half-duplex line" if traffic.half_duplex else "line"
    unit = "bit/s" if traffic.link == "can" else "baud"
    text = f"{kind}, {traffic.bitrate:,} {unit}: {bus.utilisation:.0%} used"
    tick = _time(traffic.tick_ns)
    if any(message.sent.is_ticked for message in bus.messages):
        text += (
            f"; a tick is over after {_time(bus.round_ns)} of {tick}"
            if bus.round_ns is not None
            else f"; a tick is not over within its {tick}"
        )
    if bus.silent_ns is not None:
        text += f" ({_time(bus.silent_ns)} with a device that is silent)"
    return text


def _grouped(
    messages: Sequence[MessageBudget], is_long: bool
) -> Iterator[tuple[str, Sequence[MessageBudget]]]:
    """Yield the messages of one kind, period and length of all devices together."""
    groups: dict[Any, list[MessageBudget]] = {}
    for message in messages:
        key: Any = message.name
        if not is_long:
            key = message.sent.message, message.sent.node == "host", message.sent.period_ns, message.wire_ns
        groups.setdefault(key, []).append(message)
    for some in groups.values():
        yield (some[0].name if is_long else some[0].sent.message), some


def _row(label: str, some: Sequence[MessageBudget], is_long: bool) -> tuple[str, ...]:
    last = max(some, key=lambda message: float("inf") if message.response_ns is None else message.response_ns)
    sender = (
        "host" if last.sent.node == "host" else last.sent.node if is_long or len(some) == 1 else "devices"
    )
    return (
        printable(label),
        printable(sender),
        "" if is_long else str(len(some)),
        _time(last.sent.period_ns),
        f"{last.wire_ns / 1000:,.0f} µs",
        "no bound" if last.response_ns is None else _time(last.response_ns),
        _time(last.deadline_ns),
        "" if is_long or len(some) == 1 else printable(last.sent.device),
    )


def _time(ns: int | None) -> str:
    """Return a time as people write it: 4.45 ms."""
    if ns is None:
        return "–"
    return (
        f"{ns / 1e9:.4g} s"
        if ns >= 1_000_000_000
        else f"{ns / 1e6:.3g} ms"
        if ns < 100_000_000
        else f"{ns / 1e6:.0f} ms"
    )


def _names(some: Sequence[MessageBudget]) -> str:
    text = ", ".join(printable(message.name) for message in some[:NAMED])
    return text if len(some) <= NAMED else f"{text} and {len(some) - NAMED} more"


def _missed(bus: BusBudget, singular: str, several: str) -> list[str]:
    """Return what cannot be kept, a line each: what a tick has no room for, what is late."""
    lines = []
    carried = [message for message in bus.missed if message.is_carried and not message.sent.after]
    if carried:
        lines.append(
            f"no room in a tick ({bus.traffic.budget:.0%} of it is for set-points and polls): {_names(carried)}"
            f" {'waits' if len(carried) == 1 else 'wait'} for the next"
        )
    late = [message for message in bus.missed if not message.is_carried]
    if late:
        lines.append(f"{_names(late)} {singular if len(late) == 1 else several}")
    return lines


def _twice(bus: BusBudget) -> str:
    """Return what changes at twice the rate, in a line."""
    text = f"{bus.utilisation or 0:.0%} used, "
    if bus.is_met:
        return f"{text}every deadline is kept"
    tick = _time(bus.traffic.tick_ns)
    return text + "; ".join(_missed(bus, f"misses its {tick}", f"miss their {tick}"))


# ---------------------------------------------------------------------- as JSON


def _object(found: RobotBudget) -> dict[str, PlainValue]:
    return {
        "robot": found.traffic.robot,
        "rate_hz": found.traffic.rate_hz,
        "ok": found.is_met,
        "notes": list(found.traffic.notes),
        "buses": [
            {
                "name": name,
                "link": bus.traffic.link,
                "bitrate": bus.traffic.bitrate,
                "data_bitrate": bus.traffic.data_bitrate,
                "half_duplex": bus.traffic.half_duplex,
                "tick_ns": bus.traffic.tick_ns,
                "utilisation": bus.utilisation,
                "round_ns": bus.round_ns,
                "silent_ns": bus.silent_ns,
                "ok": bus.is_met,
                "messages": [_message_object(message) for message in bus.messages],
            }
            for name, bus in found.buses.items()
        ],
    }


def _message_object(message: MessageBudget) -> Mapping[str, PlainValue]:
    sent = message.sent
    return {
        "name": sent.name,
        "node": sent.node,
        "device": sent.device or None,
        "identifier": sent.identifier,
        "extended": sent.extended,
        "fd": sent.fd,
        "size": sent.size,
        "period_ns": sent.period_ns,
        "after": sent.after or None,
        "delay_ns": sent.delay_ns,
        "wire_ns": message.wire_ns,
        "response_ns": message.response_ns,
        "deadline_ns": message.deadline_ns,
        "carried": message.is_carried,
        "ok": message.is_met,
    }
