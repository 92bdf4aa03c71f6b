"""Multi-threaded PNG encoder for 8-bit colour images.

The format follows the W3C's PNG specification (third edition). Every row is filtered by the Paeth predictor, which
suits photos. The filtered rows are divided into strips, which are compressed separately and joined to one zlib stream,
as in pigz. The output does not depend on the number of threads.

Axes: h height, w width.
"""

import struct
import zlib
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import torch
from jaxtyping import UInt8

LEVEL, WINDOW, MEMORY = 1, -15, 9
"""zlib's settings: the fastest level, as run lengths are found at every level; a raw stream with the largest window
(negative sign: no header); the most memory."""
STRIP = 2**20
"""Approximate size of a strip in bytes. Strips are compressed independently, which costs a few bytes for each."""
HEADER = b"\x78\x01"
"""Header of a zlib stream at the fastest levels (RFC 1950)."""


def encode_png(image: UInt8[np.ndarray, "h w 3"]) -> bytes:
    """Encode an image as a PNG file.

    Only run lengths are searched for (zlib's strategy Z_RLE). On photos this is several times as fast as a search for
    matches, and files are a few percent larger (docs/performance.md).

    Args:
        image: sRGB colours.
    """
    from gaussian_enhancer.compiled import kernel_lock
    from gaussian_enhancer.scene.image_kernels import filter_rows

    height, width, channels = image.shape
    rows = np.empty((height, 1 + channels * width), np.uint8)
    with kernel_lock:
        filter_rows(np.ascontiguousarray(image).reshape(height, channels * width), channels, rows)
    rows_per_strip = max(1, STRIP // rows.shape[1])
    strips = [rows[top : top + rows_per_strip] for top in range(0, height, rows_per_strip)]
    with ThreadPoolExecutor(torch.get_num_threads()) as pool:
        deflated_strips = list(pool.map(_deflate, strips, [strip is strips[-1] for strip in strips]))
    stream = b"".join([HEADER, *deflated_strips, struct.pack(">I", zlib.adler32(rows.data))])
    header_fields = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)  # 8-bit RGB, not interlaced
    return b"\x89PNG\r\n\x1a\n" + _chunk(b"IHDR", header_fields) + _chunk(b"IDAT", stream) + _chunk(b"IEND", b"")


def _deflate(rows: UInt8[np.ndarray, "h _"], is_last: bool) -> bytes:
    """Compress rows to a byte-aligned part of a raw deflate stream; the last part ends the stream."""
    compressor = zlib.compressobj(LEVEL, zlib.DEFLATED, WINDOW, MEMORY, zlib.Z_RLE)
    return compressor.compress(rows.data) + compressor.flush(zlib.Z_FINISH if is_last else zlib.Z_SYNC_FLUSH)


def _chunk(kind: bytes, content: bytes) -> bytes:
    return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))
