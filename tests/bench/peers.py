"""A straightforward C program for the same work, printed from a database: what one core can do.

1. The program is plain: read a block, walk the lines, cut the signals out of a 64-bit word, store doubles.
2. Without a compiler there is no such row, and nothing else changes.
"""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

_HEAD = r"""
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

static int8_t hex[256];
static double *column[MESSAGES][SIGNALS];
static uint32_t rows[MESSAGES];
static int64_t *stamps[MESSAGES];
/* The frame table. */
static int64_t *times;
static uint32_t *ids;
static uint8_t *lengths;
static uint64_t *words;
static uint32_t frames;

static double now(void) {
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return t.tv_sec + 1e-9 * t.tv_nsec;
}
"""

_MAIN = r"""
/* One frame: a line of the log that begins at p; returns the next line. */
static const char *line(const char *p, const char *end, int decoding) {
    const char *stop = memchr(p, '\n', end - p);
    if (!stop) return end;
    if (*p != '(') return stop + 1;
    int64_t whole = 0, part = 0;
    int digits = 0;
    for (p++; *p >= '0' && *p <= '9'; p++) whole = whole * 10 + (*p - '0');
    for (p++; *p >= '0' && *p <= '9'; p++, digits++) part = part * 10 + (*p - '0');
    for (; digits < 9; digits++) part *= 10;
    for (p += 2; *p != ' '; p++) ;
    uint32_t id = 0;
    for (p++; *p != '#'; p++) id = id << 4 | (uint32_t)hex[(uint8_t)*p];
    uint8_t data[8] = {0};
    int n = 0;
    for (p++; n < 8 && p + 1 < stop; p += 2, n++) {
        int high = hex[(uint8_t)p[0]], low = hex[(uint8_t)p[1]];
        if ((high | low) < 0) break;
        data[n] = (uint8_t)(high << 4 | low);
    }
    uint64_t w;
    memcpy(&w, data, 8);
    int64_t ns = whole * 1000000000 + part;
    if (decoding) {
        decode(id, w, ns);
    } else {
        times[frames] = ns;
        ids[frames] = id;
        lengths[frames] = (uint8_t)n;
        words[frames++] = w;
    }
    return stop + 1;
}

int main(int argc, char **argv) {
    memset(hex, -1, sizeof hex);
    for (int i = 0; i < 10; i++) hex['0' + i] = (int8_t)i;
    for (int i = 0; i < 6; i++) hex['A' + i] = hex['a' + i] = (int8_t)(10 + i);
    FILE *f = fopen(argv[1], "rb");
    if (!f) return 1;
    fseek(f, 0, SEEK_END);
    long size = ftell(f);
    rewind(f);
    char *text = malloc(size);
    if (fread(text, 1, size, f) != (size_t)size) return 1;
    uint32_t total = (uint32_t)(size / 40 + 1000), most = total / 8;
    times = malloc(8L * total), ids = malloc(4L * total), lengths = malloc(total), words = malloc(8L * total);
    for (int m = 0; m < MESSAGES; m++) {
        stamps[m] = malloc(8 * most);
        for (int s = 0; s < SIGNALS; s++) column[m][s] = malloc(8 * most);
    }
    double parse = 1e9, both = 1e9, only = 1e9;
    for (int round = 0; round < 4; round++) {
        frames = 0;
        double start = now();
        for (const char *p = text, *end = text + size; p < end;) p = line(p, end, 0);
        double middle = now();
        memset(rows, 0, sizeof rows);
        for (const char *p = text, *end = text + size; p < end;) p = line(p, end, 1);
        double last = now();
        memset(rows, 0, sizeof rows);
        for (uint32_t i = 0; i < frames; i++) decode(ids[i], words[i], times[i]);
        double done = now();
        if (middle - start < parse) parse = middle - start;
        if (last - middle < both) both = last - middle;
        if (done - last < only) only = done - last;
    }
    printf("%.9f %.9f %.9f\n", parse, both, only);
    return 0;
}
"""


def print_c(database: Any) -> str:
    """The program for a cantools database of plain and once-multiplexed messages of 8 bytes."""
    body = [
        "static void decode(uint32_t id, uint64_t w, int64_t ns) {",
        "    uint64_t b = __builtin_bswap64(w);",
    ]
    body += ["    uint32_t r;", "    switch (id) {"]
    most = 1
    for number, message in enumerate(database.messages):
        most = max(most, len(message.signals))
        body += [f"    case {message.frame_id}:", f"        r = rows[{number}]++;"]
        body.append(f"        stamps[{number}][r] = ns;")
        mux = next((s for s in message.signals if s.is_multiplexer), None)
        for index, signal in enumerate(message.signals):
            value = f"({_cut(signal)}) * {float(signal.scale)!r} + {float(signal.offset)!r}"
            store = f"column[{number}][{index}][r] = {value};"
            if signal.multiplexer_ids and mux is not None:
                store = f"if (({_cut(mux)}) == {signal.multiplexer_ids[0]}) {store}"
            body.append(f"        {store}")
        body.append("        break;")
    body += ["    }", "}"]
    head = f"#define MESSAGES {len(database.messages)}\n#define SIGNALS {most}\n{_HEAD}"
    return "\n".join([head, *body, _MAIN])


def _cut(signal: Any) -> str:
    if signal.byte_order == "little_endian":
        word, shift = "w", signal.start
    else:
        first = 8 * (signal.start // 8) + 7 - signal.start % 8
        word, shift = "b", 64 - first - signal.length
    if signal.is_signed:
        return f"(int64_t)({word} << {64 - shift - signal.length}) >> {64 - signal.length}"
    return f"{word} >> {shift} & {(1 << signal.length) - 1:#x}ULL"


def run_c(database: Any, log: Path, folder: Path) -> tuple[float, float, float] | None:
    """Seconds to parse, to parse and decode, and to decode the parsed frames, all warm; None without a compiler."""
    compiler = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
    if compiler is None:
        return None
    source, program = folder / "peer.c", folder / "peer"
    source.write_text(print_c(database))
    made = subprocess.run(
        [compiler, "-O3", "-o", program, source], capture_output=True, text=True, check=False
    )
    if made.returncode:
        return None
    done = subprocess.run([program, log], capture_output=True, text=True, check=True)
    numbers = re.findall(r"[0-9.]+", done.stdout)
    return float(numbers[0]), float(numbers[1]), float(numbers[2])


# ---------------------------------------------------------------------- polars


def _frames(path: Path) -> Any:
    import polars as pl

    lines = pl.read_csv(
        path,
        has_header=False,
        separator="\x01",
        quote_char=None,
        new_columns=["line"],
        schema={"line": pl.String},
    )
    line = pl.col("line")
    data = line.str.slice(29, 16)
    return lines.select(
        time=line.str.slice(1, 10).cast(pl.Int64) * 1_000_000_000
        + line.str.slice(12, 6).cast(pl.Int64) * 1000,
        id=line.str.slice(25, 3).str.to_integer(base=16, dtype=pl.UInt32),
        word=data.str.decode("hex", strict=False).bin.reinterpret(dtype=pl.UInt64, endianness="little"),
        big=data.str.decode("hex", strict=False).bin.reinterpret(dtype=pl.UInt64, endianness="big"),
    )


def parse(path: Path) -> int:
    """Time, identifier and data of every line."""
    return len(_frames(path))


def parse_and_decode(path: Path, database: Any) -> int:
    """Every signal of every frame as a Float64 column, one frame a message; the number of values."""
    import polars as pl

    parts = _frames(path).partition_by("id", as_dict=True)
    count = 0
    for (identifier,), part in parts.items():
        message = database.get_message_by_frame_id(identifier)
        mux = next((signal for signal in message.signals if signal.is_multiplexer), None)
        columns = {}
        for signal in message.signals:
            value = _value(signal)
            if signal.multiplexer_ids and mux is not None:
                value = pl.when(_raw(mux) == signal.multiplexer_ids[0]).then(value)
            columns[signal.name] = value
        decoded = part.select(pl.col("time"), **columns)
        count += decoded.width * len(decoded)
    return count


def _value(signal: Any) -> Any:
    import polars as pl

    return _raw(signal).cast(pl.Float64) * float(signal.scale) + float(signal.offset)


def _raw(signal: Any) -> Any:
    import polars as pl

    if signal.byte_order == "little_endian":
        word, shift = pl.col("word"), signal.start
    else:
        word, shift = pl.col("big"), 64 - (8 * (signal.start // 8) + 7 - signal.start % 8) - signal.length
    raw = (
        (word // (1 << shift)) % (1 << signal.length) if shift + signal.length < 64 else word // (1 << shift)
    )
    if signal.is_signed:
        raw = raw.cast(pl.Int64)
        raw = pl.when(raw >= 1 << signal.length - 1).then(raw - (1 << signal.length)).otherwise(raw)
    return raw
