"""What the notebooks show is what happens."""

from __future__ import annotations

import ast
import contextlib
import io
import json
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[2]
NOTEBOOKS = sorted((ROOT / "examples" / "notebooks").glob("*.ipynb"))


def shown(source: str, names: dict[str, Any]) -> tuple[str, Any]:
    """Run a cell; return what it prints, and the value of its last line where that is an expression."""
    tree = ast.parse(source)
    last = tree.body.pop() if isinstance(tree.body[-1], ast.Expr) else None
    out = io.StringIO()
    with contextlib.redirect_stdout(out):
        exec(compile(tree, "cell", "exec"), names)
        value = None if not isinstance(last, ast.Expr) else eval(ast.unparse(last.value), names)
    return out.getvalue(), value


@pytest.mark.slow
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_shows_what_happens(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every cell runs, in order, and prints and shows what the file has; pictures are drawn where it has some."""
    pyplot = pytest.importorskip("matplotlib.pyplot")
    pytest.importorskip("pandas")
    pyplot.switch_backend("agg")
    monkeypatch.chdir(ROOT)
    names: dict[str, Any] = {}
    cells = [
        cell for cell in json.loads(path.read_text(encoding="utf-8"))["cells"] if cell["cell_type"] == "code"
    ]
    assert cells
    for cell in cells:
        kept = {output["output_type"]: output for output in cell["outputs"]}
        printed, value = shown("".join(cell["source"]), names)
        assert printed == "".join(kept.get("stream", {}).get("text", ""))
        data = kept.get("execute_result", {}).get("data", {})
        assert ("" if value is None else repr(value)) == "".join(data.get("text/plain", ""))
        if value is not None and "text/html" in data:
            assert value._repr_html_() == "".join(data["text/html"])
        assert bool(pyplot.get_fignums()) is ("display_data" in kept)
        pyplot.close("all")


def test_every_door_has_its_notebook() -> None:
    """A log, a servo, a data sheet: the README leads to each."""
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    assert [path.stem for path in NOTEBOOKS] == ["data_sheet", "log", "servo"]
    assert [path.name for path in NOTEBOOKS if f"examples/notebooks/{path.name}" not in readme] == []
