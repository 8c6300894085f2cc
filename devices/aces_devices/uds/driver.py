"""An ECU by UDS: values by identifier and trouble codes as signals; sessions, writing and routines only when asked for.

1. An ECU takes one request at a time, and so does its bus here. An answer counts for what it names: a late one
   passes for no other.
2. `response_pending` is patience: what was asked for may be answered for so long as the session says.
3. Nothing is written, reset or started of its own accord. What changes an ECU is sent once: without an answer
   it is not known whether it was carried out.
4. A stop ends what was started and goes back to the default session, before all that waits.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, ClassVar

from aces_bus.device import Device, Driver, HostLoss, Job, Poll, Steps
from aces_bus.device.settings import described, settings_of
from aces_bus.device.signals import Signal
from aces_bus.errors import AcesError, CallerError, DeviceError, UnknownNameError
from aces_bus.protocol import Record
from aces_bus.protocol.record import FieldValue
from aces_protocols.uds.spec import SESSIONS

from ..scanning import scan_numbers
from .answers import is_answer, late_text
from .settings import TIMEOUT_S, UdsSettings
from .table import UdsValue, identifiers_of
from .twin import UdsTwin

#: How long after `response_pending` (s), until a session says otherwise: P2* of ISO 14229-2.
PATIENCE_S = 5.0
#: A session ends after 5 s without a request (ISO 14229-2); it is kept so often (ns).
KEEP_NS = 2_000_000_000
#: One that is busy is asked again, so often and after (ns); it has not done what was asked.
BUSY_TRIES, BUSY_NS = 5, 50_000_000
#: Of the bytes of a transfer's request these are not data.
TRANSFER_HEAD = 2
NO_SESSION = ("service_not_in_this_session", "subfunction_not_in_this_session")
#: Why a routine is not stopped that does not run any more: ISO 14229-1, RoutineControl.
OVER = ("sequence_error", *NO_SESSION)
#: The identifier of the session that it is in, and the default one there (ISO 14229-1, C.1 and 10.2).
ACTIVE_SESSION, DEFAULT_SESSION = 0xF186, b"\x01"


class Uds(Device):
    """Signals: one a value of the table; `codes` and `trouble` of what is confirmed; `session`.

    `key_of(level, seed)` makes the key of a seed, which each maker keeps secret: set it, or declare it in a subclass.
    """

    protocol = "uds"
    when_host_is_lost = HostLoss(
        "nothing moves", "ISO 14229-2: S3 server time-out", 5.0,
        "it ends its session; what a routine does then is its maker's affair",
    )  # fmt: skip
    one_at_a_time = True
    actions: ClassVar = {
        "read": "ask for one value: its name",
        "read_codes": "ask for trouble codes: status=pending, confirmed (default), failed …, or all",
        "enable": "begin the session of the settings and unlock the level of the settings, to write",
        "disable": "go back to the default session",
        "write": "write one value: name and value",
        "clear_codes": "clear all trouble codes",
        "reset": "have it boot: kind=hard (default), soft or key_off_on",
        "start_routine": "start a routine: its name, and its data in hexadecimal",
        "stop_routine": "stop a routine: its name, and data in hexadecimal",
        "routine_results": "ask for the results of a routine: its name",
    }
    asking: ClassVar = ("read", "read_codes", "routine_results")
    key_of: Callable[[int, bytes], bytes] | None = None
    settings: UdsSettings

    def setup(self) -> None:
        """Add a signal for each value, and polls. Raise `CallerError` for a wrong table or setting."""
        self.settings = given = settings_of(self.name, UdsSettings, self.config.settings)
        if given.session not in SESSIONS or given.session == "default":
            others = ", ".join(name for name in SESSIONS if name != "default")
            raise CallerError(f"{self.name}: the setting session = {given.session!r} is none of {others}")
        if given.level and given.level % 2 == 0:
            raise CallerError(
                f"{self.name}: the setting level = {given.level} is even; seeds are asked for with an odd one"
            )
        self.table = identifiers_of(self.name, given.table, given.identifiers)
        self.by_number = {entry.number: entry for entry in self.table.values()}
        self.session = "default"
        self.unlocked = 0
        self.patience_s = PATIENCE_S
        #: Whether a stop has ended a session since that was last confirmed, and whether that is being asked.
        self._is_to_confirm = self._asks_session = False
        #: Whether it may be in a session that is not the default, and the routines, by number, that may run.
        self.is_engaged = False
        self.started: set[int] = set()
        self._keeper: Job | None = None
        self._value_polls: dict[str, Poll] = {}
        self._declare_values()
        answers = ("Data", "Codes")
        self._session = self.add_signal(
            "session", read_from=answers, stale_s=1e9, doc="the one begun from here"
        )
        self.polls = [*{id(poll): poll for poll in self._value_polls.values()}.values()]
        if given.codes_every_s:
            self.polls += [self._codes_poll(given.codes_every_s)]

    def _declare_values(self) -> None:
        given = self.settings
        periods: dict[float, list[UdsValue]] = {}
        for value in self.table.values():
            every = given.every_s if value.entry.every_s is None else value.entry.every_s
            is_read = value.entry.access != "write"
            if is_read:
                periods.setdefault(every, []).append(value)
            self.add_signal(
                value.name,
                unit=value.entry.unit,
                setter=None if value.entry.access == "read" else partial(self._set, value.name),
                lower=value.entry.lower,
                upper=value.entry.upper,
                read_from=("Data",) if is_read else (),
                stale_s=max(0.5, 5 * every) if every else 1e9,
                doc=value.entry.doc,
                source=value.entry.source,
            )
        for every, mine in periods.items():
            for at in range(0, len(mine) if every else 0, given.at_once):
                asked = mine[at : at + given.at_once]
                numbers = {"identifiers": [value.number for value in asked]}
                poll = Poll(
                    "ReadData", ("Data", "Refused"), numbers, every_s=every, timeout_s=given.timeout_s
                )
                self._value_polls |= dict.fromkeys((entry.name for entry in asked), poll)

    def _codes_poll(self, every_s: float) -> Poll:
        known: dict[str, Any] = {
            "read_from": ("Codes",), "stale_s": max(0.5, 5 * every_s), "source": "ISO 14229-1",
        }  # fmt: skip
        self._codes = self.add_signal("codes", doc="how many trouble codes are confirmed", **known)
        self._trouble = self.add_signal("trouble", doc='confirmed trouble codes, or "none"', **known)
        asked = {"status": ["confirmed"]}
        timeout_s = self.settings.timeout_s
        return Poll("ReadCodes", ("Codes", "Refused"), asked, every_s=every_s, timeout_s=timeout_s)

    def polls_of(self, name: str) -> list[Poll]:
        """Return the poll that reads the signal."""
        own = name.partition(".")[2]
        if own in ("codes", "trouble"):
            return [poll for poll in self.polls if poll.message == "ReadCodes"]
        found = self._value_polls.get(own)
        return [poll for poll in self.polls if found is not None and poll.fields == found.fields]

    def start(self) -> Job | None:
        """Read what is read once."""
        unread = (entry for entry in self.table.values() if entry.entry.access != "write")
        once = [entry.name for entry in unread if entry.name not in self._value_polls]
        if not once:
            return None

        def steps(job: Job) -> Steps:
            for name in once:
                yield self.read(name)

        return self.job("read what does not change", steps)

    # ------------------------------------------------------------------ up

    def receive(self, record: Record, instant: int) -> None:
        """Take a record: a plea for patience, an answer to a request, or a late answer that belongs to none."""
        name = type(record).__name__
        if name == "Refused" and record.reason == "response_pending":
            self.last_received = instant
            self.host.prolong(self, self.patience_s)
            return
        asked = next((ticket for ticket in self.awaiting if is_answer(record, ticket)), None)
        if asked is None:
            is_awaited = any(name in ticket.reply for ticket in self.awaiting)
            if is_awaited or (name == "Session" and not self.host.passive):
                self.last_received = instant
                self.emit_event("late reply", f"{late_text(record)}, which nothing asks for now")
                # What was begun is not known to be over, and is nothing to go on with.
                self.is_engaged |= name == "Session" and str(record.session) != "default"
                return
        elif asked is not self.awaiting[0]:  # the host takes the oldest that has this message for an answer
            self.awaiting.remove(asked)
            self.awaiting.insert(0, asked)
        if name == "Codes" and asked is not None and asked.poll is not None:
            confirmed = [str(code.code) for code in record.codes]
            self._codes.update(len(confirmed), instant)
            self._trouble.update(", ".join(confirmed) or "none", instant)
        super().receive(record, instant)

    def received(self, record: Record, instant: int) -> None:
        """Take values by their identifiers; sessions; refusals."""
        match type(record).__name__:
            case "Data":
                self._take(record.meta.raw[1:], instant)
            case "Session":
                self._begun(str(record.session))
                self._is_over(str(record.session) == "default")
                self.patience_s = max(record.patience, self.settings.timeout_s)
            case "ResetBegins":
                self._begun("default")
                self._is_over(True)
            case "Refused" if self._asks_session:
                pass  # it does not say which one it is in
            case "Refused":
                self.emit_event("alarm", f"refuses {record.service}: {record.reason}")
                if record.reason in NO_SESSION and self.session != "default":
                    self._begun("default")
                    self.rebooted("the session is over")
            case _:
                pass
        self._session.update(self.session, instant)

    def _take(self, data: bytes, instant: int) -> None:
        """Update signals from identifiers and values, as far as the table knows them."""
        while len(data) >= 2:
            value = self.by_number.get(int.from_bytes(data[:2], "big"))
            if value is None:
                return
            inside, data = data[2 : 2 + value.size], data[2 + value.size :]
            if len(inside) < value.size or (len(data) == 1):
                self.emit_event(
                    "malformed", f"{value.name}: {len(inside) + len(data)} bytes, its type has {value.size}"
                )
                return
            self.signals[f"{self.name}.{value.name}"].update(value.value(inside), instant)

    def _begun(self, session: str) -> None:
        """Note that another session may have begun, in which nothing is unlocked; keep a session that is not
        the default.
        """
        self.session, self.unlocked = session, 0
        self.epoch += 1
        if session != "default" and (self._keeper is None or self._keeper.is_over):
            self._keeper = self.job("keep the session", self._keep)

    def _is_over(self, is_over: bool) -> None:
        """Note the ECU's word whether there is anything left to stop."""
        self.is_engaged = not is_over
        if is_over:
            self.started.clear()

    def _keep(self, job: Job) -> Steps:
        while self.session != "default" and self.host.is_open:
            yield KEEP_NS
            if self.session != "default" and self.host.is_open:
                try:
                    yield self.send("TesterPresent", none=0, suppress=1)
                except AcesError:
                    pass  # reported as not sent; the session may be over, and refusals will say so

    def no_reply(self, ticket: Any) -> None:
        """Note that a silent device may have rebooted and must be enabled anew."""
        if self.misses >= self.silent_after and self.session != "default":
            self._begun("default")

    def takes(self, signal: Signal) -> bool | None:
        """Return whether the device is enabled."""
        is_unlocked = self.unlocked == self.settings.level
        return self.session != "default" and is_unlocked and super().takes(signal)

    # ------------------------------------------------------------------ asking

    def _asked(
        self,
        doing: str,
        message: str,
        reply: str,
        *,
        timeout_s: float | None = None,
        retries: int = 0,
        **fields: Any,
    ) -> Steps:
        """Yield steps that ask, and return the answer. Raise `DeviceError` with the reason for a refusal."""
        for left in reversed(range(BUSY_TRIES)):
            answer = yield self.ask(
                message,
                reply=(reply, "Refused"),
                timeout_s=self.settings.timeout_s if timeout_s is None else timeout_s,
                retries=retries,
                **fields,
            )
            if type(answer).__name__ != "Refused":
                return answer
            if answer.reason != "busy" or not left:
                raise DeviceError(f"{self.name}: {doing}: refused: {answer.reason}")
            yield BUSY_NS

    def _value(self, name: str) -> UdsValue:
        if name not in self.table:
            raise UnknownNameError(f"value of {self.name}", name, self.table)
        return self.table[name]

    def read(self, name: str) -> Job:
        """Ask for one value. Fails with `DeviceError` when it is refused, `NoReplyError` without an answer.

        Raises `UnknownNameError`.
        """
        entry = self._value(name)

        def steps(job: Job) -> Steps:
            answer = yield from self._asked(
                f"reading {name}", "ReadData", "Data", retries=1, identifiers=[entry.number]
            )
            data = answer.meta.raw[3:]
            if len(data) != entry.size:
                raise DeviceError(
                    f"{self.name}: reading {name}: {len(data)} bytes, its type has {entry.size}"
                )
            return entry.value(data)

        return self.job(f"read {name}", steps)

    def read_codes(self, status: str = "confirmed") -> Job:
        """Read trouble codes with one of these bits of status, or "all" that it can report: code → bits of
        its status.
        """
        asks = ("ReadKnownCodes", "KnownCodes") if status == "all" else ("ReadCodes", "Codes")
        fields: dict[str, Any] = {} if status == "all" else {"status": status.replace(",", " ").split()}

        def steps(job: Job) -> Steps:
            answer = yield from self._asked("reading codes", *asks, retries=1, **fields)
            return {str(code.code): list(code.status) for code in answer.codes}

        return self.job("read codes", steps)

    # ------------------------------------------------------------------ what changes it

    def change_session(self, session: str) -> Job:
        """Begin a session by its name. Fails with `DeviceError`, `NoReplyError`."""

        def steps(job: Job) -> Steps:
            if session != "default":
                self.is_engaged = True  # before it answers
            yield from self._asked(f"session {session}", "ChangeSession", "Session", session=session)

        return self.lead(f"session {session}", steps)

    def unlock(self, level: int) -> Job:
        """Ask for a seed with an odd `level`, and send its key. Raises `CallerError` without `key_of`."""
        if self.key_of is None:
            raise CallerError(
                f"{self.name}: level {level} needs key_of(level, seed), which makes the key of a seed: set it, or declare"
                " it in a subclass of Uds"
            )
        make = self.key_of

        def steps(job: Job) -> Steps:
            doing = f"unlocking level {level}"
            seed = yield from self._asked(doing, "AccessSecurity", "Security", step=level, data=b"")
            if any(seed.data):  # zeros: it is unlocked
                key = make(level, seed.data)
                yield from self._asked(doing, "AccessSecurity", "Security", step=level + 1, data=key)
            self.unlocked = level

        return self.lead(f"unlock level {level}", steps)

    def enable(self) -> Job:
        """Begin the session of the settings, and unlock the level of the settings: what is set is written from now on."""

        def steps(job: Job) -> Steps:
            self.session = "default"  # anew in any case
            yield from self._ready()

        return self.lead("enable", steps)

    def _ready(self) -> Steps:
        """Be in a session, with the level unlocked, as what changes an ECU needs."""
        if self.session == "default":
            yield self.change_session(self.settings.session)
        if self.unlocked != self.settings.level:
            yield self.unlock(self.settings.level)

    def disable(self) -> Job:
        """Go back to the default session."""
        return self.change_session("default")

    def write(self, name: str, value: Any) -> Job:
        """Write one value, in a session that is begun where there is none; over when the ECU has confirmed it.

        Fails with `DeviceError`, `NoReplyError`. Raises `UnknownNameError`, and `CallerError` for one that does not fit, or
        can only be read.
        """
        entry = self._value(name)
        if entry.entry.access == "read":
            raise CallerError(f"{self.name}: {name} can only be read")
        data = entry.data(value)

        def steps(job: Job) -> Steps:
            doing = f"writing {name} = {value!r}"
            yield from self._ready()
            yield from self._asked(doing, "WriteData", "DataWritten", identifier=entry.number, data=data)

        return self.lead(f"write {name}", steps)

    def _set(self, name: str, value: FieldValue) -> None:
        """Write a set-point now."""
        if self.host.passive or not self.takes(self[name]):
            why = "this bus is only listened to" if self.host.passive else f"{self.name} is not enabled"
            self.emit_event("not sent", f"{name}: {why}")
            return
        self.is_driven = True

        def over(job: Job) -> None:
            if job.error is not None:
                self.emit_event("not sent", str(job.error))

        self.write(name, value).then(over)

    def clear_codes(self) -> Job:
        """Clear all trouble codes."""

        def steps(job: Job) -> Steps:
            yield from self._asked(
                "clearing codes", "ClearCodes", "CodesCleared", timeout_s=self.patience_s, group=0xFFFFFF
            )

        return self.lead("clear codes", steps)

    def reset(self, kind: str = "hard") -> Job:
        """Have it boot; over when it says that it begins."""

        def steps(job: Job) -> Steps:
            yield from self._asked(f"{kind} reset", "Reset", "ResetBegins", kind=kind)
            self.rebooted(f"{kind} reset")

        return self.lead(f"{kind} reset", steps)

    def _routine(self, action: str, name: str, data: bytes | str) -> Job:
        if name not in self.settings.routines:
            raise UnknownNameError(f"routine of {self.name}", name, self.settings.routines)
        number = self.settings.routines[name]
        given = bytes.fromhex(data) if isinstance(data, str) else data

        def steps(job: Job) -> Steps:
            if action == "start":
                yield from self._ready()
                self.is_driven = True
                self.is_engaged = True
                self.started.add(number)  # before it answers: a stop ends it in any case
            answer = yield from self._asked(
                f"{action} {name}", "ControlRoutine", "Routine", action=action, routine=number, data=given
            )
            if action == "stop":
                self.started.discard(number)
            return answer.data

        return self.lead(f"{action} {name}", steps)

    def start_routine(self, name: str, data: bytes | str = b"") -> Job:
        """Start a routine, in a session that is begun where there is none: the bytes of its answer.

        Raises `UnknownNameError`.
        """
        return self._routine("start", name, data)

    def stop_routine(self, name: str, data: bytes | str = b"") -> Job:
        """Stop a routine; the bytes of its answer. Raises `UnknownNameError`."""
        return self._routine("stop", name, data)

    def routine_results(self, name: str) -> Job:
        """Return the bytes of a routine's results. Raises `UnknownNameError`."""
        return self._routine("results", name, b"")

    def download(self, address: int, data: bytes, method: int = 0) -> Job:
        """Write `data` into its memory from `address` on; `method` is compression and encryption, 0 for neither.

        Fails with `DeviceError`, `NoReplyError`; `progress` is the share that has arrived.
        """

        def steps(job: Job) -> Steps:
            doing = f"downloading {len(data)} bytes to {address:#x}"
            asked = partial(self._asked, doing, timeout_s=self.patience_s)
            begun = yield from asked(
                "BeginDownload", "DownloadBegins", method=method, widths=0x44, address=address, size=len(data)
            )
            size = begun.longest - TRANSFER_HEAD
            if size < 1:
                raise DeviceError(
                    f"{self.name}: {doing}: its longest request has {begun.longest} bytes, and no room for data"
                )
            for number, at in enumerate(range(0, len(data), size), 1):
                piece = data[at : at + size]
                arrived = yield from asked(
                    "TransferData", "DataTransferred", number=number & 0xFF, data=piece
                )
                if arrived.number != number & 0xFF:
                    raise DeviceError(
                        f"{self.name}: {doing}: piece {number & 0xFF} was sent, and {arrived.number} confirmed"
                    )
                job.progress = at / len(data)
            yield from asked("EndTransfer", "TransferEnded", data=b"")

        return self.lead("download", steps)

    # ------------------------------------------------------------------ stopping

    def assume_driven(self) -> None:
        """Assume that another program may have begun a session: a stop ends it."""
        super().assume_driven()
        self.is_engaged = True

    def stop_motion(self) -> Job | None:
        """Stop what was started and go back to the default session, before all that waits; nothing where that is so.

        What changes it in several steps does not go on.
        """
        self.end_led()
        if not self.is_engaged:
            return None
        tell = partial(self.send_now, timeout_s=self.settings.timeout_s)
        stops = [
            tell("ControlRoutine", reply=("Routine", "Refused"), action="stop", routine=number, data=b"")
            for number in sorted(self.started)
        ]
        ended = tell("ChangeSession", reply=("Session", "Refused"), session="default")
        self._is_to_confirm = True

        def steps(job: Job) -> Steps:
            refusals: list[str] = []
            for ticket in (*stops, ended):
                answer = yield ticket
                # A routine that is over, or was ended with its session, refuses to be stopped.
                if type(answer).__name__ == "Refused" and (ticket is ended or answer.reason not in OVER):
                    refusals.append(f"{ticket.message}: refused: {answer.reason}")
            if refusals:
                raise DeviceError(f"{self.name}: {', '.join(refusals)}")

        return self.job("stop", steps)

    def confirm_stopped(self) -> Job | None:
        """Return where a stop has ended a session: ask which it is in. One that does not say that has confirmed the
        stop itself.
        """
        if not self._is_to_confirm:
            return None

        def steps(job: Job) -> Steps:
            self._asks_session = True
            try:
                answer = yield self.send_now(
                    "ReadData",
                    reply=("Data", "Refused"),
                    timeout_s=self.settings.timeout_s,
                    retries=1,
                    identifiers=[ACTIVE_SESSION],
                )
            finally:
                self._asks_session = False
            if type(answer).__name__ == "Data" and answer.meta.raw[3:4] != DEFAULT_SESSION:
                self.is_engaged = True
                raise DeviceError(f"{self.name}: it says that it is in session {answer.meta.raw[3:4].hex()}")
            self._is_to_confirm = False

        return self.job("look which session it is in", steps)


EXAMPLE = """
name = "uds"
rate_hz = 20

[buses]
can = { link = "can", protocol = "uds", bitrate = 500_000 }

[devices.ENGINE]
driver = "uds"
bus = "can"
credentials = { ecu = 0 }

[devices.ENGINE.settings.identifiers]
vin = { identifier = 0xF190, type = "text", count = 17, every_s = 0 }
limit = { identifier = 0x0110, type = "u16", access = "read-write", unit = "rpm", scale = 0.25, lower = 0, upper = 8000 }
oil_pressure = { identifier = 0x0204, type = "s16", unit = "bar", scale = 0.01 }
mode = { identifier = 0x0301, type = "u8", access = "read-write", names = { eco = 0, sport = 1 } }

[devices.GEARBOX]
driver = "uds"
bus = "can"
credentials = { ecu = 1 }

[devices.GEARBOX.settings]
at_once = 2
every_s = 0.2
routines = { learn = 0x0201 }

[devices.GEARBOX.settings.identifiers]
gear = { identifier = 0x1000, type = "u8" }
oil_temperature = { identifier = 0x1001, type = "u8", unit = "°C", offset = -40 }
clutch = { identifier = 0x1002, type = "float", unit = "N·m", order = "low first" }
"""

driver = Driver(
    "uds",
    device=Uds,
    twin=UdsTwin,
    example=EXAMPLE,
    doc="An ECU by UDS: values by identifier from a table, trouble codes, sessions, seed and key, routines, downloads.",
    source="ISO 14229-1; ISO 14229-2; ISO 15765-4",
    # Whether it is there, which changes nothing.
    scan=scan_numbers(
        "uds",
        "ECU",
        "ecu",
        range(8),
        "TesterPresent",
        reply=("TesterSeen", "Refused"),
        timeout_s=TIMEOUT_S,
        retries=0,
        none=0,
        suppress=0,
    ),
    settings=described(UdsSettings),
)
