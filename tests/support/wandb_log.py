"""Reading what wandb wrote offline: LevelDB's log format, in it protocol buffers."""

import json
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from wandb.proto.wandb_internal_pb2 import Record

BLOCK, FIRST, FULL, LAST = 32768, 2, 1, 4


def records(path: Path) -> Iterator[Record]:
    content, position, parts = path.read_bytes(), 7, b""
    assert content[:4] == b":W&B"
    while position < len(content):
        left = BLOCK - position % BLOCK
        if left < 7:  # too little for a header: padding
            position += left
            continue
        length, kind = struct.unpack("<HB", content[position + 4 : position + 7])
        piece = content[position + 7 : position + 7 + length]
        parts = piece if kind in (FIRST, FULL) else parts + piece
        position += 7 + length
        if kind in (FULL, LAST):
            yield Record.FromString(parts)


def history(found: list[Record]) -> list[dict[str, Any]]:
    """What was logged, row by row; values of tables and images are mappings."""
    rows = []
    for record in found:
        if record.WhichOneof("record_type") == "history":
            row: dict[str, Any] = {}
            for item in record.history.item:
                name, *inner = item.nested_key or [item.key]
                value = json.loads(item.value_json)
                if inner:
                    row.setdefault(name, {})["/".join(inner)] = value
                else:
                    row[name] = value
            rows.append(row)
    return rows
