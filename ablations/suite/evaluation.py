"""The images and records of one method in one cell of a study; each is made once and found again later."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from omegaconf import DictConfig, OmegaConf, open_dict

from ablations.suite.upsampled import bicubic, fine_photos, high_resolution_renders
from gaussian_enhancer.checkpoint import WEIGHTS, checkpoint_digest, find_checkpoint
from gaussian_enhancer.cli.pipeline import enhance_run, fit_run
from gaussian_enhancer.cli.train import naming_configuration
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.metrics.image_folders import Label, measure_files, pair_folders
from gaussian_enhancer.metrics.lpips import requested_distances
from gaussian_enhancer.metrics.pair import PROTOCOL
from gaussian_enhancer.metrics.records import Record, read_records, write_records
from gaussian_enhancer.runs.compose import compose_job
from gaussian_enhancer.runs.high_resolution import high_resolution_config
from gaussian_enhancer.runs.instantiate import require
from gaussian_enhancer.runs.run import find_run, open_run
from gaussian_enhancer.runs.runtime import start
from gaussian_enhancer.scene.renders import run_steps


@dataclass(frozen=True)
class StudyCell:
    """One scene, fitted by one splatting method at one density of training views.

    Args:
        scene: its name in the records.
        splat: method and density, for instance "3dgs/sparse".
        fit: overrides of the job fit.
        every: every n-th held-out view is measured.
        finer: whether it is measured against photos of 4 times the renders' resolution.
    """

    scene: str
    splat: str
    fit: tuple[str, ...]
    every: int = 1
    finer: bool = False


@dataclass(frozen=True)
class MethodImages:
    """Images of one method in one cell, and the photos that they are measured against.

    Args:
        folder: folder of the images.
        photos: folder of the photos, which have the same file names.
        every: every n-th image is measured.
        run: name of the fitted run.
        sources: names of the runs that the images were made from, by job.
        weights: digest of the weights; empty for methods without weights.
    """

    folder: Path
    photos: Path
    every: int
    run: str
    sources: Mapping[str, str] = field(default_factory=dict)
    weights: str = ""


def method_images(cfg: DictConfig, cell: StudyCell, method: str, method_settings: DictConfig) -> MethodImages:
    """The images of a method in a cell; made now unless they exist.

    Args:
        cfg: the calling job's configuration: ``runs``, ``runtime``, ``fit_missing``.
        cell: scene and splat.
        method: the method's name.
        method_settings: ``weights`` or ``train``, ``enhance``, ``upscale``, ``render``; if empty, the raw render.

    Raises:
        InputError: the method cannot be made here; the error says why.
    """
    fit = fitted_cell(cfg, cell)
    needs_weights = bool(method_settings.get("weights") or method_settings.get("train"))
    step_folder = fit / f"test/ours_{run_steps(fit)[-1]}"
    sources = {"fit": fit.name}
    folder = step_folder / "renders"
    photos = fine_photos(cfg, fit) if cell.finer else step_folder / "gt"
    if method_settings.get("render") and needs_weights:
        splat_inputs = {"gaussians": str(fit / "splat.ply"), "scene": high_resolution_config(_scene(cfg, cell))}
        folder = _enhanced_folder(cfg, method_settings, sources, **splat_inputs)
    elif method_settings.get("render"):
        folder = high_resolution_renders(cfg, fit, _scene(cfg, cell))
        sources["render_finer"] = folder.parent.name
    elif needs_weights:
        folder = _enhanced_folder(cfg, method_settings, sources, run=str(fit), every=cell.every)
    if method_settings.get("upscale"):
        folder = bicubic(cfg, folder, f"{fit.name}-{method}", photos)
        sources["bicubic"] = folder.parent.name
    every = 1 if needs_weights and not method_settings.get("render") else cell.every
    digest = checkpoint_digest(find_checkpoint(method_weights(cfg, method_settings))) if needs_weights else ""
    return MethodImages(folder, photos, every, fit.name, sources, digest)


def _enhanced_folder(
    cfg: DictConfig, method_settings: DictConfig, sources: dict[str, str], **job_options: object
) -> Path:
    """Run the job enhance with a method's weights; returns the folder of its images.

    Args:
        cfg: the calling job's configuration.
        method_settings: the method's entry in the configuration.
        sources: runs by job; the run of the job enhance is added.
        **job_options: further options of the job, for instance ``run``.
    """
    job = compose_checked("enhance", cfg, with_plan(tuple(method_settings.get("enhance") or ())))
    with open_dict(job):
        job.update({"weights": method_weights(cfg, method_settings), **job_options})
    folder = enhance_run(job)
    sources["enhance"] = folder.name
    return folder / f"test/ours_{run_steps(folder)[-1]}/enhanced"


def _scene(cfg: DictConfig, cell: StudyCell) -> DictConfig:
    scene: DictConfig = compose_checked("fit", cfg, cell.fit).scene
    return scene


def fitted_cell(cfg: DictConfig, cell: StudyCell) -> Path:
    """The folder of a cell's fit.

    Raises:
        InputError: the fit is missing and ``fit_missing`` is false, or it cannot be made.
    """
    refusal = InputError(f"{cell.scene} {cell.splat}", "is not fitted", f"gaussian-enhancer fit {' '.join(cell.fit)}")
    return fit_run(compose_checked("fit", cfg, cell.fit), None if cfg.fit_missing else refusal).folder


def method_weights(cfg: DictConfig, method_settings: DictConfig) -> str:
    """The weights of a method: those that it names, or those of its finished training.

    Raises:
        InputError: the training is not finished, or names what does not exist.
    """
    if method_settings.get("weights"):
        return str(method_settings.weights)
    job = naming_configuration(compose_checked("train", cfg, method_settings.train))
    run = find_run(job, "train")
    if run is None or not run.done:
        command = f"gaussian-enhancer train {' '.join(method_settings.train)}"
        raise InputError("weights", "are not trained yet" if run is None else "are being trained", command)
    return str(run.folder / WEIGHTS)


def check_same_views(cell: str, views: Mapping[str, tuple[str, ...]]) -> None:
    """Refuse methods of a cell that were measured on different views, since their means are not comparable.

    Args:
        cell: name of the cell.
        views: names of the measured views, sorted, by method.

    Raises:
        RuntimeError: the views differ.
    """
    if len(set(views.values())) > 1:
        raise RuntimeError(f"{cell}: methods were measured on different views ({', '.join(views)})")


def image_records(cfg: DictConfig, cell: StudyCell, method: str, images: MethodImages) -> tuple[Record, ...]:
    """The records of images against their photos; measured now unless the same images were measured before.

    Raises:
        InputError: file names or sizes do not match, or a file cannot be read.
    """
    label = Label(images.run, cell.scene, cell.splat, method)
    inputs = {"label": vars(label), "images": str(images.folder), "photos": str(images.photos), "every": images.every}
    conditions = {"protocol": PROTOCOL, "lpips": cfg.lpips, "backbones": cfg.backbones}
    job = OmegaConf.create({"runs": cfg.runs, **inputs, **conditions})
    earlier_run = find_run(job, "measure_row")
    if earlier_run is not None and earlier_run.done:
        return read_records(earlier_run.folder / "records.jsonl")
    records = tuple(replace(record, weights=images.weights) for record in measure_now(cfg, label, images))
    new_run = open_run(job, "measure_row", f"{cell.scene}-{cell.splat.replace('/', '-')}-{method}")
    write_records(new_run.folder / "records.jsonl", records)
    new_run.finish()
    return records


def measure_now(cfg: DictConfig, label: Label, images: MethodImages) -> tuple[Record, ...]:
    """Measure images against their photos.

    Args:
        cfg: the calling job's configuration: ``runtime``, ``lpips``, ``backbones``.
        label: run, scene, splat and method, as the records state them.
        images: what is measured.

    Raises:
        InputError: file names or sizes do not match, or a file cannot be read.
    """
    device = start(cfg.runtime)
    distances = requested_distances(cfg.lpips, cfg.backbones, device)
    files = pair_folders(images.folder, images.photos, label)[:: images.every]
    return tuple(measure_files(files, distances))


def with_plan(overrides: tuple[str, ...]) -> tuple[str, ...]:
    """Overrides of the job enhance, with the full plan unless they name one: whole networks are compared."""
    return overrides if any(word.startswith("plan=") for word in overrides) else ("plan=full", *overrides)


def compose_checked(name: str, cfg: DictConfig, overrides: Iterable[str]) -> DictConfig:
    """Compose another job's configuration; invalid overrides are reported as input errors.

    Args:
        name: the other job.
        cfg: the calling job's configuration: ``runs`` and ``runtime``.
        overrides: as on the command line.

    Raises:
        InputError: an override is invalid, or a mandatory value is not set.
    """
    job = compose_job(name, cfg, overrides)
    require(job)
    return job
