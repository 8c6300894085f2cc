"""What is handed out: the long description, what is compiled, names that go."""

from __future__ import annotations

import re
import sysconfig
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from aces_bus._lazy import lazy_names

hatch_build = pytest.importorskip("hatch_build", reason="needs hatchling")
ROOT = Path(__file__).resolve().parents[1]


def test_the_long_description_has_no_link_that_leads_nowhere() -> None:
    """Links between files are their words; those to the web, and everything else, stay."""
    metadata: dict[str, Any] = {}
    hatch_build.ReadmeHook(str(ROOT), {}).update(metadata)
    text, readme = metadata["readme"]["text"], (ROOT / "README.md").read_text(encoding="utf-8")
    assert metadata["readme"]["content-type"] == "text/markdown"
    assert re.findall(r"\]\((?!https?:)", text) == []
    assert text.count("](http") == readme.count("](http")
    assert "Read on: a notebook, captures, guessing" in text
    assert len(text.splitlines()) == len(readme.splitlines())
    assert hatch_build.LINK.sub(r"\1", "[`a[0]`](b.md#c) [d](https://e.f)") == "`a[0]` [d](https://e.f)"


def test_what_is_compiled_is_there() -> None:
    """Every listed module is a file, and once."""
    assert [name for name in hatch_build.MODULES if not (ROOT / name).is_file()] == []
    assert len(set(hatch_build.MODULES)) == len(hatch_build.MODULES)


def test_without_a_compiler_a_wheel_is_pure(monkeypatch: pytest.MonkeyPatch) -> None:
    """The build asks for no mypy where nothing can be compiled, and says why; on demand it fails."""
    monkeypatch.setattr(sysconfig, "get_config_var", lambda name: "no-such-compiler -O2")
    monkeypatch.delenv("ACES_BUILD", raising=False)
    told: list[str] = []

    class App:
        def display_warning(self, text: str) -> None:
            told.append(text)

    hook = hatch_build.CompiledBuildHook(str(ROOT), {}, None, None, str(ROOT), "wheel", App())
    assert hook.dependencies() == []
    data: dict[str, Any] = {"force_include": {}, "pure_python": True}
    hook.initialize("standard", data)
    assert data == {"force_include": {}, "pure_python": True}
    assert told == ["the wheel is pure Python: there is no C compiler (no-such-compiler)"]
    monkeypatch.setenv("ACES_BUILD", "compiled")
    with pytest.raises(RuntimeError, match="there is no C compiler"):
        hook.initialize("standard", data)
    hook.initialize("editable", data)


def test_a_deprecated_name_works_and_warns() -> None:
    """It is what takes its place, which the warning names; it is not listed any more."""
    package = ModuleType("aces_bus")
    get, listed = lazy_names("aces_bus", {".frames": "Frame"}, {"CanFrame": "Frame"})
    package.__getattr__ = get  # type: ignore[method-assign]
    with pytest.warns(
        DeprecationWarning, match=r"aces_bus\.CanFrame is deprecated .* use aces_bus\.Frame"
    ) as found:
        assert package.CanFrame is package.Frame
    assert found[0].filename == __file__
    assert listed() == ["Frame"]
