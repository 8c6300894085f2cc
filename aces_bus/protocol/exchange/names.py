"""Names of others as names of ours: plain Python names that nothing else has.

1. A name that can stay stays. What must change gets a trailing underscore; characters that no name has become one.
"""

from __future__ import annotations

import builtins
import keyword
import re


class PythonNames:
    """Names of files and databases as names of Python."""

    #: What generated source calls something of its own: no message may be called so.
    TAKEN_BY_CODE = frozenset(dir(builtins)) | {
        *("Any", "FlagSet", "Part", "Record", "Struct", "Unusual"),
        *("can", "construct", "degrees", "flags", "from_bytes", "re"),
    }
    #: What records have beside the fields of their payload.
    TAKEN_BY_RECORDS = frozenset({"meta"})

    @staticmethod
    def of(name: str) -> str:
        """Return the name as a Python name: `1st gear` becomes `n1st_gear`, `_x` becomes `x_`."""
        text = re.sub(r"\W", "_", name, flags=re.ASCII)
        bare = text.lstrip("_")
        text = bare + "_" * (len(text) - len(bare)) if bare else "unnamed" + "_" * bool(text)
        if text[0].isdigit():
            text = f"n{text}"
        return text

    @staticmethod
    def unused(name: str, taken: set[str]) -> str:
        """Return the name, as near as may be, that is not taken; it is taken from now on."""
        made = PythonNames.of(name)
        while made in taken or keyword.iskeyword(made) or (keyword.issoftkeyword(made) and made != "type"):
            made += "_"
        taken.add(made)
        return made

    @staticmethod
    def snake(name: str) -> str:
        """Return `NameInfo3` as `name_info3`, in ASCII."""
        return re.sub(r"\W", "_", re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", name), flags=re.ASCII).lower()
