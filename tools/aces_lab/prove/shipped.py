"""Prove all shipped protocols and write their badges; `make prove` runs this module."""

from __future__ import annotations

import datetime
import itertools
import resource
import sys
import time
from collections import Counter
from collections.abc import Sequence

import msgspec
import z3

from aces_bus import __version__, list_protocols, load_protocol
from aces_tools.proofs import Badge, badges_path, protocol_hash, read_badges

from .account import ORDER, Outcome, summary
from .apart import ApartJob
from .run import ProofJob, jobs_of, prove_all
from .streams import StreamJob

#: Processor seconds for a message: all shipped protocols take less than ten minutes on two cores.
SECONDS = 15.0


def count_text(outcomes: Sequence[Outcome]) -> str:
    """Return `proved 71, bounded 4`: the number of messages by outcome."""
    counts: Counter[str] = Counter()
    for outcome in outcomes:
        counts[outcome.status] += outcome.count
    return ", ".join(f"{status} {counts[status]}" for status in ORDER if counts[status])


def prove_shipped(names: Sequence[str]) -> int:
    """Prove protocols, print their accounts and keep their badges; return 1 when something was refuted."""
    badges, path, refuted = read_badges(), badges_path(), False
    started = time.monotonic()
    for name in names or list_protocols():
        protocol = load_protocol(name)
        variants, begun = protocol.variants(), time.monotonic()
        parts: dict[str, Sequence[ProofJob]] = {
            "": jobs_of(variants),
            "apart and reachable": [ApartJob(variant) for variant in variants],
            "streams": [StreamJob(variant) for variant in variants if variant.link != "can"],
        }
        proved = prove_all([job for jobs in parts.values() for job in jobs], 2, SECONDS)
        found = {
            part: [one for outcomes in itertools.islice(proved, len(jobs)) for one in outcomes]
            for part, jobs in parts.items()
        }
        for part, outcomes in found.items():
            if outcomes:
                print(f"{name}{part and f', {part}'}: {summary(outcomes)}", flush=True)
        print(f"{name}: {time.monotonic() - begun:.0f} s", flush=True)
        refuted |= any(one.status == "refuted" for outcomes in found.values() for one in outcomes)
        badges[name] = Badge(
            count_text(found[""]),
            count_text(found["apart and reachable"]),
            datetime.date.today().isoformat(),
            __version__,
            z3.get_version_string(),
            protocol_hash(protocol),
            count_text(found["streams"]),
        )
    if path is not None:
        text = msgspec.json.format(msgspec.json.encode(dict(sorted(badges.items()))), indent=1)
        path.write_bytes(text + b"\n")
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    processor = used.ru_utime + used.ru_stime
    print(f"all: {time.monotonic() - started:.0f} s, {processor:.0f} s of processor time")
    return int(refuted)


if __name__ == "__main__":
    sys.exit(prove_shipped(sys.argv[1:]))
