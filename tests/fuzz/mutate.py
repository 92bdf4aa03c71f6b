"""Seeded damage to bytes, text and JSON, as a broken disk, a wrong exporter or an attacker would do it."""

import json
import random
import struct
from typing import Any

NUMBERS = (
    "nan",
    "-nan",
    "inf",
    "1e300",
    "-1e300",
    "1e-300",
    "1e38",
    "0",
    "-1",
    "9" * 400,
    "9" * 5000,
    "2.5",
    "abc",
    "",
)
WIDE = (0, 1, 2**31, 2**32 - 1, 2**62, 2**63, 2**64 - 1)
WRONG: tuple[Any, ...] = (
    float("nan"),
    float("inf"),
    -float("inf"),
    1e300,
    -1e300,
    None,
    True,
    "abc",
    [],
    {},
    [[1]],
    10**50,
)
"""What no number of a camera is."""
ODD: tuple[Any, ...] = (*WRONG, 0, -1, 1e-300, 1.5, "", "../../x", "\x00", "a\nb", "\x1b[2J", [None] * 3, {"a": {}})


def broken_bytes(data: bytes, draw: random.Random) -> tuple[str, bytes]:
    """One way to damage a file; the way's name and the content."""
    kind = draw.choice(("cut", "flip", "field", "delete", "repeat", "insert", "noise", "empty", "zeros"))
    at = draw.randrange(len(data) + 1) if draw.random() < 0.5 else draw.randrange(min(len(data), 64) + 1)
    size = draw.choice((1, 2, 4, 8, 64))
    if kind == "cut":
        return kind, data[:at]
    if kind == "flip":
        changed = bytearray(data)
        for _ in range(draw.choice((1, 3, 20))):
            place = draw.randrange(len(data))
            changed[place] ^= 1 << draw.randrange(8)
        return kind, bytes(changed)
    if kind == "field":
        code = draw.choice(("<I", "<Q", "<d", "<f"))
        value = draw.choice(WIDE) if code in "<I<Q" else draw.choice((float("nan"), float("inf"), 1e30, -1e30, 0.0))
        field = struct.pack(code, value & (2**32 - 1) if code == "<I" else value)
        return kind, data[:at] + field + data[at + len(field) :]
    if kind == "delete":
        return kind, data[:at] + data[at + size :]
    if kind == "repeat":
        return kind, data[:at] + data[at : at + size] * 2 + data[at + size :]
    if kind == "insert":
        return kind, data[:at] + draw.randbytes(size) + data[at:]
    if kind == "noise":
        return kind, data[: min(at, 16)] + draw.randbytes(draw.choice((0, 16, 500)))
    return kind, b"" if kind == "empty" else bytes(len(data))


def broken_text(data: bytes, draw: random.Random) -> tuple[str, bytes]:
    """Damage to lines and words, or to bytes."""
    kind = draw.choice(("word", "word", "word", "line lost", "line twice", "latin-1", "mark", "huge line", "bytes"))
    if kind == "bytes":
        return broken_bytes(data, draw)
    lines = data.decode().split("\n")
    at = draw.randrange(len(lines))
    if kind == "word":
        words = lines[at].split(" ")
        words[draw.randrange(len(words))] = draw.choice(NUMBERS)
        lines[at] = " ".join(words)
    elif kind == "line lost":
        del lines[at]
    elif kind == "line twice":
        lines.insert(at, lines[at])
    elif kind == "huge line":
        lines.insert(at, "1 " * 50_000)
    text = "\n".join(lines)
    if kind == "latin-1":
        return kind, text.replace("view", "vi\xe9w").encode("latin-1") + b"\xe9"
    return kind, (b"\xef\xbb\xbf" if kind == "mark" else b"") + text.encode()


def paths(value: Any, found: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Where in a JSON value something can be changed."""
    below = list(value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ())
    return [(*found, key) for key, _ in below] + [p for key, inner in below for p in paths(inner, (*found, key))]


def broken_json(data: bytes, draw: random.Random, numbers: tuple[str, ...] = ()) -> tuple[str, bytes, bool]:
    """Damage to a JSON file's values, or its text; the last entry says whether the file must be refused.

    ``numbers`` are keys whose values must be numbers of cameras.
    """
    kind = draw.choice(("value", "value", "value", "number", "number", "lost", "brackets", "digits", "mark", "bytes"))
    if kind == "brackets":
        return kind, draw.choice((b"[" * 100_000, b'{"a":' * 100_000, b"[" * 100_000 + b"]" * 100_000)), True
    if kind == "digits":
        count = draw.choice((400, 5000))
        first = data.index(b": ") + 2
        return kind, data[:first] + b"1" * count + b', "x": ' + data[first:], True
    if kind == "mark":
        return kind, b"\xef\xbb\xbf" + data, False
    if kind == "bytes":
        return (*broken_bytes(data, draw), False)
    content = json.loads(data)
    known = [path for path in paths(content) if kind != "number" or path[-1] in numbers]
    if not known:
        return "brackets", b"[" * 100_000, True
    path = draw.choice(known)
    inner = content
    for key in path[:-1]:
        inner = inner[key]
    if kind == "lost":
        del inner[path[-1]]
    else:
        inner[path[-1]] = draw.choice(WRONG if kind == "number" else ODD)
    return kind, json.dumps(content).encode(), kind == "number"
