"""Types and bounds of the options of each job, which are checked before the job starts.

Groups (scene, splat, fusion, ...) are checked against the signatures of the objects that they build (`runs.arguments`).
"""

import os
from collections.abc import Mapping
from importlib import import_module
from typing import Annotated, Any, Literal, NotRequired, get_type_hints

from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException
from pydantic import AfterValidator, Field, with_config
from typing_extensions import TypedDict

from gaussian_enhancer.errors import InputError, refuse_unknown
from gaussian_enhancer.typed import STRICT, check_plain

LONGEST_NAME, LONGEST_PATH = 255, 4095
"""Most bytes that operating systems allow in a file's name and in a path."""


def _check_path(path: str) -> str:
    names = [os.fsencode(name) for name in path.split("/")]
    if any(len(name) > LONGEST_NAME for name in names) or len(os.fsencode(path)) > LONGEST_PATH:
        raise ValueError(f"a path of at most {LONGEST_PATH} bytes, with names of at most {LONGEST_NAME}")
    if "\0" in path:
        raise ValueError("a path without zero bytes")
    return path


PathText = Annotated[str, AfterValidator(_check_path)]
PathTexts = list[PathText]
Scalar = str | int | float
Group = dict[str, Any]
Count = Annotated[int, Field(ge=1)]
NonNegativeInt = Annotated[int, Field(ge=0)]
Side = Annotated[int, Field(ge=64, le=8192)]
Seed = Annotated[int, Field(ge=0, lt=2**32)]
Positive = Annotated[float, Field(gt=0)]
NonNegative = Annotated[float, Field(ge=0)]
Share = Annotated[float, Field(ge=0, le=1)]


@with_config(STRICT)
class Runtime(TypedDict):
    """Options below ``runtime``."""

    device: str
    threads: Count | None
    keep_memory: bool
    progress: bool
    processes: NotRequired[Count]


class Shared:
    """Options of every job."""

    output: PathText | None
    runtime: Runtime


class Options(Shared):
    """Options of jobs that make or read content-addressed runs."""

    runs: PathText


class Demo(Options):
    """Options of the job ``demo``."""

    scene: Group
    splat: Group
    settings: Group
    weights: PathText
    lpips: list[str] | None
    backbones: PathText | None


class Fit(Options):
    """Options of the job ``fit``."""

    scene: Group
    splat: Group
    settings: Group
    profile: bool


class Simulate(Options):
    """Options of the job ``simulate``."""

    gate: Group
    generator: Group
    image: PathText | None
    depth: PathText | None
    depth_scale: Positive
    background: list[Share]
    run: PathText | None
    view: Scalar | None
    step: NonNegativeInt | None
    seed: Seed
    draws: Count


class Enhancing(Options):
    """Options of jobs that enhance views of a splat."""

    scene: Group | None
    run: PathText | None
    gaussians: PathText | None
    invalid: str
    method: str
    weights: PathText
    max_references: Annotated[int, Field(ge=0, le=8)] | None
    depth_kind: str
    strength: Share | None
    colour_clamping: NonNegativeInt
    colour_completion: bool
    confidence: bool
    ensemble: bool
    precision: str
    tile: Count


class Enhance(Enhancing):
    """Options of the job ``enhance``."""

    plan: Group
    distil: bool
    second: PathText | None
    earlier_step: NonNegativeInt | Literal["auto"] | None
    dry_run: bool
    step: NonNegativeInt | None
    every: Count
    views: str
    renders: PathText | None
    photos: PathText | None
    references: PathText | None
    cameras: PathText | None
    depth: PathText | None
    depth_scale: Positive
    recover_geometry: bool
    budget_ms: Positive | None
    temporal_smoothing: Share


class Video(Enhancing):
    """Options of the job ``video``."""

    plan: Group
    path: PathText
    input: PathText | None
    frames: Count | None
    cameras: Count | None
    turns: float | None
    radius: Positive
    height: Count | None
    format: str | None
    layout: str
    wipe: Share | None
    fps: Positive | None
    quality: NonNegativeInt
    budget_ms: Positive | None
    temporal_smoothing: Share


class View(Enhancing):
    """Options of the job ``view``."""

    plan: Group
    distilled: PathText | None
    host: str
    port: Annotated[int, Field(ge=0, lt=2**16)]
    show: str
    wipe: Share
    width: Side
    moving_width: Side


class Distil(Enhancing):
    """Options of the job ``distil``."""

    settings: Group
    evidence: Group
    format: str
    prune: bool
    prune_only: bool


class Export(Options):
    """Options of the job ``export``."""

    weights: PathText
    format: str
    references: Count | None


@with_config(STRICT)
class Trainer(TypedDict):
    """Options below ``trainer`` that decide what is trained; Lightning checks the others."""

    max_steps: Annotated[int, Field(ge=-1)]
    log_every_n_steps: NotRequired[NonNegativeInt]
    gradient_clip_val: NotRequired[NonNegative | None]


class Training(Options):
    """Options of the training jobs."""

    label: Scalar
    study: Scalar
    seed: Seed
    save_every: Count
    card: dict[str, Any]
    data: Group
    trainer: Trainer


class Train(Training):
    """Options of the job ``train``."""

    fusion: Group
    loss: Group
    optimizer: Group
    lr_scheduler: Group
    reference_config: Group
    initial: PathText | dict[str, PathText] | None
    frozen: list[str]
    bad_share: Share
    coarse: NonNegative


class TrainGenerator(Training):
    """Options of the job ``train_generator``."""

    design: Group
    generator_loss: Group
    sampler: Group
    paired: Group
    diffused: Group


@with_config(STRICT)
class Fold(TypedDict):
    """An entry of ``folds``."""

    weights: PathText
    fits: PathTexts


class TrainConfidence(Options):
    """Options of the job ``train_confidence``."""

    fits: PathTexts
    folds: list[Fold]
    weights: PathText
    hidden: Annotated[int, Field(ge=1, le=1024)]
    steps: Annotated[int, Field(ge=2)]
    harm: NonNegative
    block_harm: NonNegative
    warp: dict[str, Any]
    card: dict[str, Any]
    seed: Seed


class Measure(Options):
    """Options of the job ``measure``."""

    images: PathText | None
    photos: PathText | None
    raw: PathText | None
    run: PathText | None
    step: NonNegativeInt | None
    masks: PathText | None
    variant: Scalar
    scene_name: Scalar | None
    splat_name: Scalar | None
    unmatched: str
    background: list[Any]
    lpips: list[str] | None
    backbones: PathText | None


class Report(Options):
    """Options of the job ``report``."""

    measured: PathText
    title: Scalar | None
    most_pictured: Annotated[int, Field(ge=1)]
    contact_sheet: bool


class Download(Options):
    """Options of the job ``download``."""

    dataset: Group
    scenes: Any  # both lists are checked against the data set (`scene.datasets`)
    images: Any
    folder: PathText
    dry_run: bool
    keep_archives: bool
    retries: NonNegativeInt
    timeout: Positive


OPTIONS: Mapping[str, type[Shared]] = {
    "demo": Demo,
    "fit": Fit,
    "simulate": Simulate,
    "enhance": Enhance,
    "video": Video,
    "view": View,
    "distil": Distil,
    "export": Export,
    "train": Train,
    "train_generator": TrainGenerator,
    "train_confidence": TrainConfidence,
    "measure": Measure,
    "report": Report,
    "download": Download,
}
"""The class of options of each job."""


def options_of(job: str) -> type[Shared]:
    """The options of a job. Those of the experiment suite's jobs are declared in ``ablations.options``."""
    options_by_job: Mapping[str, type[Shared]] = (
        OPTIONS if job in OPTIONS else import_module("ablations.options").OPTIONS
    )
    return options_by_job.get(job, Options)


def check_options(job: str, cfg: DictConfig) -> None:
    """Refuse a configuration with an option of the wrong type, or out of bounds. Missing values (``???``) pass.

    Unknown options, which Hydra adds with ``+NAME=VALUE``, are refused, since nothing reads them. The jobs
    ``train`` and ``train_generator`` accept them: recipes and ablations add keys that other keys refer to.

    Args:
        job: the job's name.
        cfg: its whole configuration.

    Raises:
        InputError: an option was removed, is unknown, of the wrong type or out of bounds, or cannot be resolved.
    """
    options = get_type_hints(options_of(job), include_extras=True)
    if not issubclass(options_of(job), Training):
        refuse_unknown(f"options of {job}", cfg, options)
    for name, kind in options.items():
        if kind == Group | None and name not in cfg:
            continue  # an optional group without a choice
        if name not in cfg and not OmegaConf.is_missing(cfg, name):
            raise InputError(name, f"was removed from the configuration of {job}", f"remove ~{name} from the command")
        if not OmegaConf.is_missing(cfg, name):
            check_plain(_value(cfg, name), kind, name)


def _value(cfg: DictConfig, name: str) -> Any:
    try:
        value = cfg[name]
        return OmegaConf.to_container(value, resolve=True) if OmegaConf.is_config(value) else value
    except OmegaConfBaseException as error:
        cause = str(error).splitlines()[0]
        raise InputError(error.full_key or name, f"cannot be resolved: {cause}", "set what it refers to") from error
