"""What the devices of a bus are to be sent in a tick: the messages of their set-points, as few as the rules make of them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator

from .coalesce import CoalescingRule, OutgoingMessage, Setpoint, per_device
from .device import Device

#: The rule that makes few messages of a device's set-points of a message; None: it has a message of its own.
RuleOf = Callable[[str, Device], CoalescingRule | None]
#: By message: its rule, who has set-points of it, and those that go through a rule.
_Wanted = dict[str, tuple[CoalescingRule | None, list[Device], list[Setpoint]]]


def gathered(devices: Iterable[Device], rule_of: RuleOf, now: int) -> Iterator[OutgoingMessage]:
    """Yield what the devices want at the instant `now` (ns) and has not been sent yet."""
    wanted: _Wanted = {}

    def group(message: str, device: Device) -> tuple[CoalescingRule | None, list[Device], list[Setpoint]]:
        found = wanted.get(message)
        if found is None:
            rule = rule_of(message, device)
            found = wanted[message] = (None if rule is per_device else rule, [], [])
        return found

    for device in devices:
        if type(device).wants is not Device.wants:
            for want in device.wants(now):
                group(want.message, device)[2].append(want)
            continue
        for message in device.due_messages(now):
            rule, its, wants = group(message, device)
            if rule is None:
                its.append(device)
            else:
                wants += device.setpoints_of(message)
    for message, (rule, its, wants) in wanted.items():
        for device in its:
            fields = device.gathered(message, ())
            if fields is not None:
                yield OutgoingMessage(device, message, fields)
        if wants:
            yield from (rule or per_device)(wants)
