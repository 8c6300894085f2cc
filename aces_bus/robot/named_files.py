"""Files that a robot's file names: protocols in Python or in a database, data of drivers (EDS, tables), bodies.

1. A name is a path from the folder of the robot's file, and stays below it, whatever links are on the way.
2. A Python file that the program has run already (`--driver FILE.py`, `load_protocol`) may be anywhere; no other is run
   unless the robot is loaded.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any, Final, TypeVar

from ..errors import CallerError
from ..kinematics.bodies import body_format
from ..protocol.exchange import database_suffixes
from ..protocol.files import adopt_protocol, is_loaded, python_file

T = TypeVar("T")

#: Suffixes of the data that drivers read.
DATA: Final = (".eds", ".dcf", ".toml")


class NotRunError(CallerError):
    """A Python file that is not run, as the robot is only looked at."""


class NamedFiles:
    """The files below one folder, as names in a robot's file. With `runs_protocols` its Python files may be run."""

    def __init__(self, folder: str, *, runs_protocols: bool) -> None:
        self._folder, self._runs = folder, runs_protocols

    def protocol(self, name: str) -> str:
        """Return the name of a protocol; load it first where `name` is a file.

        Raises `NotRunError`, and `CallerError` for a file that is elsewhere or cannot be used.
        """
        file, attribute = python_file(name)
        if not file:
            return adopt_protocol(self._below(name)) if name.lower().endswith(database_suffixes()) else name
        path = os.path.join(self._folder, file)
        if not is_loaded(path):
            path = self._below(file)
            if os.path.isfile(path) and not self._runs:
                raise NotRunError(
                    f"{file} is not run here, so what depends on its protocol was not checked; --driver {path} runs it"
                )
        return adopt_protocol(f"{path}:{attribute}" if attribute else path)

    def data(self, setting: T) -> T:
        """Return a setting with the paths of its files from where the program runs; raises `CallerError`."""
        found: Any = setting
        if isinstance(setting, dict):
            found = {key: self.data(value) for key, value in setting.items()}
        elif isinstance(setting, (list, tuple)):
            found = type(setting)(map(self.data, setting))
        elif isinstance(setting, str) and setting.lower().endswith(DATA):
            found = self._below(setting)
        return found  # type: ignore[no-any-return]

    def body(self, name: str) -> str:
        """Return the name of a body; where it is a file, its path from where the program runs.

        Raises `CallerError` for a file that is elsewhere, or wrong.
        """
        found = body_format(name)
        if found is None:
            return name
        path = self._below(name)
        found.load(path)
        return path

    def physics(self, text: str) -> str:
        """Return `NAME:FILE` with the file's path from where the program runs; raises `CallerError` for one elsewhere."""
        name, colon, model = text.partition(":")
        return f"{name}:{self._below(model)}" if model else name + colon

    def _below(self, name: str) -> str:
        path, root = os.path.join(self._folder, name), Path(self._folder).resolve()
        if not Path(path).resolve().is_relative_to(root):
            raise CallerError(f"{name} leaves the folder of the robot's file; copy it to {root}")
        return path
