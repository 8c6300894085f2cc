"""Chromium without a screen, and the studio beside it as a program of its own."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Generator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

T = TypeVar("T")
#: How long the page may take for what it does at once; a busy machine's measure (s).
PATIENCE_S = 30.0
CHROMIUM, DRIVER = shutil.which("chromium"), shutil.which("chromedriver")
OPTIONS = (
    "--headless=new",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--enable-precise-memory-info",
    "--hide-scrollbars",
)


@contextmanager
def open_browser(folder: Path) -> Generator[Any]:
    """Start a browser with an empty profile in `folder`."""
    from selenium import webdriver
    from selenium.webdriver.chrome.service import Service

    options = webdriver.ChromeOptions()
    options.binary_location = str(CHROMIUM)
    for word in (*OPTIONS, f"--user-data-dir={folder / 'profile'}"):
        options.add_argument(word)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    options.add_experimental_option(
        "prefs",
        {
            "download.default_directory": str(folder),
            "profile.default_content_setting_values.automatic_downloads": 1,
        },
    )
    driver = webdriver.Chrome(options=options, service=Service(str(DRIVER)))
    try:
        yield driver
    finally:
        driver.quit()


def dress(driver: Any, width: int = 1400, height: int = 900, *, dark: bool = False) -> None:
    """Give the window a size (px), and the light or the dark of the system."""
    scheme = [{"name": "prefers-color-scheme", "value": "dark" if dark else "light"}]
    driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": scheme})
    size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
    driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)


@contextmanager
def served(*words: str, folder: Path) -> Generator[str]:
    """Run `aces studio` in `folder`; yields the address with its token."""
    errors = folder / "studio.txt"
    with errors.open("wb") as stderr:
        program = subprocess.Popen(
            [sys.executable, "-m", "aces_tools", "studio", *words, "--no-browser"],
            cwd=folder,
            stderr=stderr,
            env={**os.environ, "ACES_NOTES": "on"},
        )
    try:

        def address() -> str | None:
            assert program.poll() is None, errors.read_text(encoding="utf-8")
            lines = errors.read_text(encoding="utf-8").splitlines()
            return next((line.split()[-1] for line in lines if "?token=" in line), None)

        yield eventually(address)
    finally:
        program.send_signal(signal.SIGINT)
        assert program.wait(PATIENCE_S) == 0, errors.read_text(encoding="utf-8")


def eventually(what: Callable[[], T | bool | None]) -> T:
    """Return what a function gives once that is true; it is asked again and again."""
    until = time.monotonic() + PATIENCE_S
    while True:
        found = what()
        if found:
            return found  # type: ignore[return-value]
        assert time.monotonic() < until, "it does not come true"
        time.sleep(0.05)
