"""Search path of LPIPS backbones."""

import os
from pathlib import Path


def data_backbones() -> Path | None:
    """The folder ``lpips`` in the data folder ``GAUSSIAN_ENHANCER_DATA``; None if it does not exist."""
    data = os.environ.get("GAUSSIAN_ENHANCER_DATA")
    folder = Path(data) / "lpips" if data else None
    return folder if folder is not None and folder.is_dir() else None
