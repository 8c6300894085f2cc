"""NumPy's `.npz`: one file, one array a column, under `Message/field`.

1. Columns grow in temporary files, and are joined at the end: memory does not grow with the capture.
2. Nothing in it is a pickle: `numpy.load` reads all of it as it is.

    Encoder/time                  datetime64[ns], or timedelta64[ns] where times are not absolute; NaT where unknown
    Encoder/channel               int32, the place in the array `channels`; -1 none. Likewise `source` in `sources`
    Encoder/position.0            the values; enumerations and flags are numbers
    Encoder/position.0/absent     bool, True where there is no value; only where some are absent
    Name/name, Name/name/ends     bytes and texts (UTF-8): all joined as uint8, and where each ends (int64)
    _meta                         a text, JSON: for each message protocol, doc, and its columns' units, names, flags

The bytes of row i are `data[ends[i - 1] if i else 0 : ends[i]]`; `unpack(npz, "Name/name")` gives them as a list.
"""

from __future__ import annotations

import io
import os
import shutil
import zipfile
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from aces_bus.export.base import Buffered, Dataset, Options
from aces_bus.export.files import FilePool
from aces_bus.protocol import Variant
from aces_bus.protocol.columns.arrow import field_metadata, json_text, schema_metadata
from aces_bus.protocol.columns.layout import Block, DatasetColumn
from aces_bus.protocol.record import FieldValue

COPY = 1 << 20


class NpzExport(Buffered):
    """`walk.npz`."""

    format = "NumPy"
    suffix = ".npz"

    def __init__(self, path: str, options: Options, variants: Sequence[Variant]) -> None:
        self._pool = FilePool(path)
        super().__init__(path, options, variants)
        self._spill = f"{self.place}.columns"
        os.mkdir(self._spill)
        #: Array's name → (temporary file, dtype, items so far).
        self._arrays: dict[str, tuple[str, Any, int]] = {}
        #: Bytes so far of columns of bytes and texts.
        self._ends: dict[str, int] = {}
        #: Masks of columns in which nothing is absent so far are not kept; this is how many rows they would have.
        self._seen: dict[str, int] = {}

    def _add(self, name: str, values: Any) -> None:
        path, dtype, count = self._arrays.get(name) or (
            os.path.join(self._spill, str(len(self._arrays))),
            values.dtype,
            0,
        )
        self._arrays[name] = (path, dtype, count + len(values))
        if len(values):
            self._pool.write(path, np.ascontiguousarray(values).data.cast("B"))

    def _emit(self, dataset: Dataset, block: Block) -> None:
        for slot, (values, absent) in zip(dataset.layout.slots, block, strict=True):
            name = f"{dataset.name}/{slot.name}"
            if values.dtype == object:
                self._bytes(name, [_encoded(value) for value in values.tolist()])
            else:
                if absent is not None and slot.holds != "time" and slot.holds != "label":
                    values = np.where(absent, np.zeros(1, values.dtype), values)
                self._add(name, values)
            if slot.holds in ("time", "label"):
                continue  # NaT and -1 say so
            before = self._seen.get(name, 0)
            self._seen[name] = before + len(values)
            mask = f"{name}/absent"
            if mask in self._arrays or absent is not None:
                if mask not in self._arrays:
                    for start in range(0, before, COPY):
                        self._add(mask, np.zeros(min(COPY, before - start), bool))
                self._add(mask, np.zeros(len(values), bool) if absent is None else absent)

    def _bytes(self, name: str, values: list[bytes]) -> None:
        ends = np.cumsum(np.fromiter(map(len, values), np.int64, len(values))) + self._ends.get(name, 0)
        if len(ends):
            self._ends[name] = int(ends[-1])
        self._add(name, np.frombuffer(b"".join(values), np.uint8))
        self._add(f"{name}/ends", ends)

    def _end(self, dataset: Dataset) -> None:
        for slot in dataset.layout.slots:
            name = f"{dataset.name}/{slot.name}"
            if name not in self._arrays:  # a message that did not occur
                is_object = slot.holds in ("bytes", "text", "wide", "json")
                self._add(name, np.zeros(0, np.uint8 if is_object else self._dtype(slot)))
                if is_object:
                    self._add(f"{name}/ends", np.zeros(0, np.int64))

    @staticmethod
    def _dtype(slot: DatasetColumn) -> Any:
        return slot.dtype or {"bool": np.bool_, "label": np.int32}.get(slot.holds, np.int64)

    def _finish(self) -> None:
        super()._finish()
        self._pool.close()
        meta = {
            dataset.name: {
                **schema_metadata(dataset.layout, absolute=bool(self.absolute)),
                "columns": {slot.name: field_metadata(slot) for slot in dataset.layout.slots},
            }
            for dataset in self._all()
        }
        times = {
            f"{dataset.name}/{slot.name}"
            for dataset in self._all()
            for slot in dataset.layout.slots
            if slot.holds == "time"
        }
        with zipfile.ZipFile(self.place, "w", zipfile.ZIP_STORED) as archive:
            for name, (path, dtype, count) in self._arrays.items():
                if name in times:
                    dtype = np.dtype("M8[ns]" if self.absolute else "m8[ns]")
                with archive.open(_member(name), "w", force_zip64=True) as out:
                    header = io.BytesIO()
                    np.lib.format.write_array_header_1_0(
                        header,
                        {
                            "descr": np.lib.format.dtype_to_descr(np.dtype(dtype)),
                            "fortran_order": False,
                            "shape": (count,),
                        },
                    )
                    out.write(header.getvalue())
                    if os.path.exists(path):
                        with open(path, "rb") as column:
                            shutil.copyfileobj(column, out, COPY)
                        os.unlink(path)
            for name, value in (
                ("channels", np.array(self.labels.names, dtype=str)),
                ("sources", np.array(self.sources.names, dtype=str)),
                ("_meta", np.array(json_text(meta))),
            ):
                if name != "sources" or self.options.sources:
                    with archive.open(_member(name), "w") as out:
                        np.lib.format.write_array(out, value, allow_pickle=False)
        shutil.rmtree(self._spill, ignore_errors=True)

    def _drop(self) -> None:
        self._pool.abandon()
        shutil.rmtree(self._spill, ignore_errors=True)


def _member(name: str) -> zipfile.ZipInfo:
    return zipfile.ZipInfo(f"{name}.npy")  # dated 1980: the same values give the same file


def _encoded(value: FieldValue) -> bytes:
    return b"" if value is None else value if isinstance(value, bytes) else str(value).encode()


def unpack(arrays: Mapping[str, Any], name: str, *, text: bool = False) -> list[Any]:
    """Return a column of bytes of an `.npz` as a list, of texts with `text`; None where absent.

    >>> import numpy as np
    >>> unpack({"M/x": np.frombuffer(b"abcd", np.uint8), "M/x/ends": np.array([1, 4])}, "M/x")
    [b'a', b'bcd']
    """
    data = arrays[name].tobytes()
    ends = arrays[f"{name}/ends"].tolist()
    parts: list[Any] = (
        [data[start:end] for start, end in zip([0, *ends[:-1]], ends, strict=True)] if ends else []
    )
    if text:
        parts = [part.decode() for part in parts]
    if f"{name}/absent" in arrays:
        gone = arrays[f"{name}/absent"].tolist()
        parts = [None if away else part for part, away in zip(parts, gone, strict=True)]
    return parts


__all__ = ["NpzExport", "unpack"]
