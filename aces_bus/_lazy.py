"""What is imported when it is first used: importing a package costs nothing, and a few frames are read without NumPy.

1. `from ._lazy import np` is `import numpy as np`, but for when. Modules that have arrays as constants import NumPy as ever,
   and are imported where they are needed.
2. Who imports the same modules in the usual way notices nothing.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from importlib import import_module
from importlib.util import find_spec, module_from_spec
from threading import RLock
from types import MappingProxyType, ModuleType
from typing import TYPE_CHECKING, Any


def lazy_names(
    package: str, places: Mapping[str, str], deprecated: Mapping[str, str] = MappingProxyType({})
) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """Return the `__getattr__` and `__dir__` of `package`; `places` maps modules to their names, with blanks between.

    `deprecated` maps names that are on their way out to those that take their place: using one warns (docs/stability.md).
    """
    home = {name: module for module, names in places.items() for name in names.split()}

    def get(name: str) -> Any:
        if name in deprecated:
            from warnings import warn

            new = deprecated[name]
            text = f"{package}.{name} is deprecated and goes with the next minor version: use {package}.{new}"
            warn(text, DeprecationWarning, stacklevel=2)
            name = new
        if name not in home:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        return getattr(import_module(home[name], package), name)

    return get, lambda: sorted(home)


class _Alias(ModuleType):
    """Another name for a module. What was asked for once is an attribute here, too."""

    def __getattr__(self, name: str) -> Any:
        found = getattr(import_module(self.__name__), name)
        setattr(self, name, found)
        return found


_RUNNING = RLock()


class _Package(ModuleType):
    """A package whose own code runs when a name is wanted that none of its modules has brought."""

    _has_run = False

    def __getattr__(self, name: str) -> Any:
        with _RUNNING:  # another thread waits for all of it
            spec = self.__spec__
            if not self._has_run and spec is not None and spec.loader is not None:
                self._has_run = True
                spec.loader.exec_module(self)
            return super().__getattribute__(name)


def import_only_modules(package: str) -> None:
    """Have modules of a top-level package imported without the package's own code, until a name of that is used."""
    spec = find_spec(package) if package not in sys.modules else None
    if spec is not None:
        module = module_from_spec(spec)
        module.__class__ = _Package
        sys.modules[package] = module


if TYPE_CHECKING:
    import numpy as np
else:
    np = _Alias("numpy")

__all__ = ["import_only_modules", "lazy_names", "np"]
