"""PNG files of 8-bit colour images, compressed by all threads at once.

The format is that of the W3C's PNG specification (third edition). Every row is filtered by Paeth's predictor, which
suits photos. The filtered rows are cut into strips, which are compressed separately and joined to one zlib stream, as
pigz does. What is written does not depend on the number of threads.

Axes: h height, w width.
"""

import struct
import zlib
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import torch
from jaxtyping import UInt8

LEVEL, WINDOW, MEMORY = 1, -15, 9
"""zlib's settings: run lengths are found at every level; a raw stream of the largest window; most memory."""
STRIP = 2**20
"""Bytes of a strip. A strip does not see the one before it, which costs some bytes each."""
HEADER = b"\x78\x01"
"""Of a zlib stream of the fastest levels (RFC 1950)."""


def encode_png(image: UInt8[np.ndarray, "h w 3"]) -> bytes:
    """The PNG file of an image.

    Run lengths alone are searched for (zlib's strategy Z_RLE): on photos several times as fast as a search for matches,
    and files are a few percent larger (docs/performance.md).

    Args:
        image: sRGB colours.
    """
    from gaussian_enhancer.scene.image_kernels import filter_rows
    from gaussian_enhancer.splat.compiled import kernel_lock

    height, width, channels = image.shape
    rows = np.empty((height, 1 + channels * width), np.uint8)
    with kernel_lock:
        filter_rows(np.ascontiguousarray(image).reshape(height, channels * width), channels, rows)
    step = max(1, STRIP // rows.shape[1])
    strips = [rows[top : top + step] for top in range(0, height, step)]
    with ThreadPoolExecutor(torch.get_num_threads()) as pool:
        parts = list(pool.map(_deflate, strips, [strip is strips[-1] for strip in strips]))
    stream = b"".join([HEADER, *parts, struct.pack(">I", zlib.adler32(rows.data))])
    colours = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)  # 8 bits of red, green and blue, not interlaced
    return b"\x89PNG\r\n\x1a\n" + _chunk(b"IHDR", colours) + _chunk(b"IDAT", stream) + _chunk(b"IEND", b"")


def _deflate(rows: UInt8[np.ndarray, "h _"], last: bool) -> bytes:
    """A part of a raw deflate stream that ends at a whole byte; the last one ends the stream."""
    compressor = zlib.compressobj(LEVEL, zlib.DEFLATED, WINDOW, MEMORY, zlib.Z_RLE)
    return compressor.compress(rows.data) + compressor.flush(zlib.Z_FINISH if last else zlib.Z_SYNC_FLUSH)


def _chunk(kind: bytes, content: bytes) -> bytes:
    return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))
