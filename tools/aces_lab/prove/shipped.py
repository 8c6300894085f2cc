"""Prove all shipped protocols and write their badges; `make prove` runs this module."""

from __future__ import annotations

import datetime
import json
import sys
import time
from collections import Counter
from collections.abc import Sequence
from typing import Any

import z3

from aces_bus import __version__, list_protocols, load_protocol
from aces_tools.proofs import badges_path, protocol_hash, read_badges

from .account import ORDER, Outcome, summary
from .apart import prove_apart
from .run import jobs_of, prove_all

#: Processor seconds for a message: all shipped protocols take less than ten minutes on two cores.
SECONDS = 15.0


def count_text(outcomes: Sequence[Outcome]) -> str:
    """`proved 71, bounded 4`: how many messages are what."""
    counts: Counter[str] = Counter()
    for outcome in outcomes:
        counts[outcome.status] += outcome.count
    return ", ".join(f"{status} {counts[status]}" for status in ORDER if counts[status])


def prove_shipped(names: Sequence[str]) -> int:
    """Prove protocols, print their accounts and keep their badges; return 1 when something was refuted."""
    badges: dict[str, Any] = read_badges()
    path, refuted = badges_path(), False
    started = time.monotonic()
    for name in names or list_protocols():
        protocol = load_protocol(name)
        variants, begun = protocol.variants(), time.monotonic()
        outcomes = list(prove_all(jobs_of(variants), 2, SECONDS))
        relations = [outcome for variant in variants for outcome in prove_apart(variant, SECONDS)]
        used = f"{time.monotonic() - begun:.0f} s"
        print(
            f"{name}: {summary(outcomes)}\n{name}, apart and reachable: {summary(relations)}; {used}",
            flush=True,
        )
        refuted |= any(outcome.status == "refuted" for outcome in [*outcomes, *relations])
        badges[name] = {
            "summary": count_text(outcomes),
            "apart": count_text(relations),
            "date": datetime.date.today().isoformat(),
            "version": __version__,
            "z3": z3.get_version_string(),
            "hash": protocol_hash(protocol),
        }
    if path is not None:
        text = json.dumps(dict(sorted(badges.items())), indent=1, ensure_ascii=False)
        path.write_text(text + "\n", encoding="utf-8")
    print(f"all: {time.monotonic() - started:.0f} s")
    return int(refuted)


if __name__ == "__main__":
    sys.exit(prove_shipped(sys.argv[1:]))
