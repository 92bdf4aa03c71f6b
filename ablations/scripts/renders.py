"""``gaussian-enhancer renders``: gain of enhancers trained on real, simulated and mixed renders.

The rows are those of conf/ablation/renders, measured on the same views. They are trained by ``gaussian-enhancer train
-m +recipe=renders +ablation/renders=real,naive,...``; this enhances the held-out views of the runs' last steps with
each row's weights, at full strength, and measures the gain over the raw render. The default is decided on validation
runs; test runs are reported (docs/data.md).
"""

from collections.abc import Sequence
from pathlib import Path

import torch
from omegaconf import DictConfig

from ablations.study.engine import Study, job
from ablations.study.gains import gain_study
from gaussian_enhancer.checkpoint import WEIGHTS
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.infer.enhancer import SetEnhancer
from gaussian_enhancer.infer.weights import load_weights
from gaussian_enhancer.runs.status import DONE


def find_weights(row: str, runs: Path) -> Path:
    """The weights of a row; the one finished training with its label.

    Raises:
        InputError: there is none, or more than one.
    """
    finished = sorted(folder for folder in (runs / "train").glob(f"renders_{row}-*") if (folder / DONE).is_file())
    if len(finished) != 1:
        remedy = f"run: gaussian-enhancer train +recipe=renders +ablation/renders={row}"
        raise InputError(f"row {row}", f"has {len(finished)} finished trainings", remedy)
    return finished[0] / WEIGHTS


def load_enhancers(rows: Sequence[str], runs: Path, device: torch.device | None = None) -> dict[str, SetEnhancer]:
    """The rows' networks, at full strength.

    Raises:
        InputError: rows were trained with different preparations, so that their views could not be shared.
    """
    loaded = {row: load_weights(find_weights(row, runs)) for row in rows}
    configs = [pretrained.reference_config for pretrained in loaded.values()]
    if any(config != configs[0] for config in configs):
        raise InputError("rows", "prepare their references differently", "train them with the same recipe")
    return {row: SetEnhancer(pretrained.network, configs[0], device) for row, pretrained in loaded.items()}


def study(cfg: DictConfig, device: torch.device) -> Study[Path]:
    """The rows' gains.

    Raises:
        InputError: a row was not trained, or runs cannot be compared.
    """
    return gain_study(load_enhancers(cfg.rows, Path(cfg.folder), device), cfg, device)


run = job(study)
