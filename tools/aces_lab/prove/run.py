"""Proofs of a whole protocol: each message in a process of its own, with limits of time and memory.

1. A process that is killed, dies or runs out of its limits proves nothing: its message is `unknown`.
2. Messages whose generated functions have equal text and which share a declaration are proved once.
3. A witness counts only when the function, run on it, differs from the reference; otherwise the message is `unknown`.
"""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from aces_bus.protocol import Message, Variant
from aces_bus.protocol.encoder import quick_encoders

from . import witness as w
from .account import Outcome
from .columns import check_columns
from .decoding import (
    Failed,
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

SECONDS, MEGABYTES = 60.0, 2048
#: Packets drawn for what is not proved.
DRAWN = 3000


@dataclass
class ProofJob:
    """One message to prove, with the others that have the same functions and declaration."""

    variant: Variant
    message: Message
    encode: Any = None
    no_encoder: str = ""
    same: list[str] = field(default_factory=list)
    #: Whether its columns are compared, too.
    with_columns: bool = False


def jobs_of(
    variants: Sequence[Variant], only: str | None = None, *, with_columns: bool = False
) -> list[ProofJob]:
    """Return the messages of some variants; equal ones are one job."""
    found: dict[Any, ProofJob] = {}
    for variant in variants:
        encoders, _, others = quick_encoders(variant)
        for name, message in variant.messages.items():
            if only is not None and name != only:
                continue
            encode = encoders.get(name)
            key = signature(variant, message, encode)
            if key not in found:
                found[key] = ProofJob(
                    variant, message, encode, others.get(name, ""), with_columns=with_columns
                )
            found[key].same.append(variant.label)
    return list(found.values())


def signature(variant: Variant, message: Message, encode: Any) -> tuple[Any, ...]:
    """Return what makes two messages one proof: the text of their functions, the constructs, and where they occur."""
    texts = [source_of(function) for function, _, _ in decoders(variant, message.name)]
    heads = tuple(
        (h.name, h.offset, h.pattern and (h.pattern.constant, _parts(h.pattern)))
        for h in message.heads_written
    )
    pattern = (message.identifier.constant, _parts(message.identifier))
    own = "" if encode is None else text_of_encoder(encode)
    return (
        *texts,
        own,
        id(message.payload),
        pattern,
        heads,
        tuple(message.lengths or ()),
        id(message.framing),
    )


def _parts(pattern: Any) -> tuple[Any, ...]:
    return tuple(
        (c.name, c.shift, c.values if isinstance(c.values, range) else tuple(c.values))
        for c in pattern.captures
    )


def text_of_encoder(encode: Any) -> str:
    """Return the text of one generated encoder."""
    import inspect

    return inspect.getsource(encode)


# ---------------------------------------------------------------------- one message


def prove_message(job: ProofJob, seconds: float = SECONDS) -> Outcome:
    """Prove one message in this process."""
    outcome = Outcome(job.variant.label, job.message.name, count=len(job.same) or 1)
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
        except Failed as failed:
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
    if job.encode is not None:
        attempt("encode", lambda s: prove_encoder(message, job.encode, s, sizes))
    elif job.no_encoder:
        outcome.add("encode", "unknown", f"construct itself builds it ({job.no_encoder})")
    for _, status, reason in scale_claims(message):
        outcome.add("scale", status, reason)
    if outcome.status == "unknown":
        _sample(job, outcome, sizes)
    outcome.seconds = time.process_time() - start
    if job.with_columns:
        outcome.columns = check_columns(job.variant, message)
    if outcome.columns is not None:
        outcome.columns.count = outcome.count
    return outcome


def _refuted(job: ProofJob, outcome: Outcome, what: str, found: Witness) -> None:
    """Enter a witness, if function and reference differ on it."""
    outcome.witness = found
    if differs(job, found, what):
        outcome.add(what, "refuted", found.what)
    else:
        outcome.add(what, "unknown", f"{found.what}, which running it does not confirm")


def differs(job: ProofJob, found: Witness, what: str = "decode") -> bool:
    """Return whether a generated function and the reference differ on a witness."""
    message = job.message
    image = w.image_of(message, found)
    if what == "encode":
        built = w.by_encoder(message, job.encode, image)
        return built is not None and built != image
    return any(
        w.text_of(w.by_function(message, function, found, image, quick=quick))
        != w.text_of(w.by_reference(message, image, raw=raw))
        for function, raw, quick in decoders(job.variant, message.name)
    )


def _sample(job: ProofJob, outcome: Outcome, sizes: Sequence[int]) -> None:
    """Draw packets for what is not proved: decoder, reference and, where it can be read, the declaration agree."""
    message = job.message
    accepted = 0
    by_meaning = True
    functions = {raw: function for function, raw, quick in decoders(job.variant, message.name) if not quick}
    for found in drawn(message, sizes, DRAWN):
        image = w.image_of(message, found)
        want = w.by_reference(message, image)
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
            except (NotProvable, AssertionError, TypeError, AttributeError):
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


def _no_container(values: dict[str, Any]) -> bool:
    return not any(isinstance(value, dict | list | tuple) for value in values.values())


# ---------------------------------------------------------------------- processes with limits


def prove_all(
    jobs: Sequence[ProofJob], workers: int, seconds: float = SECONDS, megabytes: int = MEGABYTES
) -> Iterator[Outcome]:
    """Prove jobs, each in a process of its own; yield the outcomes in the order of the jobs."""
    import multiprocessing
    from multiprocessing.connection import wait

    import z3  # imported once, before the processes part

    del z3
    if "fork" not in multiprocessing.get_all_start_methods():
        yield from (prove_message(job, seconds) for job in jobs)
        return
    context = multiprocessing.get_context("fork")
    running: dict[Any, tuple[int, Any, float]] = {}
    done: dict[int, Outcome] = {}
    following = given = 0
    while given < len(jobs):
        while following < len(jobs) and len(running) < workers:
            mine, theirs = context.Pipe(duplex=False)
            process = context.Process(
                target=_work, args=(jobs[following], theirs, seconds, megabytes), daemon=True
            )
            process.start()
            theirs.close()
            running[mine] = (following, process, time.monotonic() + 4 * seconds + 10)
            following += 1
        ready = wait(list(running), timeout=1.0)
        for pipe in [*running]:
            number, process, until = running[pipe]
            if pipe in ready:
                try:
                    done[number] = pipe.recv()
                except (EOFError, OSError):
                    done[number] = _lost(jobs[number], "its process died (memory)")
            elif time.monotonic() > until:
                process.kill()
                done[number] = _lost(jobs[number], "time limit")
            else:
                continue
            process.join(5)
            pipe.close()
            del running[pipe]
        while given in done:
            yield done.pop(given)
            given += 1


def _lost(job: ProofJob, reason: str) -> Outcome:
    outcome = Outcome(job.variant.label, job.message.name, count=len(job.same) or 1)
    outcome.add("proof", "unknown", reason)
    return outcome


def _work(job: ProofJob, pipe: Any, seconds: float, megabytes: int) -> None:
    import resource

    import z3

    resource.setrlimit(resource.RLIMIT_AS, (megabytes << 20 << 1, megabytes << 20 << 1))
    z3.set_param("memory_max_size", megabytes)
    try:
        outcome = prove_message(job, seconds)
    except Exception as error:  # a fault of ours is no proof
        outcome = _lost(job, f"{type(error).__name__}: {error}")
    pipe.send(outcome)
    pipe.close()


def hash_of(variants: Sequence[Variant]) -> str:
    """Return a hash of the generated text and the declaration of some variants, for badges."""
    digest = hashlib.sha256()
    for variant in variants:
        for name, message in variant.messages.items():
            for function, _, _ in decoders(variant, name):
                digest.update(source_of(function).encode())
            digest.update(f"{variant.label} {name} {message.plan!r} {message.identifier.describe()}".encode())
        digest.update(quick_encoders(variant)[1].encode())
    return digest.hexdigest()[:16]
