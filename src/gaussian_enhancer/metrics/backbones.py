"""Search path of LPIPS backbones."""

import os
from pathlib import Path

from omegaconf import DictConfig, open_dict


def data_backbones() -> Path | None:
    """The folder ``lpips`` of the data folder that ``GAUSSIAN_ENHANCER_DATA`` names; None where there is none."""
    data = os.environ.get("GAUSSIAN_ENHANCER_DATA")
    folder = Path(data) / "lpips" if data else None
    return folder if folder is not None and folder.is_dir() else None


def with_backbones(cfg: DictConfig) -> DictConfig:
    """Set `backbones` to the captures' LPIPS folder if it exists and none is given."""
    beside = Path(os.environ.get("GAUSSIAN_ENHANCER_DATA", ".")) / "lpips"
    if cfg.backbones is None and beside.is_dir():
        with open_dict(cfg):
            cfg.backbones = str(beside)
    return cfg
