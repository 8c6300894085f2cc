"""Lists of items in a form of their own, which no word of the language says: a construct that a spec writes itself.

1. What is inside is declared all the same: columns, pictures and conditions know the values by name.
2. The construct decodes and builds; generated code does not.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import construct as c


class ItemList(c.Construct):
    """Items up to the end of the payload, by a construct of your own: subclass it, with `_parse` and `_build`.

    `_parse` gives a list of containers with `kind`, `data` and `reason`, as `Items` does: None for a good item, else why it
    was not read. The data of good items may be containers of values by name. `values` are these names, each with its number,
    its unit ("" for none) and the names of its values, {} for none; None says that it is measured, and always a float. A
    table has a column of each, `FIELD.NAME`: the first one in each packet.

        class Runs(ItemList):
            values = {"position": (1, "turn", None), "mode": (0, "", {0: "stopped", 10: "position"})}
    """

    values: ClassVar[Mapping[str, tuple[int, str, Mapping[int, str] | None]]] = {}

    def _sizeof(self, context: object, path: str) -> int:
        raise c.SizeofError("depends on the items", path=path)
