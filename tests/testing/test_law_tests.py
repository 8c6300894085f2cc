"""One line gives every law; what fails is drawn, saved and repeatable."""

from __future__ import annotations

import os
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from construct import Float32l, Int16ul, Struct

from aces_bus import load_protocol
from aces_bus.errors import CallerError, CaptureError, UnknownNameError
from aces_bus.protocol import Protocol
from aces_bus.testing import LAWS, law_tests
from aces_bus.testing.saved import load_scene

ROOT = Path(__file__).resolve().parents[2]
#: A spec whose adapter loses what is above ten.
SPEC = """
from construct import Adapter, Byte, Int16ul, Struct, this
from aces_bus.protocol import Protocol, Sum

mine = Protocol("mine", link="serial")
packet = mine.framing(sync=b"\\xaa", header=Struct("length" / Byte), size=this.length + 3, max_size=40, check=Sum())

class Clipped(Adapter):
    def _decode(self, obj, context, path):
        return min(obj, 10)

    def _encode(self, obj, context, path):
        return obj

packet("Level", payload=Struct("tank" / Byte, "level" / Clipped(Int16ul)))
"""


def _run(folder: Path, test: str, *options: str) -> subprocess.CompletedProcess[str]:
    """Run pytest on a test file, with the plug-in, also where the package is not installed anew."""
    (folder / "test_it.py").write_text(test)
    command = [
        sys.executable,
        "-m",
        "pytest",
        "-q",
        "-p",
        "no:cacheprovider",
        *("-p", "_hypothesis_pytestplugin", "-p", "aces_bus.testing.plugin"),
        "--hypothesis-seed=1",
        "test_it.py",
        *options,
    ]
    # Other plug-ins take as long to load as the tests take.
    alone = {**os.environ, "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"}
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False, env=alone)


@pytest.mark.slow
def test_a_broken_spec_fails_with_a_drawing_and_a_capture(tmp_path: Path) -> None:
    """One law fails, as a test of its own; it shows the scene, and says what repeats it."""
    (tmp_path / "my_spec.py").write_text(SPEC)
    test = 'from aces_bus.testing import law_tests\n\ntest_laws = law_tests("my_spec.py", laws=[1, 8])\n'
    done = _run(tmp_path, test, "--aces-failures", "found", "--aces-examples", "10")
    assert "1 failed, 1 passed" in done.stdout, done.stdout + done.stderr
    assert "test_laws[1-round-trip-mine-any]" in done.stdout
    assert "0000  AA 03 " in done.stdout  # the smallest packet there is
    assert "Level tank=0 level=10" in done.stdout
    (scene,) = (tmp_path / "found").glob("*.json")
    assert f"aces fuzz my_spec.py --replay found/{scene.name}" in done.stdout
    assert f"aces decode found/{scene.stem}.slog -p my_spec.py" in done.stdout
    assert (scene.with_suffix(".slog")).read_text().startswith("# aces serial capture 1\n(-) ? [6] AA03")


def a_bus() -> Protocol:
    made = Protocol("bus", link="can")
    made.message("One", id=0x10, payload=Struct("x" / Int16ul, "y" / Float32l))
    return made


@pytest.mark.parametrize(
    "damage", ["", "{}", "[]", '{"aces scene": 2}', "\x00", '{"aces scene": 1, "direction": "up"}']
)
def test_what_is_no_scene_says_so(damage: str, tmp_path: Path) -> None:
    """A file of something else is named, whatever is in it."""
    (tmp_path / "x.json").write_text(damage)
    with pytest.raises(CaptureError, match=r"x\.json: not a scene"):
        load_scene(tmp_path / "x.json")


test_of_a_protocol = law_tests(a_bus(), examples=10)
test_of_an_installed_name = law_tests("minihubo_adc", laws=[3, 6], examples=5)


@pytest.mark.slow
def test_a_test_is_made_for_each_law_wire_and_direction() -> None:
    """Streams have nine laws, CAN eight; every dialect, configuration and direction is there."""

    def cases(spec: str | Protocol) -> list[str]:
        (mark,) = law_tests(spec).pytestmark  # type: ignore[attr-defined]
        return [str(case) for case in mark.args[1]]

    assert len(cases("robotis")) == 9 * 3
    assert "3-chunking-robotis-from_device" in cases("robotis")
    assert cases(a_bus()) == [f"{law}-bus-any" for law in LAWS if not law.streams_only]
    hubo = load_protocol("hubo")
    assert len(cases("hubo")) == 8 * 3 * len(hubo.dialects) * len(hubo.configurations)


@pytest.mark.slow
def test_what_is_no_protocol_says_so(tmp_path: Path) -> None:
    """A missing file, an unknown name, an unknown law, a file without a protocol."""
    with pytest.raises(CallerError, match="no such file, neither in"):
        law_tests("nowhere_spec.py")
    with pytest.raises(UnknownNameError, match="no protocol named 'nowhere'"):
        law_tests("nowhere")
    with pytest.raises(CallerError, match="there is no law 12"):
        law_tests("robotis", laws=[12])
    (tmp_path / "empty.py").write_text("x = 1\n")
    with pytest.raises(CallerError, match="declares no Protocol"):
        law_tests(tmp_path / "empty.py")
    (tmp_path / "two.py").write_text(SPEC + "\nother = Protocol('other', link='can')\n")
    with pytest.raises(CallerError, match="say which"):
        law_tests(tmp_path / "two.py")
    assert law_tests(f"{tmp_path / 'two.py'}:mine", laws=[8]) is not None


def test_the_plug_in_costs_nothing_until_used() -> None:
    """pytest loads it everywhere, by its entry point: it imports neither Hypothesis nor anything of the core's weight."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert project["entry-points"]["pytest11"]["aces_bus"] == "aces_bus.testing.plugin"
    program = (
        "import sys, aces_bus.testing.plugin\n"
        "heavy = {'hypothesis', 'numpy', 'construct', 'msgspec', 'can', 'aces_bus.protocol'}\n"
        "print(sorted(heavy & sys.modules.keys()))"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"
