"""The twin of an ECU that serves UDS.

1. What it does not have, not now, or not for everybody, it refuses with the reason and in the order of ISO 14229-1: service,
   session, lock, length, what is asked for.
2. A session that is not the default ends after 5 s without a request, and with it what was unlocked.
3. Values that were written and codes outlive power-off; session, lock, routines and downloads do not.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from math import inf
from random import Random
from typing import Any, ClassVar

from aces_bus.device import Twin, on
from aces_bus.errors import UnknownNameError
from aces_bus.protocol import Record
from aces_bus.protocol.record import FieldValue
from aces_bus.runtime.clock import Timer
from aces_devices.ecu_model import ecu_of
from aces_protocols.diagnostics import KINDS
from aces_protocols.uds.spec import IDENTIFIERS, RESETS, SERVICE_OF, SESSIONS, uds

from ..tables import NUMBERS, drawn_bytes
from .table import UdsValue, identifiers_of

#: A session ends without a request for so long (S3, ISO 14229-2).
SESSION_NS = 5_000_000_000
#: It answers within (s), and after `response_pending` within (s): P2 and P2* of ISO 14229-2.
P2_S, P2_STAR_S = 0.05, 5.0
#: While it takes long it says so again after (ns); below P2*.
PATIENCE_NS = 4_000_000_000
#: After so many wrong keys none is taken for so long (ns): usual, the standard leaves both to makers.
WRONG_KEYS, LOCKED_OUT_NS = 3, 10_000_000_000
SEED_SIZE = 4
#: From a reset's answer to its beginning, and how long it boots (ns). Choices.
RESET_NS, BOOT_NS = 10_000_000, 200_000_000
#: Its memory for downloads begins at 0; the longest request of a transfer. Choices.
MEMORY_SIZE, LONGEST = 0x1_0000, 0x402
#: What is refused silently when all were asked (ISO 14229-1, 7.5).
SILENT_TO_ALL = (
    "service_not_supported",
    "subfunction_not_supported",
    "out_of_range",
    "subfunction_not_in_this_session",
    "service_not_in_this_session",
)
#: Services that the default session does not have (ISO 14229-1, table 23).
NOT_IN_DEFAULT = (
    "security", "write_data", "control_routine", "begin_download", "transfer_data", "end_transfer",
)  # fmt: skip
BY_NUMBER = {number: name for name, (number, _) in IDENTIFIERS.items()}


class UdsRefusal(Exception):
    """A request is refused; the reason as the spec names it."""


def complement(level: int, seed: bytes) -> bytes:
    """Return the key of a seed as the twin wants it, until it is given another function: each byte inverted.

    >>> complement(1, b"\\x36\\x57").hex()
    'c9a8'
    """
    return bytes(byte ^ 0xFF for byte in seed)


class UdsTwin(Twin):
    """An ECU: `put("limit", 80)`, `take("limit")`, `ecu.codes`, `session`, `memory`.

    `key_of(level, seed)` makes the right key of a seed; `carry_out(action, routine, data)` is what a routine does: the bytes
    of its answer, or it raises `UdsRefusal`.
    """

    protocol = "uds"
    faults: ClassVar[Mapping[str, str]] = {
        "pending": "asks for patience before each answer, for 0.3 s (or as many as said)",
        "busy": "refuses everything: it is busy",
        "misfire": "cylinder 2 misfires: P0302 is stored",
        "forgets": "is in the default session again, and says nothing of it",
    }
    amounts: ClassVar[Mapping[str, float]] = {"pending": 0.3}
    key_of: Callable[[int, bytes], bytes] = staticmethod(complement)
    carry_out: Callable[[str, int, bytes], bytes] | None = None

    def setup(self) -> None:
        """Begin in the default session, locked. Raises `CallerError` for a wrong table."""
        settings = self.config.settings
        self.ecu = ecu_of(self.world, self.config)
        self.session = "default"
        self.table = identifiers_of(self.name, settings.get("table"), settings.get("identifiers", {}))
        self.by_number = {entry.number: entry for entry in self.table.values()}
        if "data" not in self.__dict__:
            self.data = {
                entry.number: (self._standard(entry.number) or bytes(entry.size))[: entry.size].ljust(
                    entry.size, b"\0"
                )
                for entry in self.table.values()
            }
            self.memory = bytearray(MEMORY_SIZE)
        self.level = int(settings.get("level", 0))
        self.routines = frozenset(settings.get("routines", {}).values())
        #: The level that is unlocked (0: none), the seed that was given out for one, and how many keys were wrong.
        self.unlocked = 0
        self._seed: tuple[int, bytes] | None = None
        self._wrong_keys, self._locked_until = 0, 0
        self.started: set[int] = set()
        #: Of a download: where the next piece goes, how much is missing, the number of the last piece.
        self._place = self._missing = self._number = 0
        self._is_loading = False
        self._end: Timer | None = None
        self._busy_until = 0

    def draw(self, dice: Random, share: float = 1.0) -> None:
        """Have each number hold any value of its type."""
        for one in self.table.values():
            if one.entry.type in NUMBERS and not one.entry.names:
                self.data[one.number] = drawn_bytes(dice, one.entry.type, one.size, share)

    def _value(self, name: str) -> UdsValue:
        if name not in self.table:
            raise UnknownNameError(f"value of {self.name}", name, self.table)
        return self.table[name]

    def put(self, name: str, value: Any) -> None:
        """Have a value, in its unit. Raises `UnknownNameError`, `CallerError` for what does not fit."""
        entry = self._value(name)
        self.data[entry.number] = entry.data(value)

    def take(self, name: str) -> Any:
        """Return a value, in its unit. Raises `UnknownNameError`."""
        entry = self._value(name)
        return entry.value(self.data[entry.number])

    # ------------------------------------------------------------------ every request

    @on(*(name for name, message in uds.messages.items() if message.direction == "to device"))
    def serve(self, request: Record) -> None:
        """Do it and say so, or say why not."""
        whole = type(request).__name__
        name = whole.removesuffix("All")
        service = request.service if name == "Other" else SERVICE_OF[name]
        patience = round(self.active_faults.get("pending", 0) * 1e9)
        now = self.clock.now()
        try:
            if "misfire" in self.active_faults:
                self.ecu.codes["P0302"] = {"failed", "pending", "confirmed"}
            if "forgets" in self.active_faults:
                self._begin_session("default")
            if "busy" in self.active_faults or now < self._busy_until:
                raise UdsRefusal("busy")
            answer, fields = self._carry_out(name, service, request)
        except UdsRefusal as refusal:
            if whole == name or str(refusal) not in SILENT_TO_ALL:
                self.reply("Refused", service=service, reason=str(refusal))
            return
        finally:
            self._keep_session()
        if patience:
            self._busy_until = now + patience
            for wait in range(0, patience, PATIENCE_NS):
                self.reply(
                    "Refused", delay_ns=wait + self.reply_delay_ns, service=service, reason="response_pending"
                )
        elif getattr(request, "suppress", 0):
            return
        self.reply(answer, delay_ns=patience + self.reply_delay_ns, **fields)

    def _carry_out(self, name: str, service: Any, request: Record) -> tuple[str, dict[str, FieldValue]]:
        """Return the answer's message and fields; raises `UdsRefusal`."""
        if service not in SERVICE_OF.values():
            raise UdsRefusal("service_not_supported")
        if self.session == "default" and service in NOT_IN_DEFAULT:
            raise UdsRefusal("service_not_in_this_session")
        match name:
            case "Other":
                is_report = service == "read_codes" and request.data[:1] not in (b"", b"\1", b"\2", b"\x0a")
                raise UdsRefusal("subfunction_not_supported" if is_report else "incorrect_length")
            case "ChangeSession":
                return self._change_session(request)
            case "Reset":
                return self._reset(request)
            case "TesterPresent":
                if request.none:
                    raise UdsRefusal("subfunction_not_supported")
                return "TesterSeen", {"none": 0}
            case "AccessSecurity":
                return self._access(request)
            case "ReadData":
                return self._read(request)
            case "WriteData":
                return self._write(request)
            case "ControlRoutine":
                return self._control(request)
            case "BeginDownload":
                return self._begin_download(request)
            case "TransferData":
                return self._load(request)
            case "EndTransfer":
                return self._end_download()
            case _:
                return self._send_codes(name, request)

    # ------------------------------------------------------------------ sessions

    def _begin_session(self, session: str) -> None:
        self.session, self.unlocked, self._seed = session, 0, None
        self.started.clear()
        self._is_loading = False

    def _keep_session(self) -> None:
        """Restart the session's time after a request."""
        if self._end is not None:
            self._end.cancel()
        self._end = None
        if self.session != "default" and self.is_powered:
            self._end = self.clock.call_in(SESSION_NS, lambda: self._begin_session("default"))

    def _change_session(self, request: Record) -> tuple[str, dict[str, FieldValue]]:
        if request.session not in SESSIONS:
            raise UdsRefusal("subfunction_not_supported")
        self._begin_session(str(request.session))
        return "Session", {"session": self.session, "answers_within": P2_S, "patience": P2_STAR_S}

    def _reset(self, request: Record) -> tuple[str, dict[str, FieldValue]]:
        if request.kind not in RESETS or "rapid" in str(request.kind):
            raise UdsRefusal("subfunction_not_supported")

        def boot() -> None:
            self.power(False)
            self._timers["boot"] = self.clock.call_in(BOOT_NS, lambda: self.power(True))

        self._timers["reset"] = self.clock.call_in(RESET_NS, boot)
        return "ResetBegins", {"kind": request.kind, "more": b""}

    # ------------------------------------------------------------------ the lock

    def _need_level(self) -> None:
        if self.level and self.unlocked != self.level:
            raise UdsRefusal("security_denied")

    def _access(self, request: Record) -> tuple[str, dict[str, FieldValue]]:
        """Return a seed for an odd step, and its key with the next one."""
        level = request.step - (1 - request.step % 2)
        if not self.level or level != self.level:
            raise UdsRefusal("subfunction_not_supported")
        now = self.clock.now()
        if now < self._locked_until:
            raise UdsRefusal("delay_not_over")
        if request.step % 2:
            if self.unlocked == level:
                return "Security", {"step": request.step, "data": bytes(SEED_SIZE)}
            self._seed = level, bytes(self.random.randrange(1, 256) for _ in range(SEED_SIZE))
            return "Security", {"step": request.step, "data": self._seed[1]}
        seed, self._seed = self._seed, None
        if seed is None or seed[0] != level:
            raise UdsRefusal("sequence_error")
        if request.data != self.key_of(level, seed[1]):
            self._wrong_keys += 1
            if self._wrong_keys < WRONG_KEYS:
                raise UdsRefusal("invalid_key")
            self._wrong_keys, self._locked_until = 0, now + LOCKED_OUT_NS
            raise UdsRefusal("too_many_attempts")
        self._wrong_keys, self.unlocked = 0, level
        return "Security", {"step": request.step, "data": b""}

    # ------------------------------------------------------------------ values

    def _data(self, number: int) -> bytes | None:
        """Return the bytes of a value: of the table's, else of the standard's; None: it has none."""
        entry = self.by_number.get(number)
        if entry is not None:
            return self.data[number] if entry.entry.access != "write" else None
        return self._standard(number)

    def _standard(self, number: int) -> bytes | None:
        """Return the bytes of a value that the standard knows: the session, the vehicle's number, what the engine
        measures.
        """
        kind = BY_NUMBER.get(number, "")
        if kind == "session":
            value: FieldValue = self.session
        elif kind == "vin":
            value = self.ecu.vin
        else:
            value = self.ecu.mask(KINDS[kind][0]) if kind.startswith("supported") else self.ecu.value(kind)
        return None if value is None or value == [] else bytes(IDENTIFIERS[kind][1].build(value))

    def _read(self, request: Record) -> tuple[str, dict[str, FieldValue]]:
        found = [(number, self._data(number)) for number in request.identifiers]
        data = b"".join(
            number.to_bytes(2, "big") + content for number, content in found if content is not None
        )
        if not request.identifiers:
            raise UdsRefusal("incorrect_length")
        if not data:
            raise UdsRefusal("out_of_range")
        return "Data", {"values": [{"kind": None, "data": data}]}

    def _write(self, request: Record) -> tuple[str, dict[str, FieldValue]]:
        entry = self.by_number.get(request.identifier)
        if entry is None or entry.entry.access == "read":
            raise UdsRefusal("out_of_range")
        self._need_level()
        if len(request.data) != entry.size:
            raise UdsRefusal("incorrect_length")
        value = entry.value(request.data)
        low, high = entry.entry.lower, entry.entry.upper
        if isinstance(value, int | float) and not (-inf if low is None else low) <= value <= (
            inf if high is None else high
        ):
            raise UdsRefusal("out_of_range")
        self.data[entry.number] = request.data
        return "DataWritten", {"identifier": entry.number}

    # ------------------------------------------------------------------ routines and downloads

    def _control(self, request: Record) -> tuple[str, dict[str, FieldValue]]:
        number, action = request.routine, request.action
        if action not in ("start", "stop", "results"):
            raise UdsRefusal("subfunction_not_supported")
        if number not in self.routines:
            raise UdsRefusal("out_of_range")
        self._need_level()
        if action != "start" and number not in self.started:
            raise UdsRefusal("sequence_error")
        data = b"" if self.carry_out is None else self.carry_out(str(action), number, request.data)
        if action == "start":
            self.started.add(number)
        elif action == "stop":
            self.started.discard(number)
        return "Routine", {"action": action, "routine": number, "data": data}

    def _begin_download(self, request: Record) -> tuple[str, dict[str, FieldValue]]:
        if self.session != "programming":
            raise UdsRefusal("service_not_in_this_session")
        self._need_level()
        if request.method or not request.size or request.address + request.size > MEMORY_SIZE:
            raise UdsRefusal("out_of_range")
        if self._is_loading:
            raise UdsRefusal("conditions_not_correct")
        self._is_loading, self._place, self._missing, self._number = True, request.address, request.size, 0
        return "DownloadBegins", {"width": 0x20, "longest": LONGEST}

    def _load(self, request: Record) -> tuple[str, dict[str, FieldValue]]:
        if not self._is_loading:
            raise UdsRefusal("sequence_error")
        answer = "DataTransferred", {"number": request.number, "data": b""}
        if request.number == self._number & 0xFF and self._number:
            return answer  # once more, as its answer was lost
        if request.number != (self._number + 1) & 0xFF:
            raise UdsRefusal("wrong_block_number")
        size = len(request.data)
        if size > min(self._missing, LONGEST - 2):
            raise UdsRefusal("transfer_suspended")
        self.memory[self._place : self._place + size] = request.data
        self._place, self._missing, self._number = self._place + size, self._missing - size, self._number + 1
        return answer

    def _end_download(self) -> tuple[str, dict[str, FieldValue]]:
        if not self._is_loading or self._missing:
            raise UdsRefusal("sequence_error")
        self._is_loading = False
        return "TransferEnded", {"data": b""}

    # ------------------------------------------------------------------ trouble codes

    def _send_codes(self, name: str, request: Record) -> tuple[str, dict[str, FieldValue]]:
        """Send codes with their status; their failure type is 00, which says nothing more."""
        codes = self.ecu.codes
        every = {"available": 0xFF}
        match name:
            case "CountCodes":
                count = len(self.ecu.with_status(list(request.status)))
                return "CodeCount", {**every, "format": 1, "count": count}
            case "ReadCodes":
                names = self.ecu.with_status(list(request.status))
                return "Codes", {**every, "codes": [_code(code, codes[code]) for code in names]}
            case "ReadKnownCodes":
                return "KnownCodes", {**every, "codes": [_code(code, codes[code]) for code in sorted(codes)]}
            case _:
                if request.group != 0xFFFFFF:
                    raise UdsRefusal("out_of_range")
                codes.clear()
                return "CodesCleared", {}

    # ------------------------------------------------------------------ power

    def power(self, on: bool) -> None:
        """See `Twin.power`."""
        if not on:
            self.stop()
        super().power(on)

    def stop(self) -> None:
        """End what repeats."""
        if self._end is not None:
            self._end.cancel()
        super().stop()


def _code(name: str, status: set[str]) -> dict[str, FieldValue]:
    return {"code": f"{name}-00", "status": sorted(status)}
