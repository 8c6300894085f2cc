"""Every law of a protocol as tests of pytest, in one line.

    from aces_bus.testing import law_tests

    test_laws = law_tests("my_spec.py")

1. Each law × dialect × configuration × direction is a test of its own: `test_laws[3-chunking-my_spec-to_device]`.
2. Hypothesis draws the scenes: its profile says how many, its database repeats what failed last. What fails is shrunk by
   `aces_bus.testing.fuzz`, which knows packets.
3. A failure says everything: the law, the scene drawn, the capture that was saved, the command that repeats it.
"""

from __future__ import annotations

import inspect
import shlex
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

try:
    import pytest
    from hypothesis import HealthCheck, Phase, given, settings
except ImportError as missing:
    raise ImportError(
        "aces_bus.testing.law_tests needs the extra: pip install 'aces-bus[testing]'"
    ) from missing

from ..errors import CallerError
from ..protocol.files import load_protocol, python_file
from ..protocol.protocol import Protocol
from ..tracebacks import shown_path
from .bench import Bench
from .drawing import scene_drawing
from .fuzz import judged, shrink
from .laws import LAWS, Law, Scene, Way, Wire, wires
from .plugin import FAILURES
from .saved import save_scene
from .strategies import arguments
from .trial import Trial

#: About how many bytes a scene has.
SIZE = 200


@dataclass(frozen=True)
class LawCase:
    """A law on a wire in a direction; `spec` is what the command line calls the protocol."""

    law: Law
    wire: Wire
    direction: Way
    spec: str

    def __str__(self) -> str:
        label = getattr(self.wire, "label", "wire")
        return f"{self.law}-{label}-{(self.direction or 'any').replace(' ', '_')}"


def law_tests(
    spec: str | Path | Protocol, *, laws: Iterable[int] = (), examples: int | None = None
) -> Callable[..., None]:
    """Return a test function for pytest: each law on each dialect, configuration and direction of a protocol.

    `spec` is a Python file (looked for beside the file that calls, then in the current folder; `my_spec.py:NAME` where it
    declares several protocols), the name of an installed protocol, or a `Protocol`. `laws` chooses some by number.
    `examples` is how many scenes each test draws; by default as many as Hypothesis's profile says, or `--aces-examples`.

    Raises `CallerError` when there is no such protocol.
    """
    here = Path(inspect.stack(0)[1].filename).parent
    protocol, name = _protocol(spec, here)
    chosen = set(laws)
    if unknown := chosen - {law.number for law in LAWS}:
        raise CallerError(f"there is no law {min(unknown)}; the laws are 1…{len(LAWS)}")
    cases = [
        LawCase(law, wire, direction, name)
        for law in LAWS
        if law.number in chosen or not chosen
        for wire, direction in wires(protocol)
        if not (law.streams_only and wire.link == "can")
    ]

    @pytest.mark.parametrize("law_case", cases, ids=str)
    def test_laws(law_case: LawCase, pytestconfig: pytest.Config) -> None:
        """The law holds, whatever comes over the wire."""
        __tracebackhide__ = True
        wanted = pytestconfig.getoption("aces_examples", default=None) or examples
        folder = Path(pytestconfig.getoption("aces_failures", default=None) or FAILURES)
        text = failure_of(law_case, wanted, folder)
        if text:
            pytest.fail(text, pytrace=False)

    return test_laws


def failure_of(case: LawCase, examples: int | None, folder: Path) -> str:
    """Return what breaks a law, drawn and saved into `folder`; empty when nothing was found."""
    failing: list[tuple[Any, ...]] = []

    @settings(
        max_examples=examples or settings().max_examples,
        deadline=None,
        suppress_health_check=(HealthCheck.too_slow, HealthCheck.data_too_large),
        # Shrinking is ours: it knows what a packet is.
        phases=(Phase.explicit, Phase.reuse, Phase.generate),
        print_blob=False,
    )
    @given(arguments(case.law, case.wire, case.direction, size=SIZE))
    def holds(given: tuple[Any, ...]) -> None:
        if said := judged(case.law, Trial(bench, *given)):
            failing[:] = [given]
            raise _BrokenError(said)

    bench = Bench(case.wire, case.direction)
    try:
        holds()
    except _BrokenError as broken:
        scene, *cuts = failing[0]
        return shrunk_report(case, scene, tuple(cuts[0]) if cuts else (), str(broken), folder)
    return ""


class _BrokenError(Exception):
    """A law does not hold."""


def shrunk_report(case: LawCase, scene: Scene, cuts: tuple[int, ...], said: str, folder: Path) -> str:
    """Return a failure shrunk, saved and in words."""
    trial = Trial(Bench(case.wire, case.direction), scene, cuts)
    failure = shrink(case.law, trial, said)
    saved = save_scene(folder, case.wire, case.direction, failure.scene, failure.cuts, law=case.law.number)
    drawing = scene_drawing(case.wire, case.direction, failure.scene, failure.cuts)
    return "\n".join(
        (
            str(failure),
            "",
            drawing,
            "",
            f"saved: {saved.capture}",
            f"again: aces fuzz {shlex.quote(case.spec)} --replay {shlex.quote(str(saved.scene))}",
            f"       {saved.decode_command(case.spec, case.direction)}",
        )
    )


# ---------------------------------------------------------------------- finding the protocol


def _protocol(spec: str | Path | Protocol, here: Path) -> tuple[Protocol, str]:
    """Return the protocol, and what the command line calls it."""
    if isinstance(spec, Protocol):
        place = Path(spec.place.file)
        return spec, shown_path(place.resolve()) if place.is_file() else spec.name
    text = str(spec)
    path, attribute = python_file(text)
    if not path:
        return load_protocol(text), text
    file = next((p for p in (here / path, Path(path)) if p.is_file()), None)
    if file is None:
        raise CallerError(f"{path}: no such file, neither in {here} nor in the current folder")
    text = shown_path(file.resolve()) + (f":{attribute}" if attribute else "")
    return load_protocol(text), text


__all__ = ["LawCase", "failure_of", "law_tests"]
