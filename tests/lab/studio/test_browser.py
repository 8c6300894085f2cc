"""The studio in a real browser: `make test-studio`."""

from __future__ import annotations

import csv
import json
import math
import os
import time
from collections.abc import Generator
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from tests.lab.studio.browser import CHROMIUM, DRIVER, dress, eventually, open_browser, served

pytest.importorskip("nicegui", reason="needs NiceGUI: the extra [studio]")
pytest.importorskip("selenium", reason="needs selenium: the extra [oracles]")
if not os.environ.get("ACES_STUDIO"):
    pytest.skip("a browser is started for these: make test-studio", allow_module_level=True)
if not (CHROMIUM and DRIVER):
    pytest.skip(
        "needs chromium and chromedriver (Debian: chromium, chromium-driver)", allow_module_level=True
    )

CAPTURES = Path(__file__).resolve().parents[3] / "examples" / "captures"
HOSTILE = "<img src=x onerror=document.title='owned'>"


def texts(driver: Any, selector: str) -> list[str]:
    """Texts of all elements that a selector finds."""
    found: list[str] = driver.execute_script(
        "return [...document.querySelectorAll(arguments[0])].map((e) => e.innerText)", selector
    )
    return found


def click(driver: Any, selector: str, text: str = "") -> None:
    """Click on the first element that a selector finds, and that has this text."""
    from selenium.common.exceptions import StaleElementReferenceException

    def is_clicked() -> bool:
        try:
            found = [e for e in driver.find_elements("css selector", selector) if text in e.text]
            if found:
                found[0].click()
        except StaleElementReferenceException:  # the page was just updated
            return False
        return bool(found)

    eventually(is_clicked)


def type_in(driver: Any, selector: str, text: str) -> None:
    """Type into an input in place of what it has."""
    box = eventually(lambda: driver.find_element("css selector", selector))
    box.send_keys("\ue009a\ue000", text)  # Ctrl-A


def downloaded(folder: Path, name: str) -> bytes:
    """Content of a file that the browser saved."""
    return eventually(lambda: (folder / name).read_bytes() if (folder / name).exists() else b"")


class Page(NamedTuple):
    """A browser, the address of the studio that it may open, and the folder of both."""

    driver: Any
    url: str
    folder: Path

    def open(self, width: int = 1400, *, dark: bool = False) -> Any:
        """Open the page anew; returns the browser."""
        dress(self.driver, width, dark=dark)
        self.driver.get(self.url)
        eventually(lambda: len(texts(self.driver, "tr[data-row]")) > 10)
        return self.driver


@pytest.fixture(scope="module")
def hubo(tmp_path_factory: pytest.TempPathFactory) -> Generator[Page]:
    """A browser and a studio with a recording of Hubo 2+."""
    folder = tmp_path_factory.mktemp("hubo")
    (folder / "walk.log").write_bytes((CAPTURES / "hubo2plus.log").read_bytes())
    with served("walk.log", "-p", "hubo", folder=folder) as url, open_browser(folder) as driver:
        yield Page(driver, url, folder)


def test_traffic_shows_sorts_filters_and_saves(hubo: Page) -> None:
    """Rows have counts and decoded fields; a click on a head sorts; words of --where filter; rows and pictures are saved."""
    driver = hubo.open()
    assert "token" not in driver.current_url
    assert any("Encoder" in row and "position=" in row for row in texts(driver, "tr[data-row]"))
    click(driver, "th", "Count")
    click(driver, "th", "Count")
    eventually(lambda: texts(driver, "tr[data-row]")[0].startswith("001"))
    type_in(driver, "input", "board=3 and position.0>2000")
    eventually(lambda: {row.split()[1] for row in texts(driver, "tr[data-row]")} == {"Reference", "Encoder"})
    eventually(lambda: "--where" in texts(driver, ".studio-command")[0])
    type_in(driver, "input", "nothing=3")
    eventually(lambda: any("nothing" in text for text in texts(driver, ".studio-bar")))
    type_in(driver, "input", "tilt")
    eventually(lambda: len(texts(driver, "tr[data-row]")) == 1)
    click(driver, ".studio-foot button", "CSV")
    rows = list(csv.DictReader(downloaded(hubo.folder, "traffic.csv").decode().splitlines()))
    assert [(row["id"], row["message"], row["frames"]) for row in rows] == [("051", "Tilt", "5")]
    click(driver, ".studio-foot button", "PARQUET")
    assert downloaded(hubo.folder, "traffic.parquet").startswith(b"PAR1")
    click(driver, ".studio-foot button", "SVG")
    assert b"<svg" in downloaded(hubo.folder, "traffic.svg")
    errors = [line for line in driver.get_log("browser") if line["level"] == "SEVERE"]
    assert errors == []


def test_only_rows_in_sight_are_in_the_page(hubo: Page) -> None:
    """The page has the rows that are in sight, and others when it is scrolled."""
    driver = hubo.open()
    first = texts(driver, "tr[data-row]")
    assert len(first) < 39
    driver.execute_script("document.querySelector('.traffic').scrollTop = 1e6")
    eventually(lambda: texts(driver, "tr[data-row]")[-1] not in first)
    assert len(texts(driver, "tr[data-row]")) < 39


def test_the_page_asks_for_nothing_outside(hubo: Page) -> None:
    """All that the page loads comes from this machine."""
    driver = hubo.open()
    asked = [
        entry["params"]["request"]["url"]
        for line in driver.get_log("performance")
        if (entry := json.loads(line["message"])["message"])["method"] == "Network.requestWillBeSent"
    ]
    assert len(asked) > 5
    assert [u for u in asked if u.startswith("http") and not u.startswith("http://127.0.0.1:")] == []


def test_without_the_token_nothing_is_shown(hubo: Page) -> None:
    """A browser that has no cookie gets the reason, and no data."""
    hubo.driver.delete_all_cookies()
    hubo.driver.get(hubo.url.partition("?")[0])
    assert "no cookie" in hubo.driver.find_element("css selector", "body").text


def test_hostile_texts_stay_text(hubo: Page, tmp_path: Path) -> None:
    """Names, units and payload texts of a database or a recording are shown as they are, and run nothing."""
    (tmp_path / "evil.py").write_text(
        "from aces_bus.protocol import Protocol, Quantity, Text\n"
        "from construct import Int8ub, Struct\n"
        'evil = Protocol("evil", link="can")\n'
        f'evil.message("Spoken", id=0x10, payload=Struct("text" / Text(8)), doc="{HOSTILE}")\n'
        f'evil.message("Measured", id=0x11, payload=Struct("speed" / Quantity(Int8ub, unit="{HOSTILE}")))\n',
        encoding="utf-8",
    )
    lines = [
        f"(1.000000) <b>x</b> 010#{b'<script>'.hex().upper()}",
        "(1.100000) can0 011#05",
        "(1.200000) can0 7FF#00",
    ]
    (tmp_path / "<i>walk.log").write_text("\n".join(lines) + "\n", encoding="utf-8")
    (tmp_path / "draft.py").write_text(
        "from aces_bus.protocol import BitLayout, Protocol, Quantity, bits\n"
        'draft = Protocol("draft", link="can")\n'
        f'draft.message("Other", id=0x7FF, payload=BitLayout(1, "x" / Quantity(bits(8), unit="{HOSTILE}")))\n',
        encoding="utf-8",
    )
    driver = hubo.driver
    with served("<i>walk.log", "-p", "evil.py", "-o", "draft.py", folder=tmp_path) as url:
        driver.get(url)
        page = "\n".join(eventually(lambda: texts(driver, "tr[data-row]")))
        assert "<script>" in page
        assert HOSTILE in page
        assert "<b>x</b>" in page
        click(driver, "tr[data-row]", "7FF")
        click(driver, "button", "Run draft.py and read it")
        eventually(lambda: any(HOSTILE in line for line in texts(driver, ".bits-list tr")))
        click(driver, ".bits-list a", "edit")
        eventually(
            lambda: driver.find_element("css selector", labelled("unit")).get_attribute("value") == HOSTILE
        )
        time.sleep(0.5)  # what is run would be run by now
        assert driver.title == "aces studio"
        assert driver.find_elements("css selector", "img[src=x], .traffic script, .studio-title i") == []


@pytest.mark.parametrize("width", [1400, 800])
@pytest.mark.parametrize("dark", [False, True], ids=["light", "dark"])
def test_pages_fit_their_width(hubo: Page, width: int, dark: bool) -> None:
    """Nothing is wider than the window, in the light and in the dark; `ACES_PICTURES` names a folder for pictures."""
    driver = hubo.open(width, dark=dark)
    for view in eventually(lambda: texts(driver, ".q-tab")):
        click(driver, ".q-tab", view.strip())
        eventually(lambda: texts(driver, ".studio-command"))
        assert driver.execute_script("return document.documentElement.scrollWidth") <= width
        colour = driver.execute_script("return getComputedStyle(document.body).backgroundColor")
        assert (sum(map(int, colour[4:-1].split(","))) < 200) is dark
        if folder := os.environ.get("ACES_PICTURES"):
            time.sleep(0.5)
            shade = "dark" if dark else "light"
            driver.save_screenshot(str(Path(folder, f"{view.strip().lower()}-{width}-{shade}.png")))


# ---------------------------------------------------------------------- bits


@pytest.fixture
def car(hubo: Page, tmp_path: Path) -> Generator[Page]:
    """The browser on a recording of a drawn car, and a draft that does not exist yet."""
    write_car(tmp_path / "car.log")
    with served("car.log", "-o", "draft.py", folder=tmp_path) as url:
        yield Page(hubo.driver, url, tmp_path)


def write_car(path: Path) -> None:
    """Write a recording: an angle (int16 little, 0.1 deg), a speed (uint16 big, 0.05 m/s) and a counter at 0x123."""
    with path.open("w", encoding="ascii") as file:
        for n in range(1500):
            time_s = 1000 + n / 100
            angle = round(300 * math.sin(time_s)) & 0xFFFF
            speed = round(400 + 300 * math.sin(time_s / 3))
            file.write(
                f"({time_s:.6f}) can0 123#{angle.to_bytes(2, 'little').hex()}{speed:04x}{n % 16:02x}00\n"
            )
            file.write(f"({time_s + 0.001:.6f}) can0 200#{4 * speed:04x}\n")


def drag(driver: Any, first: int, last: int) -> None:
    """Draw with the mouse from one bit of the grid to another; again where the page has drawn the grid anew meanwhile."""
    from selenium.common.exceptions import StaleElementReferenceException
    from selenium.webdriver.common.action_chains import ActionChains

    def drawn() -> bool:
        try:
            cells = [driver.find_element("css selector", f"[data-bit='{bit}']") for bit in (first, last)]
            chain = ActionChains(driver, duration=50).move_to_element(cells[0]).click_and_hold()
            chain.move_to_element(cells[1]).pause(0.1).release().perform()
        except StaleElementReferenceException:
            ActionChains(driver).release().perform()
            return False
        return True

    eventually(drawn)


def labelled(label: str) -> str:
    return f"input[aria-label='{label}']"


def draw(driver: Any, name: str, first: int, last: int, *, scale: str = "1", unit: str = "") -> None:
    """Draw a field, fill in its form, and add it."""
    drag(driver, first, last)
    for label, text in (("name", name), ("scale", scale), ("unit", unit)):
        if text not in ("1", ""):
            type_in(driver, labelled(label), text)
    eventually(lambda: driver.find_element("css selector", labelled("name")).get_attribute("value") == name)
    time.sleep(0.3)  # the form is sent as it is typed
    click(driver, "button", "Add field")
    eventually(lambda: any(name in line for line in texts(driver, ".bits-list tr")))


def test_a_spec_is_drawn_saved_and_checked(car: Page) -> None:
    """Fields drawn over bits become a spec in the draft's file, checked; changed outside it is read by a click."""
    driver, draft = car.driver, car.folder / "draft.py"
    dress(driver)
    driver.get(car.url)
    eventually(lambda: len(texts(driver, "tr[data-row]")) == 2)
    click(driver, "tr[data-row]", "123")
    eventually(lambda: any("counter" in line for line in texts(driver, ".bits-list tr")))  # guessed
    drag(driver, 7, 8)
    assert eventually(
        lambda: driver.find_element("css selector", labelled("bits")).get_attribute("value") == "16"
    )
    click(driver, ".q-checkbox")
    draw(driver, "angle", 7, 8, scale="0.1", unit="deg")
    click(driver, ".q-btn-toggle button", "big")
    draw(driver, "speed", 23, 24, scale="0.05", unit="m/s")
    assert "speed" in texts(driver, ".bits-text")[0]
    drag(driver, 35, 32)
    if folder := os.environ.get("ACES_PICTURES"):
        time.sleep(0.5)
        driver.save_screenshot(str(Path(folder, "drawn-1400-light.png")))
    click(driver, "button", "Save and check")
    eventually(lambda: draft.exists())
    source = draft.read_text(encoding="utf-8")
    assert '"angle" / Quantity(bits(16, signed=True), unit="deg", scale=0.1)' in source
    assert '"speed" / Quantity(bits(16, order="msb"), unit="m/s", scale=0.05)' in source
    eventually(lambda: "example" in texts(driver, ".bits-text")[1])
    draft.write_text(source + "# mine\n", encoding="utf-8")
    click(driver, "button", "Run draft.py and read it")
    eventually(lambda: texts(driver, ".bits-text")[1] == "read")
    click(driver, ".q-tab", "Traffic")
    eventually(lambda: any("angle=" in row and "speed=" in row for row in texts(driver, "tr[data-row]")))
