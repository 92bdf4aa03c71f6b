"""The types and bounds of every job's own options, checked before the job begins.

Groups (scene, splat, fusion, ...) are checked against the signatures of what they build (`runs.arguments`).
"""

import os
from collections.abc import Mapping
from typing import Annotated, Any, Literal, NotRequired, get_type_hints

from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException
from pydantic import AfterValidator, Field, with_config
from typing_extensions import TypedDict

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.runs.lock import RECORDS
from gaussian_enhancer.typed import STRICT, check_plain

LONGEST_NAME, LONGEST_PATH = 255, 4095
"""Bytes that systems allow of a file's name and of a path."""


def _usable(path: str) -> str:
    names = [os.fsencode(name) for name in path.split("/")]
    if any(len(name) > LONGEST_NAME for name in names) or len(os.fsencode(path)) > LONGEST_PATH:
        raise ValueError(f"a path of at most {LONGEST_PATH} bytes, with names of at most {LONGEST_NAME}")
    if "\0" in path:
        raise ValueError("a path without zero bytes")
    return path


def _records(path: str) -> str:
    if not path.endswith(RECORDS):
        raise ValueError(f"a file that ends in {' or '.join(RECORDS)}")
    return path


Place = Annotated[str, AfterValidator(_usable)]
Places = list[Place]
RecordsFile = Annotated[Place, AfterValidator(_records)]
Word = str | int | float
Group = dict[str, Any]
Count = Annotated[int, Field(ge=1)]
Size = Annotated[int, Field(ge=0)]
PixelSize = Annotated[str, Field(pattern=r"^[1-9]\d*x[1-9]\d*$")]
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

    output: Place | None
    runtime: Runtime


class Options(Shared):
    """Options of jobs that make or read content-addressed runs."""

    runs: Place


class OfFits(Shared):
    """Options of measurements of finished fits."""

    row_table: Group
    runs: Places
    records: RecordsFile | None


class FromRecords(Shared):
    """Options of measurements of runs that make a page from their records."""

    row_table: Group
    runs: Places
    records: RecordsFile
    page: Place | None
    lpips: list[str]
    backbones: Place | None


class Demo(Options):
    """Options of the job ``demo``."""

    scene: Group
    splat: Group
    settings: Group
    weights: Place
    lpips: list[str] | None
    backbones: Place | None


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
    image: Place | None
    depth: Place | None
    depth_scale: Positive
    background: list[Share]
    run: Place | None
    view: Word | None
    step: Size | None
    seed: Seed
    draws: Count


class Enhancing(Options):
    """Options of jobs that enhance views."""

    weights: Place
    max_references: Size | None
    depth_kind: str
    strength: Share | None
    colour_clamping: Size
    colour_completion: bool
    confidence: bool
    precision: str
    tile: Count


class Enhance(Enhancing):
    """Options of the job ``enhance``."""

    scene: Group | None
    plan: Group
    dry_run: bool
    run: Place | None
    step: Size | None
    every: Count
    gaussians: Place | None
    invalid: str
    method: str
    views: str
    renders: Place | None
    photos: Place | None
    references: Place | None
    cameras: Place | None
    depth: Place | None
    depth_scale: Positive
    recover_geometry: bool
    budget_ms: Positive | None
    temporal_smoothing: Share


class Video(Enhancing):
    """Options of the job ``video``."""

    scene: Group | None
    plan: Group
    run: Place | None
    gaussians: Place | None
    invalid: str
    method: str
    path: Place
    frames: Count | None
    cameras: Count | None
    turns: float | None
    radius: Positive
    height: Count | None
    format: str | None
    layout: str
    wipe: Share | None
    fps: Positive | None
    quality: Size
    budget_ms: Positive | None
    temporal_smoothing: Share | None


class View(Enhancing):
    """Options of the job ``view``."""

    scene: Group | None
    plan: Group
    run: Place | None
    gaussians: Place | None
    distilled: Place | None
    invalid: str
    method: str
    host: str
    port: Annotated[int, Field(ge=0, lt=2**16)]
    show: str
    wipe: Share
    width: Side
    moving_width: Side


class Distil(Enhancing):
    """Options of the job ``distil``."""

    scene: Group | None
    settings: Group
    evidence: Group
    run: Place | None
    gaussians: Place | None
    invalid: str
    method: str
    format: str
    prune: bool
    prune_only: bool


class Export(Options):
    """Options of the job ``export``."""

    weights: Place
    format: str
    references: Count | None


@with_config(STRICT)
class Trainer(TypedDict):
    """Options below ``trainer`` that decide what is trained; Lightning checks the others."""

    max_steps: Annotated[int, Field(ge=-1)]
    log_every_n_steps: NotRequired[Size]
    gradient_clip_val: NotRequired[NonNegative | None]


class Training(Options):
    """Options of the trainings."""

    label: Word
    study: Word
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
    initial: Place | dict[str, Place] | None
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

    weights: Place
    fits: Places


class TrainConfidence(Options):
    """Options of the job ``train_confidence``."""

    fits: Places
    folds: list[Fold]
    weights: Place
    hidden: Annotated[int, Field(ge=1, le=1024)]
    steps: Annotated[int, Field(ge=2)]
    harm: NonNegative
    card: dict[str, Any]
    seed: Seed


class Measure(Options):
    """Options of the job ``measure``."""

    images: Place | None
    photos: Place | None
    raw: Place | None
    run: Place | None
    step: Size | None
    masks: Place | None
    variant: Word
    scene_name: Word | None
    splat_name: Word | None
    unmatched: str
    background: list[Any]
    lpips: list[str] | None
    backbones: Place | None


class Report(Options):
    """Options of the job ``report``."""

    measured: Place
    title: Word | None
    most_pictured: Size
    contact_sheet: bool


class Download(Options):
    """Options of the job ``download``."""

    dataset: Group
    folder: Place
    dry_run: bool
    keep_archives: bool
    retries: Size
    timeout: Positive


class Dashboard(Options):
    """Options of the job ``dashboard``."""

    folder: Place
    title: Word | None
    studies: dict[str, Any]
    images_per_scene: Size


class PlanStudy(Options):
    """Options of the job ``plan_study``."""

    worlds: Group
    weights: Place
    repeats: Count
    fit_missing: bool
    records_only: bool
    lpips: list[str]
    backbones: Place | None
    baseline: str
    shown: str
    faster: Positive
    slower: Positive
    allowed: NonNegative
    results: Place
    markdown: Place


class Quality(Options):
    """Options of the job ``quality``."""

    scenes: list[str] | None
    splats: list[str]
    fit: list[str]
    fit_missing: bool
    records_only: bool
    lpips: list[str]
    backbones: Place | None
    groups: Group
    tables: Group
    markdown: Place
    records: RecordsFile


class Stability(Options):
    """Options of the job ``stability``."""

    families: list[str] | None
    cases: list[str] | None
    records_only: bool
    records: RecordsFile
    markdown: Place


class Status(Options):
    """Options of the job ``status``."""

    scale: Group
    table: Word | list[Word] | None
    states: list[str] | None
    backbones: Place | None


class Pages(Options):
    """Options of the job ``pages``."""

    write: bool


class Fresh(Options):
    """Options of the job ``fresh``."""

    strict: bool
    inputs: dict[str, list[str]]
    pages: dict[str, Group]
    tables: list[str]


class Tables(Options):
    """Options of the job ``tables``."""

    scale: Group
    table: Word | list[Word]
    dry_run: bool
    workers: Count | None
    scheduler: str | None
    records_only: bool
    fit_missing: bool
    train_missing: bool
    results: Place
    backbones: Place | None


class Tradeoff(Options):
    """Options of the job ``tradeoff``."""

    kind: Literal["quality", "training", "numerics", "all"]
    records_only: bool
    fit_missing: bool
    train_missing: bool
    lpips: list[str]
    backbones: Place | None
    minutes: Positive
    studies: list[str] | None
    settings: Place | None
    markdown: Place
    results: Place


class Candidates(OfFits):
    """Options of the job ``candidates``."""

    weights: Places
    every: Count
    lpips: list[str]
    backbones: Place | None


class Guards(Candidates):
    """Options of the job ``guards``."""

    guard: Literal["photo_consistency", "colour_clamping", "strength"]


class Renders(OfFits):
    """Options of the job ``renders``."""

    rows: list[str]
    folder: Place
    every: Count
    lpips: list[str]
    backbones: Place | None


class IBGS(Options):
    """Options of the job ``ibgs``."""

    fit: Place
    step: Count | None
    settings: Group
    choice: Group


class Convergence(FromRecords):
    """Options of the job ``convergence``."""

    methods: list[str]
    last: bool
    ibgs: Places
    second: Places
    pictures: Place | None


class DistilStudy(FromRecords):
    """Options of the job ``distil_study``."""

    weights: Place


class DepthStudy(OfFits):
    """Options of the job ``depth``."""

    weights: Place
    every: Count
    strength: Share
    lpips: list[str]
    backbones: Place | None


class Flicker(OfFits):
    """Options of the job ``flicker``."""

    weights: Place
    frames: Annotated[int, Field(ge=2)]
    cameras: Annotated[int, Field(ge=2)]
    strength: Share | None
    temporal_smoothing: list[Share]
    hysteresis: list[Annotated[float, Field(gt=0, le=1)]]


class AlreadyGood(OfFits):
    """Options of the job ``already_good``."""

    weights: Place
    views: Count


class Realism(Options):
    """Options of the job ``realism``."""

    row_table: Group
    train: Places
    test: Places
    rows: list[str]
    generator_weights: Place | None
    steps: Count
    seeds: Count
    seed: Seed
    renders: Count
    patches: Count
    patch_size: Count
    records: RecordsFile | None


class Diversity(OfFits):
    """Options of the job ``diversity``."""

    rows: list[str]
    generator_weights: Place | None
    seed: Seed


class Fingerprints(OfFits):
    """Options of the job ``fingerprints``."""

    views: Count
    gates: Place | None


class ArtefactSheet(OfFits):
    """Options of the job ``artefact_sheet``."""

    renders: Count
    side: Annotated[int, Field(ge=32)]
    draws: Count
    seeds: Count
    picture: Place | None


class SamplerStudy(OfFits):
    """Options of the job ``sampler``."""

    generator_weights: Place
    renders: Count


class Ship(Options):
    """Options of the job ``ship``."""

    weights: Place
    name: Annotated[str, Field(pattern=r"^\w+$")]
    first: Place | None
    strength: Share
    helps: str
    harms: str


class BeforeAfter(Options):
    """Options of the job ``before_after``."""

    run: Place
    method: str
    capture: str | None
    quality: Annotated[int, Field(ge=1, le=95)]


class FlowFigure(Options):
    """Options of the job ``flow_figure``."""


class Networks(Options):
    """Options of the job ``networks``."""

    row_table: Group
    paper: bool
    references: Size
    times: bool
    height: Count
    width: Count
    rounds: Count
    records: RecordsFile | None


class Peers(Options):
    """Options of the job ``peers``."""

    device: Literal["auto", "cpu", "cuda"]
    networks: list[str] | None
    dtypes: list[Literal["float32", "bfloat16", "bfloat16 weights"]]
    compiled: bool
    height: Side
    width: Side
    references: Size
    rounds: Count
    cold_rounds: Count
    memory: bool
    family: str
    ours: dict[str, Group]
    published: dict[str, Group]
    pipeline: dict[str, list[PixelSize]]
    records: RecordsFile
    records_only: bool
    quality: RecordsFile
    tried: PixelSize
    page: Place


class Degradation(Options):
    """Options of the job ``degradation``."""

    row_table: Group
    methods: list[str] | None
    overrides: list[str]
    rounds: Annotated[int, Field(ge=2)]
    records: RecordsFile | None


class Similarity(Options):
    """Options of the job ``similarity``."""

    row_table: Group
    height: Count
    width: Count
    rounds: Count
    records: RecordsFile | None


class SplatKernels(Options):
    """Options of the job ``splat_kernels``."""

    row_table: Group
    sizes: list[PixelSize]
    counts: list[Count]
    methods: list[Literal["3dgs", "mip_splatting", "2dgs"]]
    rounds: Count
    cold: bool
    records: RecordsFile | None


class ViewerSpeed(Options):
    """Options of the job ``viewer_speed``."""

    row_table: Group
    run: Place
    show: str
    width: Side
    seconds: Positive
    overrides: list[str]
    picture: Place | None
    records: RecordsFile | None


class VideoSpeed(Options):
    """Options of the job ``video_speed``."""

    row_table: Group
    run: Place
    frames: Annotated[int, Field(ge=2)]
    overrides: list[str]
    rounds: Count
    records: RecordsFile | None


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
    "quality": Quality,
    "tradeoff": Tradeoff,
    "stability": Stability,
    "plan_study": PlanStudy,
    "tables": Tables,
    "pages": Pages,
    "fresh": Fresh,
    "status": Status,
    "report": Report,
    "dashboard": Dashboard,
    "download": Download,
    "candidates": Candidates,
    "guards": Guards,
    "renders": Renders,
    "ibgs": IBGS,
    "convergence": Convergence,
    "distil_study": DistilStudy,
    "depth": DepthStudy,
    "flicker": Flicker,
    "already_good": AlreadyGood,
    "realism": Realism,
    "diversity": Diversity,
    "fingerprints": Fingerprints,
    "artefact_sheet": ArtefactSheet,
    "sampler": SamplerStudy,
    "ship": Ship,
    "before_after": BeforeAfter,
    "flow_figure": FlowFigure,
    "networks": Networks,
    "peers": Peers,
    "degradation": Degradation,
    "similarity": Similarity,
    "splat_kernels": SplatKernels,
    "viewer_speed": ViewerSpeed,
    "video_speed": VideoSpeed,
}
"""The options by job."""


def check_options(job: str, cfg: DictConfig) -> None:
    """Refuse a configuration with an option of another type, or out of bounds. Values not given (``???``) pass.

    Args:
        job: the job's name.
        cfg: its whole configuration.

    Raises:
        InputError: an option is missing, of another type or out of bounds, or refers to what is not there.
    """
    for name, kind in get_type_hints(OPTIONS.get(job, Options), include_extras=True).items():
        if kind == Group | None and name not in cfg:
            continue  # a group of which nothing is chosen
        if name not in cfg and not OmegaConf.is_missing(cfg, name):
            raise InputError(name, f"was taken out of the configuration of {job}", f"leave ~{name} out")
        if not OmegaConf.is_missing(cfg, name):
            check_plain(_value(cfg, name), kind, name)


def _value(cfg: DictConfig, name: str) -> Any:
    try:
        value = cfg[name]
        return OmegaConf.to_container(value, resolve=True) if OmegaConf.is_config(value) else value
    except OmegaConfBaseException as error:
        cause = str(error).splitlines()[0]
        raise InputError(error.full_key or name, f"cannot be resolved: {cause}", "set what it refers to") from error
