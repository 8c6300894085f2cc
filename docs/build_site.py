"""The documentation site: the repository's own pages, and pages made of specs, drivers, commands and public names.

    python docs/build_site.py [FOLDER]      # build/site/html unless named; needs the extra [docs]

1. A page is written once, where it is read on its own (README.md, docs/, a protocol's or a device's README). Links among
   them become links among the site's pages, and links to source become pages with that source.
2. Layouts, tables of registers, help texts and the reference of names are made of the code, anew each time.
3. A warning of Sphinx is an error: a link that leads nowhere fails the build. The site opens from disk, without a network.
"""

from __future__ import annotations

import argparse
import importlib
import inspect
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path, PurePosixPath
from types import ModuleType
from typing import Any

from aces_bus import list_protocols, load_protocol
from aces_bus.protocol.draw.svg import picture_svg
from aces_lab.exchange import print_markdown
from aces_tools.badges import badges_of, dated
from aces_tools.main import parser_of
from aces_tools.proofs import badge_text, read_badges
from aces_tools.verbs import summary_of, verbs

ROOT = Path(__file__).resolve().parents[1]
#: Rooms of the reference: packages whose `__all__` users import from.
PACKAGES = ["aces_bus"] + [
    f"aces_bus.{room}"
    for room in (
        "protocol",
        "recordings.write",
        "export",
        "hardware",
        "device",
        "state",
        "controller",
        "robot",
        "kinematics",
        "access",
        "runtime",
        "testing",
    )
]
#: The contents beside each page: title, and pages in the order in which they are read.
CONTENTS: dict[str, list[str]] = {
    "Start": [
        "tutorial",
        "python",
        "examples",
        "pictures",
        "coming-from",
        "faq",
        "troubleshooting",
        "glossary",
    ],
    "Protocols": [
        "language",
        "answers",
        "transports",
        "checking",
        "proofs",
        "fuzzing",
        "guessing",
        "exporting",
        "reference/index",
    ],
    "Recordings and buses": ["captures", "fleets", "comparing", "bus", "budget"],
    "Robots": [
        "devices",
        "robots",
        "urdf",
        "gymnasium",
        "states",
        "controllers",
        "running",
        "serve",
        "estop",
        "logging",
        "foxglove",
        "studio",
        "lerobot",
        "ros2",
        "twins",
        "physics",
        "device-fuzzing",
    ],
    "Catalogue": ["catalogue/protocols", "catalogue/devices"],
    "Reference": ["commands/index", "api/index", "performance"],
    "Inside": ["architecture", "plugins", "stability", "moved", "contributing", "pages"],
}
_LINK = re.compile(r"(\[(?:[^\[\]]|\[[^\]]*\])*\])\((?!https?:|mailto:)([^)#\s]*)(#[^)\s]*)?\)")
_FENCE = re.compile(r"(^```.*?^```$)", re.MULTILINE | re.DOTALL)
_IMAGES = (".png", ".svg", ".gif")
#: Pages are as wide as the lines of code in them.
_STYLE = (
    ".main { min-width: 0; } .sidebar-drawer { width: calc(50% - 37em); }"
    " .content { width: auto; flex: 0 1 68em; max-width: 68em; min-width: 0; box-sizing: border-box; }"
    " .highlight pre { font-size: 0.78em; }"
    " .content img { background: white; max-width: 100%; }\n"
)
#: Pictures that commands draw: what is below each, and the command.
PICTURES = {
    "plot": (
        "A plot of signals of a recording",
        "plot examples/captures/hubo2plus.log -p hubo@hubo2plus"
        " Encoder[board=0].position.* - Encoder[board=8].position.*",
    ),
    "unasked": (
        "A plot of a recording of which nothing is asked: the most telling signals by unit",
        "plot examples/captures/hubo2plus.log -p hubo@hubo2plus",
    ),
    "layout": ("The layout of a message", "spec show hubo Status"),
    "explain": (
        "Why a frame is decoded as it is, byte by byte",
        "spec explain hubo@hubo2plus 063#78000000FCFFFFFF",
    ),
}
#: What the live screen shows in its picture: a recording, and its protocol.
SCREEN = ("examples/captures/hubo2plus.log", "hubo@hubo2plus")


class Site:
    """The pages of a site, while they are put together in a folder."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        #: Site page (without `.md`) of each page of the repository.
        self.places: dict[Path, str] = {}
        #: Source files that a page links to, and that have one of their own.
        self.sources: dict[Path, str] = {}

    def write(self, place: str, text: str) -> None:
        path = self.folder / f"{place}.md"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")

    def take(self) -> None:
        """Take the repository's own pages."""
        own = {"README.md": "index", "CONTRIBUTING.md": "contributing", "docs/index.md": "pages"}
        own["docs/reference/README.md"] = "reference/index"
        for path in [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]:
            name = path.relative_to(ROOT).as_posix()
            self.places[path] = own.get(name, name.removeprefix("docs/").removesuffix(".md"))
        for kind in ("protocols", "devices"):
            for path in sorted((ROOT / kind / f"aces_{kind}").glob("*/README.md")):
                self.places[path] = f"catalogue/{kind}/{path.parent.name}"
        for path, place in self.places.items():
            text = self.linked(path.read_text(encoding="utf-8"), path, place)
            if place == "index":
                text += "\n" + "\n".join(map(_toctree, CONTENTS, CONTENTS.values()))
            elif place == "reference/index":
                pages = sorted(
                    p.removeprefix("reference/") for p in self.places.values() if p.startswith("reference/")
                )
                text += _toctree("", [page for page in pages if page != "index"])
            elif place.startswith("catalogue/protocols/"):
                text += self.layouts(place)
            self.write(place, text)

    def linked(self, text: str, path: Path, place: str) -> str:
        """Return a page's text with links of the site."""

        def link(found: re.Match[str]) -> str:
            label, target, anchor = found[1], found[2], found[3] or ""
            if not target:
                return found[0]
            there = (path.parent / target).resolve()
            if there.suffix in _IMAGES and there.is_file():
                return f"{label}({self._copied(there, place)})"
            if there.is_dir() and (there / "README.md") in self.places:
                there = there / "README.md"
            if there in self.places:
                return f"{label}({_way(place, self.places[there])}.md{anchor})"
            if there.is_file() and there.suffix in (".py", ".toml", ".log", "", ".sh"):
                self.sources.setdefault(
                    there, f"source/{there.relative_to(ROOT).as_posix().replace('/', '-')}"
                )
                return f"{label}({_way(place, self.sources[there])}.md)"
            return label[1:-1]

        parts = _FENCE.split(text)
        # Doctests end with an empty line, which is nothing to look at.
        return "".join(
            re.sub(r"\n\n```$", "\n```", part) if part.startswith("```") else _LINK.sub(link, part)
            for part in parts
        )

    def _copied(self, image: Path, place: str) -> str:
        to = self.folder / "pictures" / image.name
        to.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(image, to)
        return os.path.relpath(to, (self.folder / place).parent).replace(os.sep, "/")

    def layouts(self, place: str) -> str:
        """Return drawings of the messages of a protocol, from its spec."""
        name = place.rpartition("/")[2]
        if name not in list_protocols():
            return ""
        protocol = load_protocol(name)
        variant = protocol.variant()
        text = print_markdown(variant)
        for message in variant.messages.values():
            drawing = self.folder / "layouts" / name / f"{message.name}.svg"
            drawing.parent.mkdir(parents=True, exist_ok=True)
            drawing.write_text(picture_svg([message]), encoding="utf-8")
            image = f"![layout of {message.name}]({_way(place, f'layouts/{name}/{message.name}.svg')})"
            text = re.sub(
                rf"(^## {re.escape(message.name)}$(?:(?!^## ).)*?)^```(?:text)?$.*?^```$",
                lambda found, image=image: found[1] + image,  # type: ignore[misc]
                text,
                count=1,
                flags=re.MULTILINE | re.DOTALL,
            )
        body = re.sub(r"^#(?=#* )", "##", text.partition("\n")[2], flags=re.MULTILINE)
        proofs = f"Proofs: {badge_text(protocol)}.\n" if name in read_badges() else ""
        badges = f"Badges: {dated(badges_of(name))}.\n\n" if badges_of(name) else ""
        return f"\n\n## The messages of `{variant.name}`\n\n{badges}{proofs}{body}"

    def catalogue(self) -> None:
        """Write the pages that list protocols and devices."""
        for kind in ("protocols", "devices"):
            pages = [p for p in self.places.values() if p.startswith(f"catalogue/{kind}/")]
            names = [f"{kind}/{page.rpartition('/')[2]}" for page in pages]
            what = ""
            if kind == "protocols":
                known = [(name, badges_of(name)) for name in list_protocols()]
                rows = [f"| `{name}` | {dated(badges)} |" for name, badges in known]
                head = ["| protocol | badges |", "| --- | --- |"]
                what = "\n".join(
                    [
                        "Each page ends with the layouts of all messages, drawn from the spec."
                        " What a badge stands for, `aces spec badge --help` says.",
                        "",
                        *head,
                        *rows,
                    ]
                )
            self.write(f"catalogue/{kind}", f"# {kind.capitalize()}\n\n{what}\n\n{_toctree('', names)}")

    def commands(self) -> None:
        """Write the help text of each verb."""
        names = list(verbs())
        os.environ["COLUMNS"] = "88"
        for name in names:
            help_text = parser_of(name).format_help()
            self.write(f"commands/{name.replace(' ', '-')}", f"# aces {name}\n\n```text\n{help_text}```\n")
        rows = [f"| [`aces {name}`]({name.replace(' ', '-')}.md) | {summary_of(name)} |" for name in names]
        text = ["# Commands", "", "| command | what for |", "| --- | --- |", *rows, ""]
        self.write(
            "commands/index", "\n".join(text) + _toctree("", [name.replace(" ", "-") for name in names], True)
        )

    def pictures(self) -> None:
        """Write the pictures that commands draw."""
        text = ["# Pictures", ""]
        for name, (title, command) in PICTURES.items():
            path = self.folder / "pictures" / f"{name}.svg"
            path.parent.mkdir(parents=True, exist_ok=True)
            option = "-o" if command.startswith("plot ") else "--svg"
            call = [sys.executable, "-m", "aces_tools", *command.split(), option, str(path)]
            subprocess.run(call, check=True, capture_output=True, cwd=ROOT)
            text += [f"## {title}", "", "```console", f"$ aces {command} {option} {name}.svg", "```", ""]
            text += [f"![{title}](pictures/{name}.svg)", ""]
        capture, protocol = SCREEN
        path = self.folder / "pictures" / "screen.svg"
        call = [sys.executable, str(ROOT / "docs" / "screen_picture.py"), capture, protocol, str(path)]
        subprocess.run(call, check=True, capture_output=True, cwd=ROOT)
        text += [
            "## The live screen",
            "",
            "```console",
            f"$ aces sniff can0 -p {protocol} --screen",
            "```",
            "",
        ]
        text += ["![The live screen](pictures/screen.svg)", ""]
        path = self.folder / "pictures" / "quadruped.png"
        call = [sys.executable, str(ROOT / "examples" / "quadruped_walk.py"), "2.5", str(path)]
        # Without a renderer the example draws sticks; without MuJoCo there is no picture.
        ways: list[dict[str, str]] = [
            {"MUJOCO_GL": "egl", **os.environ},
            {**os.environ, "MUJOCO_GL": "disable"},
        ]
        if any(not subprocess.run(call, capture_output=True, cwd=ROOT, env=way).returncode for way in ways):
            text += [
                "## A quadruped that walks",
                "",
                "```console",
                "$ python examples/quadruped_walk.py 2.5 quadruped.png",
            ]
            text += ["```", "", "![A quadruped that walks](pictures/quadruped.png)", ""]
        self.write("pictures", "\n".join(text))

    def names(self) -> None:
        """Every public name, with its parameters and what it says of itself."""
        for package in PACKAGES:
            self.write(f"api/{package}", "\n".join(_of_package(importlib.import_module(package))))
        self.write("api/index", f"# Names in Python\n\n{_toctree('', PACKAGES)}")

    def listings(self) -> None:
        """Source files that pages link to."""
        for path, place in self.sources.items():
            kind = {".py": "python", ".toml": "toml", ".sh": "bash"}.get(path.suffix, "text")
            name, code = path.relative_to(ROOT).as_posix(), path.read_text(encoding="utf-8", errors="replace")
            lines = code.splitlines()
            more = "" if len(lines) <= 400 else f"\n({len(lines)} lines; the first 400)\n"
            shown = "\n".join(lines[:400])
            self.write(place, f"---\norphan: true\n---\n\n# {name}\n{more}\n`````{kind}\n{shown}\n`````\n")


def _toctree(caption: str, pages: list[str], is_hidden: bool = False) -> str:
    options = ([f":caption: {caption}", ":hidden:"] if caption else [":maxdepth: 1"]) + (
        [":hidden:"] if is_hidden else []
    )
    return "\n".join(["", "```{toctree}", *options, "", *pages, "```", ""])


def _way(place: str, target: str) -> str:
    """Return the relative path from one page to another."""
    return PurePosixPath(os.path.relpath(target, PurePosixPath(place).parent).replace(os.sep, "/")).as_posix()


# ---------------------------------------------------------------------- names in Python


def _of_package(module: ModuleType) -> Iterator[str]:
    yield from (f"# {module.__name__}", "", *_prose(module.__doc__), "")
    for name in module.__all__:
        thing = getattr(module, name)
        if isinstance(thing, ModuleType):
            continue
        yield from (f"## {name}", "", "```python", f"{name}{_signature(thing)}", "```", "")
        yield from (*_prose(inspect.getdoc(thing) if callable(thing) else None), "")
        if not inspect.isclass(thing):
            continue
        for member, value in sorted(vars(thing).items()):
            value = value.__func__ if isinstance(value, (classmethod, staticmethod)) else value
            if (
                not member.startswith("_")
                and (callable(value) or isinstance(value, property))
                and value.__doc__
            ):
                shown = member if isinstance(value, property) else f"{member}{_signature(value)}"
                yield from ("```python", f".{shown}", "```", "", *_prose(inspect.getdoc(value)), "")


def _signature(thing: Any) -> str:
    if not callable(thing):
        return ""
    try:
        text = str(inspect.signature(thing))
    except (TypeError, ValueError):
        return "(…)"
    return re.sub(r"\(self(?:, )?", "(", re.sub(r" at 0x[0-9a-f]+", "", text)).replace("typing.", "")


def _prose(doc: str | None) -> Iterator[str]:
    """Yield a docstring in Markdown: paragraphs unchanged, indented or typed lines as code."""
    for paragraph in re.split(r"\n\s*\n", inspect.cleandoc(doc or "")):
        lines = paragraph.splitlines()
        if any(line.startswith(("    ", ">>> ")) for line in lines):
            is_typed = any(line.startswith(">>> ") for line in lines)
            yield from (f"`````{'pycon' if is_typed else 'text'}", *lines, "`````")
        else:
            yield from (_escaped(line) for line in lines)
        yield ""


def _escaped(line: str) -> str:
    """Return a line with Markdown's signs escaped, but for `code`, and for the numbers and dashes of lists."""
    parts = re.split(r"(`[^`]*`)", line)
    return "".join(
        part if part.startswith("`") else re.sub(r"([*_<>\[\]|#$])", r"\\\1", part) for part in parts
    )


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("folder", nargs="?", default="build/site/html", help="where the site goes")
    arguments = parser.parse_args()
    folder = Path(arguments.folder).resolve()
    source = folder.parent / "source"
    shutil.rmtree(source, ignore_errors=True)
    source.mkdir(parents=True)
    shutil.copyfile(ROOT / "docs" / "conf.py", source / "conf.py")
    (source / "_static").mkdir()
    (source / "_static" / "site.css").write_text(_STYLE, encoding="utf-8")
    site = Site(source)
    site.take()
    site.catalogue()
    site.commands()
    site.pictures()
    site.names()
    site.listings()
    from sphinx.cmd.build import main as build

    status = build(
        [
            "-q",
            "-W",
            "-j",
            "auto",
            "--keep-going",
            "-b",
            "html",
            "-d",
            str(folder.parent / "doctrees"),
            str(source),
            str(folder),
        ]
    )
    if status == 0:
        print(f"{folder / 'index.html'}")
    return int(status)


if __name__ == "__main__":
    sys.exit(main())
