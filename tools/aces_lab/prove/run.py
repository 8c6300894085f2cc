"""Proofs of a whole protocol: each message in a process of its own, with limits of time and memory.

1. A process that is killed, dies or runs out of its limits proves nothing: its message is `unknown`.
2. Messages whose generated functions have equal text and which share a declaration are proved once.
3. A witness counts only when the function, run on it, differs from the reference; otherwise the message is `unknown`.
"""

from __future__ import annotations

import inspect
import signal
import time
from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from aces_bus.protocol import Message, Variant
from aces_bus.protocol.declare.pattern import IdPattern
from aces_bus.protocol.encoder import quick_encoders

from . import witness as w
from .account import Outcome
from .decoding import (
    FailedClaim,
    Witness,
    decoders,
    drawn,
    proof_lengths,
    prove_decoder,
    prove_encoder,
    source_of,
)
from .meaning import meaning
from .scales import scale_claims
from .symbols import NoAnswer, NotProvable, PathSearch
from .witness import by_reference, image_of

if TYPE_CHECKING:
    from multiprocessing.connection import Connection
    from multiprocessing.context import ForkProcess

SECONDS, MEGABYTES = 60.0, 2048
#: Packets drawn for what is not proved.
DRAWN = 3000


@dataclass
class MessageJob:
    """One message to prove, with the others that have the same functions and declaration."""

    variant: Variant
    message: Message
    encode: w.Encode | None = None
    no_encoder: str = ""
    #: How many messages it stands for.
    count: int = 0
    patience: float = 2.0

    def prove(self, seconds: float) -> list[Outcome]:
        """Prove it in this process."""
        return [prove_message(self, seconds)]

    def lost(self, reason: str) -> list[Outcome]:
        """Return that nothing was proved."""
        outcome = Outcome(self.variant.label, self.message.name, count=self.count or 1)
        outcome.add("proof", "unknown", reason)
        return [outcome]


def jobs_of(variants: Sequence[Variant], only: str | None = None) -> list[MessageJob]:
    """Return the messages of some variants; equal ones are one job."""
    found: dict[tuple[Hashable, ...], MessageJob] = {}
    for variant in variants:
        encoders, _, others = quick_encoders(variant)
        for name, message in variant.messages.items():
            if only is not None and name != only:
                continue
            encode = encoders.get(name)
            key = signature(variant, message, encode)
            if key not in found:
                found[key] = MessageJob(variant, message, encode, others.get(name, ""))
            found[key].count += 1
    return list(found.values())


def signature(variant: Variant, message: Message, encode: w.Encode | None) -> tuple[Hashable, ...]:
    """Return what makes two messages one proof: the text of their functions, the constructs, and where they occur."""
    texts = [source_of(function) for function, _, _ in decoders(variant, message.name)]
    heads = tuple(
        (h.name, h.offset, h.pattern and (h.pattern.constant, _parts(h.pattern)))
        for h in message.heads_written
    )
    pattern = (message.identifier.constant, _parts(message.identifier))
    own = "" if encode is None else inspect.getsource(encode)
    return (
        *texts,
        own,
        id(message.payload),
        pattern,
        heads,
        tuple(message.lengths or ()),
        id(message.framing),
    )


def _parts(pattern: IdPattern) -> tuple[Hashable, ...]:
    return tuple(
        (c.name, c.shift, c.values if isinstance(c.values, range) else tuple(c.values))
        for c in pattern.captures
    )


# ---------------------------------------------------------------------- one message


def prove_message(job: MessageJob, seconds: float = SECONDS) -> Outcome:
    """Prove one message in this process."""
    outcome = Outcome(job.variant.label, job.message.name, count=job.count or 1)
    start = time.process_time()
    message = job.message
    sizes, bound = proof_lengths(message)
    until, share = start + seconds, seconds / 5
    functions = decoders(job.variant, message.name)

    def attempt(what: str, claim: Callable[[PathSearch], None]) -> bool:
        """Make a claim; return whether it failed with a witness."""
        search = PathSearch(min(until - time.process_time(), share))
        try:
            claim(search)
        except FailedClaim as failed:
            _refuted(job, outcome, what, failed.witness)
            return True
        except NoAnswer as reason:
            if search.accepted and search.reached >= 0:
                outcome.add(what, "bounded", f"packets of up to {search.reached} bytes, then {reason}")
            else:
                outcome.add(what, "unknown", str(reason))
        except NotProvable as reason:
            outcome.add(what, "unknown", str(reason))
        except (MemoryError, RecursionError) as error:
            outcome.add(what, "unknown", type(error).__name__)
        else:
            outcome.add(what, "bounded" if bound else "proved", bound)
        finally:
            outcome.paths += search.paths
        return False

    opaque = any(name.startswith("opaque_") for name in functions[0][0].__code__.co_names)
    if opaque:
        outcome.add("decode", "unknown", "construct itself decodes it")
    else:
        for function, raw, quick in functions:
            what = "decode" + (", raw" if raw else "") + (", quick" if quick else "")
            claim = partial(prove_decoder, message, function, sizes=sizes, raw=raw, quick=quick)
            if attempt(what, claim):
                break
    encode = job.encode
    if encode is not None:
        attempt("encode", lambda s: prove_encoder(message, encode, s, sizes))
    elif job.no_encoder:
        outcome.add("encode", "unknown", f"construct itself builds it ({job.no_encoder})")
    for scale in scale_claims(message):
        outcome.add("scale", scale.status, scale.reason)
        if scale.raw is not None:
            outcome.witness = packet_with(message, scale.field, scale.raw)
    if outcome.status == "unknown":
        _sample(job, outcome, sizes)
    outcome.seconds = time.process_time() - start
    return outcome


def packet_with(message: Message, name: str, raw: int) -> Witness | None:
    """Return a packet in which a field has a raw number; None where the field has no bits of its own."""
    places = [leaf.node.place for leaf in message.plan.leaves if leaf.path.split(".")[-1] == name]
    for found in drawn(message, proof_lengths(message)[0], DRAWN):
        if places and places[0] and max(places[0]) < 8 * len(found.data):
            data = bytearray(len(found.data))
            for weight, at in enumerate(places[0]):
                data[at // 8] |= (raw >> weight & 1) << at % 8
            witness = Witness(f"{name} has the raw number {raw}", found.key, bytes(data))
            if by_reference(message, image_of(message, witness)) is not None:
                return witness
    return None


def _refuted(job: MessageJob, outcome: Outcome, what: str, found: Witness) -> None:
    """Enter a witness, if function and reference differ on it."""
    outcome.witness = found
    if differs(job, found, what):
        outcome.add(what, "refuted", found.what)
    else:
        outcome.add(what, "unknown", f"{found.what}, which running it does not confirm")


def differs(job: MessageJob, found: Witness, what: str = "decode") -> bool:
    """Return whether a generated function and the reference differ on a witness."""
    message = job.message
    image = w.image_of(message, found)
    if what == "encode" and job.encode is not None:
        built = w.by_encoder(message, job.encode, image)
        return built is not None and built != image
    return any(
        w.text_of(w.by_function(message, function, found, image, quick=quick))
        != w.text_of(w.by_reference(message, image, raw=raw))
        for function, raw, quick in decoders(job.variant, message.name)
    )


def _sample(job: MessageJob, outcome: Outcome, sizes: Sequence[int]) -> None:
    """Draw packets for what is not proved: decoder, reference and, where it can be read, the declaration agree."""
    message = job.message
    accepted = 0
    by_meaning = True
    functions = {raw: function for function, raw, quick in decoders(job.variant, message.name) if not quick}
    for found in drawn(message, sizes, DRAWN):
        image = w.image_of(message, found)
        want = w.by_reference(message, image)
        if want is None and message.framing is not None and image == found.data:
            continue  # no packet has these bytes, and no scanner hands them over
        got = w.by_function(message, functions[True], found, image)
        if w.text_of(got) != w.text_of(want):
            outcome.witness = found
            outcome.add("drawn", "refuted", "another value than the reference's")
            return
        if by_meaning and want is not None and message.framing is None:
            try:
                parts = message.identifier.match((found.key or 0) & 0x1FFF_FFFF) or {}
                meant = meaning(message, found.data, parts, raw=True, key=found.key)
                assert meant is not None
                by_meaning = w.text_of(w.plain_meaning(meant)) == w.text_of(want) or not _no_container(meant)
            except (NoAnswer, NotProvable, AssertionError, TypeError, AttributeError):
                by_meaning = False
        if want is None:
            continue
        accepted += 1
        if message.request_fields:
            continue
        try:
            values = message.struct.parse(image, raw=True)
            again = bytes(message.struct.build(values, raw=True))
        except Exception:
            continue  # what is read and not built is said by the laws
        if again != image and "nan" not in w.text_of(want) and w.by_reference(message, again) != want:
            outcome.witness = found
            outcome.add("drawn", "refuted", "built again as other bytes")
            return
    if accepted:
        outcome.parts = [
            part
            if part.status != "unknown"
            else type(part)(part.what, "sampled", f"{part.reason}; {DRAWN} packets drawn")
            for part in outcome.parts
        ]


def _no_container(values: Mapping[str, object]) -> bool:
    return not any(isinstance(value, dict | list | tuple) for value in values.values())


# ---------------------------------------------------------------------- processes with limits


class ProofJob(Protocol):
    """What one process proves; it is ended after `patience` times the seconds that a proof may take."""

    @property
    def variant(self) -> Variant: ...

    @property
    def patience(self) -> float: ...

    def prove(self, seconds: float) -> list[Outcome]:
        """Prove it in this process, in about so many seconds of processor time."""
        ...

    def lost(self, reason: str) -> list[Outcome]:
        """Return that nothing was proved."""
        ...


def prove_all(
    jobs: Sequence[ProofJob], workers: int, seconds: float = SECONDS, megabytes: int = MEGABYTES
) -> Iterator[list[Outcome]]:
    """Prove jobs, each in a process of its own; yield the outcomes in the order of the jobs."""
    import multiprocessing
    from multiprocessing.connection import Connection, wait

    import z3  # imported once, before the processes part

    del z3
    if "fork" not in multiprocessing.get_all_start_methods():
        yield from (job.prove(seconds) for job in jobs)
        return
    context = multiprocessing.get_context("fork")
    running: dict[Connection, tuple[int, ForkProcess]] = {}
    done: dict[int, list[Outcome]] = {}
    following = given = 0
    try:
        while given < len(jobs):
            while following < len(jobs) and len(running) < workers:
                mine, theirs = context.Pipe(duplex=False)
                process = context.Process(
                    target=_work, args=(jobs[following], theirs, seconds, megabytes), daemon=True
                )
                process.start()
                theirs.close()
                running[mine] = (following, process)
                following += 1
            for pipe in wait(list(running)):
                assert isinstance(pipe, Connection)
                number, process = running.pop(pipe)
                try:
                    done[number] = pipe.recv()
                except (EOFError, OSError):
                    process.join()
                    done[number] = jobs[number].lost(_death(process.exitcode, megabytes))
                process.join()
                pipe.close()
            while given in done:
                yield done.pop(given)
                given += 1
    finally:
        for _, process in running.values():
            process.kill()


def _death(code: int | None, megabytes: int) -> str:
    """Return why a process died."""
    if code == -signal.SIGXCPU:
        return "time limit"
    return f"its process died, of {megabytes} MB or less memory (exit status {code})"


def _data_held() -> int:
    """Return how many bytes of data this process holds, as RLIMIT_DATA counts them; 0 where the system does not say."""
    try:
        status = Path("/proc/self/status").read_text(encoding="ascii", errors="replace")
    except OSError:
        return 0
    sizes = (line.split()[1] for line in status.splitlines() if line.startswith("VmData:"))
    return int(next(sizes, "0")) << 10


def _work(job: ProofJob, pipe: Connection, seconds: float, megabytes: int) -> None:
    """Prove a job within limits that the system keeps: a search stops by itself, what runs on is killed."""
    import resource

    import z3

    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent ends its processes
    held = _data_held()  # a fork begins with all that its parent holds
    most = (megabytes << 20) + held
    resource.setrlimit(resource.RLIMIT_DATA, (most, most))
    limit = int(seconds * job.patience) + 1
    resource.setrlimit(resource.RLIMIT_CPU, (limit, limit + 5))
    z3.set_param(
        "memory_max_size", megabytes * 3 // 4 + (held >> 20)
    )  # an answer `unknown`, rather than the end
    try:
        outcomes = job.prove(seconds)
    except MemoryError:
        outcomes = job.lost(f"memory limit of {megabytes} MB")
    except Exception as error:  # a fault of ours is no proof
        outcomes = job.lost(f"{type(error).__name__}: {error}")
    pipe.send(outcomes)
    pipe.close()
