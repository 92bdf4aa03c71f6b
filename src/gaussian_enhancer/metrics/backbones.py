"""Search path of LPIPS backbones."""

import os
from pathlib import Path

from omegaconf import DictConfig, open_dict


def with_backbones(cfg: DictConfig) -> DictConfig:
    """Set `backbones` to the captures' LPIPS folder if it exists and none is given."""
    beside = Path(os.environ.get("GAUSSIAN_ENHANCER_DATA", ".")) / "lpips"
    if cfg.backbones is None and beside.is_dir():
        with open_dict(cfg):
            cfg.backbones = str(beside)
    return cfg
