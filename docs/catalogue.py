"""The catalogue's table in README.md, made of the `manifest.toml` beside each driver, and beside each protocol without one:
`python docs/catalogue.py`.

1. A manifest says who keeps a folder (`owner`), what it promises (`level`: stable, provisional), and of each `[[device]]`
   its title, link, protocols, drivers, sources and the `oracle` that it is held against. Nothing else lists devices.
2. Badges are those of `badges.json` beside the manifest, which `aces spec badge NAME --save` writes.
3. A name links to its page; a driver without a README to its manifest.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from aces_tools.badges import LEVELS as BADGES
from aces_tools.badges import SAVED, read_saved

ROOT = Path(__file__).resolve().parent.parent
PLACE = re.compile(r"(?<=<!-- catalogue: python docs/catalogue\.py -->\n).*?(?=<!-- end -->)", re.DOTALL)
LEVELS = ("stable", "provisional")
NEEDED = ("title", "link", "protocols", "drivers", "oracle", "sources")
#: What comes without a driver, from files of others.
OTHERS = (
    "| cars, trucks, boats, drones | CAN, serial | a DBC, KCD, SYM, ARXML, EDS, `canboat.json`, a MAVLink dialect | | |"
    " cantools, canboat's records, pymavlink |"
)


def manifests() -> Iterator[tuple[Path, dict[str, Any]]]:
    """Yield the manifest of each folder of drivers, and of each protocol without one, read."""
    for path in [
        *sorted((ROOT / "devices" / "aces_devices").glob("*/manifest.toml")),
        *sorted((ROOT / "protocols" / "aces_protocols").glob("*/manifest.toml")),
    ]:
        yield path, tomllib.loads(path.read_text(encoding="utf-8"))


def faults() -> list[str]:
    """Return what is wrong with the manifests, a line each."""
    found: list[str] = []
    for path, manifest in manifests():
        name = path.parent.name
        if not manifest.get("owner"):
            found.append(f"{name}: no owner")
        if manifest.get("level") not in LEVELS:
            found.append(f"{name}: level is one of {', '.join(LEVELS)}")
        for device in manifest.get("device", ()):
            needed = [key for key in NEEDED if key != "drivers" or "devices" in path.parts[-4:]]
            found += [f"{name}: a device without {key}" for key in needed if not device.get(key)]
    return found


def _linked(names: list[str], page: Path) -> str:
    words = ", ".join(f"`{name}`" for name in names)
    return f"[{words}]({page.relative_to(ROOT).as_posix()})" if page.is_file() else words


def table() -> str:
    """Return the table: by link, then by title."""
    rows: list[tuple[int, str, str]] = []
    for path, manifest in manifests():
        for device in manifest["device"]:
            page = path.with_name("README.md")
            drivers = (
                _linked(device["drivers"], page if page.is_file() else path) if "drivers" in device else ""
            )
            protocols = ", ".join(
                _linked([name], ROOT / "protocols" / "aces_protocols" / name / "README.md")
                for name in device["protocols"]
            )
            saved = read_saved(path.with_name(SAVED)).get(device["title"])
            badges = " ".join(level for level in BADGES if saved is not None and level in saved.badges)
            cells = (device["title"], device["link"], protocols, drivers, badges, device["oracle"])
            order = 0 if device["link"].startswith("CAN") else 1
            rows.append((order, device["title"].casefold(), f"| {' | '.join(cells)} |"))
    head = [
        "| device | link | protocol | driver, twin | badges | held against |",
        "|---|---|---|---|---|---|",
    ]
    return "\n".join([*head, *(row for _, _, row in sorted(rows)), OTHERS]) + "\n"


def main() -> None:
    """Write the table anew."""
    readme = ROOT / "README.md"
    readme.write_text(PLACE.sub(lambda _: table(), readme.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    main()
