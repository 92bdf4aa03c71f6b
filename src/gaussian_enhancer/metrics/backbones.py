"""Where the backbones of LPIPS are looked for."""

import os
from pathlib import Path

from omegaconf import DictConfig, open_dict


def with_backbones(cfg: DictConfig) -> DictConfig:
    """The configuration with LPIPS's backbones where the captures' folder holds some and none are named."""
    beside = Path(os.environ.get("GAUSSIAN_ENHANCER_DATA", ".")) / "lpips"
    if cfg.backbones is None and beside.is_dir():
        with open_dict(cfg):
            cfg.backbones = str(beside)
    return cfg
