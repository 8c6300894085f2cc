"""Protocols by name or path: installed ones (see `aces_bus.plugins`), and those that files declare; a file is run as a
module once.

1. Whatever a file's own code raises becomes a `CallerError` with file and line.
2. A file that is imported already is not run again.
"""

from __future__ import annotations

import re
import sys
import warnings
from collections.abc import Sequence
from importlib import import_module
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType

from ..errors import AcesError, CallerError, UnknownNameError
from ..plugins import InstalledPoint, Plugins
from ..tracebacks import exception_text, innermost_line, shown_path
from .exchange import database_suffixes
from .protocol import Protocol

#: What was imported, by the path of its file.
loaded: dict[Path, ModuleType] = {}
_OURS = re.compile(r"[/\\]aces_(bus|protocols|devices|tools)[/\\]")


def protocol_of_file(path: str, names: Sequence[str] = ()) -> tuple[Protocol, Sequence[str]]:
    """Return the protocol that a Python file declares, and those of `names` that do not name it.

    The first name may be the variable of the protocol, which a file with several protocols needs.
    """
    module = load_file(path)
    own = Path(path).resolve()
    found = {name: value for name, value in vars(module).items() if isinstance(value, Protocol)}
    if names and names[0] in found:
        return found[names[0]], names[1:]
    declared = {p.name: p for p in found.values() if Path(p.place.file).resolve() == own} or {
        p.name: p for p in found.values()
    }
    if len(declared) == 1:
        protocol = next(iter(declared.values()))
        if names and names[0] not in protocol.dialects:
            raise UnknownNameError(f"dialect or protocol in {path}", names[0], [*protocol.dialects, *found])
        return protocol, names
    if not declared:
        raise CallerError(f"{path}: declares no Protocol at its top level")
    if names:
        raise UnknownNameError(f"protocol in {path}", names[0], found)
    raise CallerError(
        f"{path}: declares several protocols; say which: {', '.join(f'{path}:{name}' for name in found)}"
    )


def python_file(text: str) -> tuple[str, str]:
    """(path, name) of `lamp.py` or `lamp.py:NAME`; an empty path where the text is something else."""
    found = re.fullmatch(r"(.+\.py)(?::([^:@/\\]+))?", text, re.IGNORECASE)
    return (found[1], found[2] or "") if found is not None else ("", "")


def is_loaded(path: str) -> bool:
    """Return whether this program has run the file by its path."""
    return Path(path).resolve() in loaded


def load_file(path: str) -> ModuleType:
    """Run a Python file as a module; one inside a package is imported as part of it."""
    file = Path(path).resolve()
    if file not in loaded:
        if not file.is_file():
            raise CallerError(f"{path}: {'a folder, not a Python file' if file.is_dir() else 'no such file'}")
        try:
            loaded[file] = _imported(file)
        except AcesError:
            raise
        except SyntaxError as error:
            raise CallerError(f"{error.filename or path}:{error.lineno}: {error.msg}") from error
        except Exception as error:  # whatever the user's own program may raise
            at = innermost_line(error, lambda name: Path(name).resolve() == file)
            where = f"{path}:{at.lineno}" if at is not None else path
            raise CallerError(f"{where}: {exception_text(error)}") from error
    return loaded[file]


def _imported(file: Path) -> ModuleType:
    for known in list(sys.modules.values()):
        if getattr(known, "__file__", None) == str(file):
            return known
    top, parts = file.parent, [file.stem]
    while (top / "__init__.py").exists():
        parts.insert(0, top.name)
        top = top.parent
    if str(top) not in sys.path:
        sys.path.append(str(top))  # last: a file of the user's must not hide a module of ours
    if len(parts) > 1:
        module = import_module(".".join(parts))
        if module.__file__ is None or Path(module.__file__).resolve() != file:
            raise CallerError(f"{file}: Python finds another {'.'.join(parts)} first: {module.__file__}")
        return module
    name = f"aces_spec_{file.stem}_{len(loaded)}"
    spec = spec_from_file_location(name, file)
    assert spec is not None
    assert spec.loader is not None
    module = module_from_spec(spec)
    sys.modules[name] = module
    try:
        spec.loader.exec_module(module)
    except BaseException:
        del sys.modules[name]
        raise
    return module


def line_in_loaded(error: Exception) -> str | None:
    """Return `file:line` in a loaded file from which an exception comes, not from this package's own code."""
    at = innermost_line(error, lambda file: Path(file) in loaded or _OURS.search(file))
    if at is None or Path(at.filename) not in loaded:
        return None
    return f"{shown_path(at.filename)}:{at.lineno}"


#: The protocols that are installed.
PROTOCOLS = Plugins("aces_bus.protocols", "protocol", Protocol)


def list_protocols() -> dict[str, InstalledPoint]:
    """Return the installed protocols, by name, without importing them."""
    return PROTOCOLS.points()


#: Protocols of files that are known by name too, since a robot's file names them by path.
_adopted: dict[str, Protocol] = {}


def load_protocol(name: str) -> Protocol:
    """Return the installed protocol `name`, or that of a file by its path: `lamp.py` (`lamp.py:NAME` of several), `car.dbc`,
    `common.xml` and the other kinds of docs/captures.md. A warning says what of a database could not be taken over.

    Raises `UnknownNameError` with the names that exist, `CallerError` for what a file raises or cannot be read.
    """
    path, attribute = python_file(name)
    if path:
        protocol, unused = protocol_of_file(path, [attribute] if attribute else [])
        if unused:  # the only protocol of the file has another name
            raise UnknownNameError(f"protocol in {path}", attribute, [protocol.name])
        return protocol
    if name in _adopted:
        return _adopted[name]
    if not name.lower().endswith(database_suffixes()):
        _refuse_variant(name, (*database_suffixes(), ".py"))
        return PROTOCOLS.load(name)
    from .exchange.read_once import known_database

    return known_database(name, lambda imported: warnings.warn(imported.summary, stacklevel=4))


def _refuse_variant(name: str, suffixes: tuple[str, ...]) -> None:
    """Raise `CallerError` for what `-p` takes and says more than a protocol: `hubo:D08`, `common.xml:v1`."""
    found = re.fullmatch(r"(.+?)(?::([^:@/\\]+))?(?:@(.+))?", name)
    if found is None or found[1] == name:
        return
    if found[1].lower().endswith(suffixes) or found[1] in list_protocols():
        which = ", ".join(
            f"{key}={value!r}"
            for key, value in (("dialect", found[2]), ("configuration", found[3]))
            if value is not None
        )
        raise CallerError(
            f"{name}: is a protocol in one of its variants; load_protocol({found[1]!r}).variant({which}) gives it,"
            f" and decode(…, {found[1]!r}, {which}) decodes with it"
        )


def adopt_protocol(path: str) -> str:
    """Load the protocol of a Python file, and have `load_protocol` find it by its name, which is given.

    Raises `CallerError` where another protocol has this name.
    """
    protocol = load_protocol(path)
    name = protocol.name
    known = _adopted.get(name) or (load_protocol(name) if name in list_protocols() else protocol)
    if known is not protocol:
        raise CallerError(
            f"{path}: another protocol is named {name!r} already ({known.place}); rename one of them"
        )
    _adopted[name] = protocol
    return name


__all__ = [
    "PROTOCOLS",
    "adopt_protocol",
    "is_loaded",
    "line_in_loaded",
    "list_protocols",
    "load_file",
    "load_protocol",
    "protocol_of_file",
    "python_file",
]
