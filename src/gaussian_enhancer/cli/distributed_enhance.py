"""Several processes enhance the views of a set, each its own part, in Lightning's prediction loop."""

from dataclasses import replace
from functools import partial
from pathlib import Path

import torch
from lightning import LightningModule, Trainer
from omegaconf import DictConfig
from torch.utils.data import DataLoader

from gaussian_enhancer.infer.enhancer import Enhanced, SetEnhancer
from gaussian_enhancer.infer.plan import Plan
from gaussian_enhancer.infer.planner import Planner
from gaussian_enhancer.runs.enhancement import ready
from gaussian_enhancer.runs.runtime import start
from gaussian_enhancer.scene.image_files import write_image
from gaussian_enhancer.scene.rendered import RenderedSet
from gaussian_enhancer.train.processes import Place, together
from gaussian_enhancer.train.share import Strided, gathered
from gaussian_enhancer.train.trainer import quieten


class Prediction(LightningModule):
    """Enhances one view a step and writes it.

    Args:
        enhancer: the enhancer; it stays on its own device.
        rendered: this process's part of the views.
        folder: where images are written.
        planner: leaves out what a view does not need.
    """

    def __init__(
        self, enhancer: SetEnhancer, rendered: RenderedSet, folder: Path, planner: Planner | None = None
    ) -> None:
        super().__init__()
        # An iterator over all, since references that were read for one view serve the next.
        self.views, self.folder = enhancer(rendered, planner), folder
        self.written: list[Enhanced] = []

    def predict_step(self, batch: int, index: int) -> None:
        """Write the next view; what is known of it is kept here, since Lightning cannot carry frozen dataclasses."""
        one = next(self.views)
        write_image(self.folder / one.name, one.image)
        self.written.append(replace(one, image=torch.empty(3, 0, 0)))


def predicted(
    enhancer: SetEnhancer,
    rendered: RenderedSet,
    folder: Path,
    place: Place,
    progress: bool,
    planner: Planner | None = None,
) -> list[Enhanced]:
    """Enhance this process's part of a set's targets and write the images.

    Args:
        enhancer: the network with its reference_config.
        rendered: the whole set, of at least as many targets as there are processes.
        folder: where images are written.
        place: of this process.
        progress: show a bar.
        planner: leaves out what a view does not need; None enhances all of it.

    Returns:
        All views, those of the other processes included, in the set's order, without their pixels and plans.
    """
    quieten()
    own = Strided(len(rendered.targets), place.rank, place.ranks)
    part = replace(rendered, targets=tuple(rendered.targets[number] for number in own))
    trainer = Trainer(
        accelerator=enhancer.device.type,
        logger=False,
        enable_checkpointing=False,
        enable_model_summary=False,
        enable_progress_bar=progress,
        **place.options(),
    )
    module = Prediction(enhancer, part, folder, planner)
    loader: DataLoader[int] = DataLoader(range(len(part.targets)), batch_size=None)  # type: ignore[arg-type]
    trainer.predict(module, loader, return_predictions=False)
    # No tensor of inference mode, and no more than a pipe holds: who plans ahead knows the plans.
    written = [replace(one, image=torch.empty(3, 0, 0), plan=None) for one in module.written]
    found = {one.name: one for one in gathered(written)}
    return [found[view.name] for view in rendered.targets]


def enhanced_together(folder: Path, plan: Plan, cfg: DictConfig, processes: int) -> list[Enhanced]:
    """Enhance by several processes, by a plan that is made.

    Args:
        folder: where images are written.
        plan: what of each view is enhanced.
        cfg: configuration of the job ``enhance``.
        processes: how many; at most as many as there are views.

    Returns:
        All views in the set's order, without their pixels and plans.

    Raises:
        InputError: a process refuses its input.
    """
    every: list[Enhanced] = together(partial(_part, folder, plan), cfg, processes)
    return every


def _part(folder: Path, plan: Plan, cfg: DictConfig, place: Place) -> list[Enhanced]:
    """Enhance one process's part of the views."""
    device = start(cfg.runtime)
    device = torch.device("cuda", place.rank) if device.type == "cuda" else device
    enhancer, task, found = ready(cfg, device)
    planner = found.planner(plan.rules, plan.views)
    return predicted(enhancer, task.rendered, folder, place, cfg.runtime.progress, planner)
