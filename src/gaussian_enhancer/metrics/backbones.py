"""Search path of LPIPS backbones."""

import os
from pathlib import Path


def data_backbones() -> Path | None:
    """The folder ``lpips`` of the data folder that ``GAUSSIAN_ENHANCER_DATA`` names; None where there is none."""
    data = os.environ.get("GAUSSIAN_ENHANCER_DATA")
    folder = Path(data) / "lpips" if data else None
    return folder if folder is not None and folder.is_dir() else None
