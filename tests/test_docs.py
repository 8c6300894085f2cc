"""Examples in prose are run: what the README and the pages show is what happens."""

from __future__ import annotations

import doctest
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
#: Pages whose Python needs the files that they write before: `test_docs_console.py` runs them from the first line.
AS_TYPED = {"docs/tutorial.md"}
DOCS = sorted(path.relative_to(ROOT).as_posix() for path in (ROOT / "docs").rglob("*.md"))
#: All others, wherever they are: a new page is tested as soon as it is there.
PAGES = ["README.md", "CONTRIBUTING.md", *(page for page in DOCS if page not in AS_TYPED)]


@pytest.mark.slow
@pytest.mark.parametrize("page", PAGES)
def test_examples_in_prose_run(page: str) -> None:
    """Every `>>>` of a page gives what the page shows."""
    text = (ROOT / page).read_text(encoding="utf-8")
    parser = doctest.DocTestParser()
    # Fences are not part of the expected output.
    text = re.sub(r"^```.*$", "", text, flags=re.MULTILINE)
    test = parser.get_doctest(text, {}, page, str(ROOT / page), 0)
    result = doctest.DocTestRunner(optionflags=doctest.IGNORE_EXCEPTION_DETAIL).run(test)
    assert result.failed == 0


@pytest.mark.parametrize("page", PAGES)
def test_links_between_pages_lead_somewhere(page: str) -> None:
    """A relative link names a file that exists."""
    text = (ROOT / page).read_text(encoding="utf-8")
    for target in re.findall(r"\]\((?!https?:|#)([^)#]+)", text):
        assert ((ROOT / page).parent / target).exists(), target


def test_each_job_of_the_python_page_takes_six_lines() -> None:
    """What is typed, continued lines included."""
    jobs = re.split(r"^## ", (ROOT / "docs/python.md").read_text(encoding="utf-8"), flags=re.MULTILINE)[1:]
    typed = {job.partition("\n")[0]: len(re.findall(r"^(?:>>>|\.\.\.) ", job, re.MULTILINE)) for job in jobs}
    assert len(typed) >= 8
    assert {job: lines for job, lines in typed.items() if lines > 6} == {}


def test_every_page_has_its_place_in_the_site() -> None:
    """A page that is in no table of contents fails the build of the site, which is made less often than the tests."""
    builder = (ROOT / "docs" / "build_site.py").read_text(encoding="utf-8")
    pages = {path.stem for path in (ROOT / "docs").glob("*.md")} - {"index"}
    assert {page for page in pages if f'"{page}"' not in builder} == set()
