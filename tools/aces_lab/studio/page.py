"""The page: head, tabs of views, and below each view its command line, its picture and its rows.

1. A view is a file in `views/` with `VIEW`, a subclass of `StudioView`. Nothing else names it.
2. Texts of recordings, databases and specs stay text: labels escape what they show, and HTML that a view writes takes
   them through `escaped`.
3. A view is updated `RATE_HZ` times a second, and only while it is looked at.
"""

from __future__ import annotations

import csv
import html
import io
import pkgutil
import shlex
import tempfile
from abc import ABC, abstractmethod
from collections.abc import Awaitable, Callable, Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import ClassVar

from nicegui import run, ui

from aces_bus.errors import AcesError
from aces_bus.plain_text import cell_text, printable

from . import views
from .capture import TrafficRow
from .server import Studio

#: Updates of a view in a second.
RATE_HZ = 6
#: Rows that a file of rows has at most: the command line writes all.
MOST_ROWS = 1_000_000
STYLE = (Path(__file__).parent / "page.css").read_text(encoding="utf-8")


def escaped(text: object) -> str:
    """Return a text for HTML, without control characters."""
    return html.escape(printable(str(text)))


class StudioView(ABC):
    """A view in one browser tab. `build` makes its elements, `update` brings them up to date."""

    title: ClassVar[str]
    #: Views are shown in this order.
    order: ClassVar[int]

    def __init__(self, page: StudioPage) -> None:
        self.page, self.studio = page, page.studio

    @abstractmethod
    def build(self) -> None:
        """Make the elements of the view, in the element that is entered."""

    @abstractmethod
    def update(self) -> None:
        """Show what is new."""

    @abstractmethod
    def words(self) -> Sequence[str]:
        """Return the words of the command line that shows the same."""

    def show(self, row: TrafficRow) -> None:  # noqa: B027  # not every view shows a single row
        """Show a row that was chosen in another view."""

    @abstractmethod
    def save_picture(self, path: str) -> None:
        """Draw the view into a file, SVG or PNG by its suffix. Raises `CallerError`."""

    def table(self) -> Mapping[str, Sequence[object]]:
        """Return the rows of the view as columns of the same length."""
        return {}


class StudioPage:
    """One browser tab: its views, and what they share. `marks_ns` are instants that were marked."""

    def __init__(self, studio: Studio) -> None:
        self.studio = studio
        self.marks_ns: list[int] = []
        self.views: list[StudioView] = [kind(self) for kind in _kinds()]
        self._commands: dict[str, ui.label] = {}

    def build(self) -> None:
        """Make the page."""
        ui.add_css(STYLE)
        dark = ui.dark_mode(None)
        with ui.header().classes("studio-head"):
            ui.label("aces studio").classes("studio-name")
            self._title = ui.label(printable(self.studio.title)).classes("studio-title")
            self._tabs = ui.tabs().props("dense no-caps inline-label")
            with self._tabs:
                for view in self.views:
                    ui.tab(view.title)
            self._tabs.set_value(self.views[0].title)
            ui.space()
            self._state = ui.label().classes("studio-state")
            shades = {"auto": None, "light": False, "dark": True}
            ui.toggle([*shades], value="auto", on_change=lambda e: dark.set_value(shades[e.value])).props(
                "dense no-caps flat size=sm"
            ).mark("shade")
        self._notes = ui.label().classes("studio-notes")
        with ui.tab_panels(self._tabs, value=self.views[0].title, animated=False).classes("studio-panels"):
            for view in self.views:
                with ui.tab_panel(view.title).classes("studio-panel"):
                    view.build()
                    self._foot(view)
        self._tabs.on_value_change(self.update)
        ui.timer(1 / RATE_HZ, self.update)

    def _foot(self, view: StudioView) -> None:
        with ui.row().classes("studio-foot"):
            self._commands[view.title] = ui.label().classes("studio-command")
            copy = ui.button("Copy", on_click=lambda: ui.clipboard.write(shlex.join(view.words())))
            copy.tooltip("copy the command line")
            buttons = [copy]
            for suffix in ("svg", "png"):
                if type(view).save_picture is not StudioView.save_picture:
                    buttons.append(
                        ui.button(suffix.upper(), on_click=self._saving(self._picture, view, suffix))
                    )
            for suffix in ("csv", "parquet"):
                if type(view).table is not StudioView.table:
                    buttons.append(ui.button(suffix.upper(), on_click=self._saving(self._rows, view, suffix)))
            for button in buttons:
                button.props("dense flat no-caps size=sm")

    @property
    def current(self) -> StudioView:
        """The view that is looked at."""
        return next(view for view in self.views if view.title == self._tabs.value)

    def choose(self, row: TrafficRow) -> None:
        """Show a row in the first view that shows a single row."""
        view = next((view for view in self.views if type(view).show is not StudioView.show), None)
        if view is not None:
            self._tabs.set_value(view.title)
            view.show(row)

    def update(self) -> None:
        """Show what is new in the view that is looked at."""
        studio, view = self.studio, self.current
        capture = studio.capture
        state = "live" if capture.is_live and not capture.is_done else "" if capture.is_done else "reading …"
        unit = "frames" if not any(row.identifier.key < 0 for row in capture.rows) else "packets"
        self._state.set_text(f"{state}  {capture.frames:,} {unit}")
        notes = [*capture.notes]
        if capture.left_out:
            notes.append(f"bytes of the oldest {capture.left_out:,} {unit} are no longer kept")
        if capture.beyond:
            notes.append(f"{capture.beyond:,} frames of more identifiers have no row")
        self._notes.set_text(printable("; ".join(notes)))
        self._notes.set_visibility(bool(notes))
        view.update()
        self._commands[view.title].set_text(printable(shlex.join(view.words())))

    # ------------------------------------------------------------------ what is saved

    def _saving(
        self, make: Callable[[StudioView, str], bytes], view: StudioView, suffix: str
    ) -> Callable[[], Awaitable[None]]:
        async def save() -> None:
            try:
                content = await run.io_bound(make, view, suffix)
            except AcesError as error:
                self.say(str(error))
                return
            ui.download.content(content or b"", f"{view.title.lower()}.{suffix}")

        return save

    def say(self, text: str) -> None:
        """Show a message for some seconds."""
        ui.notify(printable(text), position="bottom", multi_line=True, timeout=8000)

    @staticmethod
    def _picture(view: StudioView, suffix: str) -> bytes:
        with tempfile.TemporaryDirectory(prefix="aces-studio-") as folder:
            path = Path(folder, f"picture.{suffix}")
            view.save_picture(str(path))
            return path.read_bytes()

    @staticmethod
    def _rows(view: StudioView, suffix: str) -> bytes:
        columns = {name: column[:MOST_ROWS] for name, column in view.table().items()}
        if suffix == "csv":
            text = io.StringIO()
            writer = csv.writer(text)
            writer.writerow(map(cell_text, columns))
            for row in zip(*columns.values(), strict=True):
                writer.writerow(cell_text(cell) if isinstance(cell, str) else cell for cell in row)
            return text.getvalue().encode("utf-8")
        return _parquet(columns)


def _parquet(columns: Mapping[str, Sequence[object]]) -> bytes:
    from aces_bus.errors import CallerError

    try:
        import pyarrow as arrow
        import pyarrow.parquet as parquet
    except ImportError as missing:
        raise CallerError(f"Parquet needs pyarrow: pip install 'aces-bus[columns]' ({missing})") from None
    sink = arrow.BufferOutputStream()
    parquet.write_table(arrow.table(dict(columns)), sink, compression="zstd")
    content: bytes = sink.getvalue().to_pybytes()
    return content


def _kinds() -> list[type[StudioView]]:
    """Return the classes of the views, in their order."""
    names = [module.name for module in pkgutil.iter_modules(views.__path__)]
    found: list[type[StudioView]] = [import_module(f"{views.__name__}.{name}").VIEW for name in names]
    return sorted(found, key=lambda kind: kind.order)


def add_page(studio: Studio) -> None:
    """Declare the page at the root; each browser tab gets one of its own."""

    @ui.page("/")
    def page() -> None:
        StudioPage(studio).build()
