"""One method in one cell of a study: its images and their records, each made once."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from omegaconf import DictConfig, OmegaConf, open_dict

from ablations.suite.upsampled import bicubic, fine_photos, rendered_finer
from gaussian_enhancer.checkpoint import checkpoint_digest, find_checkpoint
from gaussian_enhancer.cli.pipeline import enhanced, finished_fit
from gaussian_enhancer.cli.train import with_effect
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.metrics.image_folders import Label, measure_files, pair_folders
from gaussian_enhancer.metrics.lpips import asked_distances
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
    """One scene fitted by one method from so many views.

    Args:
        scene: its name in the records.
        splat: method and density, for instance "3dgs/sparse".
        fit: overrides of the job fit.
        every: every n-th held-out view is measured.
        finer: whether it is measured against photos 4 times as fine as the renders.
    """

    scene: str
    splat: str
    fit: tuple[str, ...]
    every: int = 1
    finer: bool = False


@dataclass(frozen=True)
class MethodImages:
    """Images of one method in one cell, and what they are measured against.

    Args:
        folder: the images.
        photos: their photos, by the same names.
        every: every n-th of them is measured.
        run: name of the fitted run.
        sources: the runs that they came from, by job.
        weights: digest of the weights that made them; empty where none did.
    """

    folder: Path
    photos: Path
    every: int
    run: str
    sources: Mapping[str, str] = field(default_factory=dict)
    weights: str = ""


def measured_row(cfg: DictConfig, cell: StudyCell, method: str, choice: DictConfig) -> tuple[Record, ...]:
    """The records of a method in a cell, measured or found measured.

    Args:
        cfg: conf/quality.yaml, composed.
        cell: where.
        method: the method's name.
        choice: the method's entry in the configuration: the raw render where it names nothing.

    Raises:
        InputError: the method cannot be made here; the error says why.
    """
    return measured_images(cfg, cell, method, images_of(cfg, cell, method, choice))


def images_of(cfg: DictConfig, cell: StudyCell, method: str, choice: DictConfig) -> MethodImages:
    """The images of a method in a cell, made or found made.

    Args:
        cfg: the calling job's configuration: ``runs``, ``runtime``, ``fit_missing``.
        cell: where.
        method: the method's name.
        choice: ``weights`` or ``train``, ``enhance``, ``upscale``, ``render``; the raw render where it names nothing.

    Raises:
        InputError: the method cannot be made here; the error says why.
    """
    fit = fitted_cell(cfg, cell)
    learnt = bool(choice.get("weights") or choice.get("train"))
    raw = fit / f"test/ours_{run_steps(fit)[-1]}"
    sources = {"fit": fit.name}
    folder = raw / "renders"
    photos = fine_photos(cfg, fit) if cell.finer else raw / "gt"
    if choice.get("render") and learnt:
        given = {"gaussians": str(fit / "splat.ply"), "scene": high_resolution_config(_scene(cfg, cell))}
        folder = _enhanced(cfg, choice, sources, **given)
    elif choice.get("render"):
        folder = rendered_finer(cfg, fit, _scene(cfg, cell))
        sources["render_finer"] = folder.parent.name
    elif learnt:
        folder = _enhanced(cfg, choice, sources, run=str(fit), every=cell.every)
    if choice.get("upscale"):
        folder = bicubic(cfg, folder, f"{fit.name}-{method}", photos)
        sources["bicubic"] = folder.parent.name
    every = 1 if learnt and not choice.get("render") else cell.every
    digest = checkpoint_digest(find_checkpoint(weights_of(cfg, choice))) if learnt else ""
    return MethodImages(folder, photos, every, fit.name, sources, digest)


def _enhanced(cfg: DictConfig, choice: DictConfig, sources: dict[str, str], **given: object) -> Path:
    """The folder of the images that a method's weights make of what is given; the run is added to the sources."""
    words = tuple(choice.get("enhance") or ())
    planned = any(word.startswith("plan=") for word in words)
    job = composed("enhance", cfg, words if planned else ("plan=full", *words))  # networks are compared in full
    with open_dict(job):
        job.update({"weights": weights_of(cfg, choice), **given})
    folder = enhanced(job)
    sources["enhance"] = folder.name
    return folder / f"test/ours_{run_steps(folder)[-1]}/enhanced"


def _scene(cfg: DictConfig, cell: StudyCell) -> DictConfig:
    scene: DictConfig = composed("fit", cfg, cell.fit).scene
    return scene


def fitted_cell(cfg: DictConfig, cell: StudyCell) -> Path:
    """The folder of a cell's fit.

    Raises:
        InputError: it is not fitted and shall not be, or cannot be.
    """
    refusal = InputError(f"{cell.scene} {cell.splat}", "is not fitted", f"gaussian-enhancer fit {' '.join(cell.fit)}")
    return finished_fit(composed("fit", cfg, cell.fit), None if cfg.fit_missing else refusal).folder


def weights_of(cfg: DictConfig, choice: DictConfig) -> str:
    """The weights of a method: those it names, or those that its training has left.

    Raises:
        InputError: the training is not finished, or names what does not exist.
    """
    if choice.get("weights"):
        return str(choice.weights)
    job = with_effect(composed("train", cfg, choice.train))
    found = find_run(job, "train")
    if found is None or not found.done:
        command = f"gaussian-enhancer train {' '.join(choice.train)}"
        raise InputError("weights", "are not trained yet" if found is None else "are being trained", command)
    return str(found.folder / "weights.safetensors")


def check_same_views(cell: str, views: Mapping[str, tuple[str, ...]]) -> None:
    """Stop where the methods of a cell were measured on different views: their means could not be compared.

    Args:
        cell: what the cell is called.
        views: names of the measured views, sorted, by method.

    Raises:
        RuntimeError: they differ.
    """
    if len(set(views.values())) > 1:
        raise RuntimeError(f"{cell}: methods were measured on different views ({', '.join(views)})")


def measured_images(cfg: DictConfig, cell: StudyCell, method: str, images: MethodImages) -> tuple[Record, ...]:
    """Measure images against their photos, unless these very images were measured before.

    Raises:
        InputError: names or sizes do not fit, or a file cannot be read.
    """
    label = Label(images.run, cell.scene, cell.splat, method)
    wanted = {"label": vars(label), "images": str(images.folder), "photos": str(images.photos), "every": images.every}
    conditions = {"protocol": PROTOCOL, "lpips": cfg.lpips, "backbones": cfg.backbones}
    job = OmegaConf.create({"runs": cfg.runs, **wanted, **conditions})
    before = find_run(job, "measure_row")
    if before is not None and before.done:
        return read_records(before.folder / "records.jsonl")
    records = tuple(replace(record, weights=images.weights) for record in measure_now(cfg, label, images))
    own = open_run(job, "measure_row", f"{cell.scene}-{cell.splat.replace('/', '-')}-{method}")
    write_records(own.folder / "records.jsonl", records)
    own.finish()
    return records


def measure_now(cfg: DictConfig, label: Label, images: MethodImages) -> tuple[Record, ...]:
    """Measure images against their photos.

    Args:
        cfg: the calling job's configuration: ``runtime``, ``lpips``, ``backbones``.
        label: what the records say of them.
        images: what is measured.

    Raises:
        InputError: names or sizes do not fit, or a file cannot be read.
    """
    device = start(cfg.runtime)
    distances = asked_distances(cfg.lpips, cfg.backbones, device)
    files = pair_folders(images.folder, images.photos, label)[:: images.every]
    return tuple(measure_files(files, distances))


def composed(name: str, cfg: DictConfig, overrides: Iterable[str]) -> DictConfig:
    """Another job's configuration, its refusals as a user's mistake.

    Args:
        name: the other job.
        cfg: the calling job's configuration: ``runs`` and ``runtime``.
        overrides: as on the command line.

    Raises:
        InputError: the overrides are refused, or leave a mandatory value open.
    """
    job = compose_job(name, cfg, overrides)
    require(job)
    return job
