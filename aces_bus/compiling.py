"""For the modules that `make compiled` compiles with mypyc (see `tests/compiled.py`); interpreted, it does nothing."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, TypeVar

if TYPE_CHECKING:
    from mypy_extensions import mypyc_attr
else:
    Class = TypeVar("Class", bound=type)

    def mypyc_attr(**_: Any) -> Any:
        """Say what a compiled class must allow: mypyc reads it, and wants it from there by this name."""

        def unchanged(cls: Class) -> Class:
            return cls

        return unchanged


__all__ = ["mypyc_attr"]
