"""Types and bounds of the options of this package's jobs. The command line validates them like all other options."""

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field

from gaussian_enhancer.cli.options import (
    Count,
    Group,
    NonNegative,
    NonNegativeInt,
    Options,
    PathText,
    PathTexts,
    Positive,
    Scalar,
    Seed,
    Share,
    Shared,
    Side,
)
from gaussian_enhancer.runs.lock import RECORDS


def _records(path: str) -> str:
    if not path.endswith(RECORDS):
        raise ValueError(f"a file that ends in {' or '.join(RECORDS)}")
    return path


RecordsFile = Annotated[PathText, AfterValidator(_records)]
PixelSize = Annotated[str, Field(pattern=r"^[1-9]\d*x[1-9]\d*$")]


class Measurement(Options):
    """Options of measurements that print a row table."""

    row_table: Group
    records: RecordsFile | None


class Distances(Shared):
    """Options of jobs that also measure LPIPS."""

    lpips: list[str]
    backbones: PathText | None


class OfFits(Shared):
    """Options of measurements of finished fits."""

    row_table: Group
    runs: PathTexts
    records: RecordsFile | None


class OfViews(OfFits, Distances):
    """Options of measurements of every n-th held-out view of finished fits."""

    every: Count


class FromRecords(Distances):
    """Options of jobs that measure runs and make a page from the records."""

    row_table: Group
    runs: PathTexts
    records: RecordsFile
    page: PathText | None


class Dashboard(Options):
    """Options of the job ``dashboard``."""

    folder: PathText
    title: Scalar | None
    studies: dict[str, Any]
    images_per_scene: NonNegativeInt


class PlanStudy(Options, Distances):
    """Options of the job ``plan_study``."""

    worlds: Group
    weights: PathText
    repeats: Count
    fit_missing: bool
    records_only: bool
    baseline: str
    shown: str
    faster: Positive
    slower: Positive
    allowed: NonNegative
    title: str
    about: str
    results: PathText
    markdown: PathText


class Quality(Options, Distances):
    """Options of the job ``quality``."""

    scenes: list[str] | None
    splat_choices: list[str]
    splats: list[str] | None
    fit: list[str]
    fit_missing: bool
    records_only: bool
    groups: Group
    not_super_resolved: list[str]
    super_resolved_every: Count
    tables: Group
    title: str
    about: str
    pages: PathText
    markdown: PathText
    records: RecordsFile


class Stability(Options):
    """Options of the job ``stability``."""

    families: list[str] | None
    cases: list[str] | None
    order: Group
    records_only: bool
    records: RecordsFile
    markdown: PathText


class Status(Options):
    """Options of the job ``status``."""

    scale: Group
    table: Scalar | list[Scalar] | None
    states: list[str] | None
    backbones: PathText | None


class Pages(Options):
    """Options of the job ``pages``."""

    write: bool


class Fresh(Options):
    """Options of the job ``fresh``."""

    strict: bool
    inputs: dict[str, list[str]]
    pages: dict[str, Group]
    tables: list[str]
    historical: dict[str, str]


class Tables(Options):
    """Options of the job ``tables``."""

    scale: Group
    table: Scalar | list[Scalar]
    dry_run: bool
    workers: Count | None
    scheduler: str | None
    records_only: bool
    fit_missing: bool
    train_missing: bool
    results: PathText
    backbones: PathText | None


class Tradeoff(Options, Distances):
    """Options of the job ``tradeoff``."""

    kind: Literal["quality", "training", "numerics", "all"]
    records_only: bool
    fit_missing: bool
    train_missing: bool
    minutes: Positive
    studies: list[str] | None
    settings: PathText | None
    scale: Group
    curves: Group
    tradeoff: Group
    training: Group
    numerics: Group
    markdown: PathText
    results: PathText


class Candidates(OfViews):
    """Options of the job ``candidates``."""

    weights: PathTexts


class Guards(Candidates):
    """Options of the job ``guards``."""

    guard: Literal["photo_consistency", "colour_clamping", "strength"]


class Renders(OfViews):
    """Options of the job ``renders``."""

    rows: list[str]
    folder: PathText


class IBGS(Options):
    """Options of the job ``ibgs``."""

    fit: PathText
    step: Count | None
    settings: Group
    choice: Group


class Convergence(FromRecords):
    """Options of the job ``convergence``."""

    methods: list[str]
    tests: PathTexts
    last: bool
    ibgs: PathTexts
    second: PathTexts
    pictures: PathText | None


class DistilStudy(FromRecords):
    """Options of the job ``distil_study``."""

    weights: PathText


class DepthStudy(OfViews):
    """Options of the job ``depth``."""

    weights: PathText
    strength: Share


class LeaveOneOut(OfFits):
    """Options of the job ``leave_one_out``."""

    weights: PathText
    confidence: bool
    every: Count
    page: PathText | None


class Flicker(OfFits):
    """Options of the job ``flicker``."""

    weights: PathText
    frames: Annotated[int, Field(ge=2)]
    cameras: Annotated[int, Field(ge=2)]
    strength: Share | None
    temporal_smoothing: list[Share]
    hysteresis: list[Annotated[float, Field(gt=0, le=1)]]


class AlreadyGood(OfFits):
    """Options of the job ``already_good``."""

    weights: PathText
    views: Count


class Realism(Measurement):
    """Options of the job ``realism``."""

    train: PathTexts
    test: PathTexts
    rows: list[str]
    generator_weights: PathText | None
    steps: Count
    seeds: Count
    seed: Seed
    renders: Count
    patches: Count
    patch_size: Count


class Diversity(OfFits):
    """Options of the job ``diversity``."""

    rows: list[str]
    generator_weights: PathText | None
    seed: Seed


class Fingerprints(OfFits):
    """Options of the job ``fingerprints``."""

    views: Count
    gates: PathText | None


class ArtefactSheet(OfFits):
    """Options of the job ``artefact_sheet``."""

    renders: Count
    side: Annotated[int, Field(ge=32)]
    draws: Count
    seeds: Count
    picture: PathText | None


class SamplerStudy(OfFits):
    """Options of the job ``sampler``."""

    generator_weights: PathText
    renders: Count


class Ship(Options):
    """Options of the job ``ship``."""

    weights: PathText
    name: Annotated[str, Field(pattern=r"^\w+$")]
    first: PathText | None
    card: dict[str, Any]
    references: NonNegativeInt | None
    candidates: Count | None
    strength: Share
    helps: str
    harms: str


class BeforeAfter(Options):
    """Options of the job ``before_after``."""

    run: PathText
    method: str
    capture: str | None
    crop: Literal["changed", "worst"]
    quality: Annotated[int, Field(ge=1, le=95)]


class Networks(Measurement):
    """Options of the job ``networks``."""

    paper: bool
    references: NonNegativeInt
    times: bool
    height: Count
    width: Count
    rounds: Count


class Peers(Options):
    """Options of the job ``peers``."""

    device: Literal["auto", "cpu", "cuda"]
    networks: list[str] | None
    dtypes: list[Literal["float32", "bfloat16", "bfloat16 weights"]]
    height: Side
    width: Side
    references: NonNegativeInt
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
    equal_budget: RecordsFile
    tried: PixelSize
    page: PathText


class Degradation(Measurement):
    """Options of the job ``degradation``."""

    methods: list[str] | None
    overrides: list[str]
    rounds: Annotated[int, Field(ge=2)]


class Similarity(Measurement):
    """Options of the job ``similarity``."""

    height: Count
    width: Count
    rounds: Count


class SplatKernels(Measurement):
    """Options of the job ``splat_kernels``."""

    sizes: list[PixelSize]
    counts: list[Count]
    methods: list[Literal["3dgs", "mip_splatting", "2dgs"]]
    rounds: Count


class ViewerSpeed(Measurement):
    """Options of the job ``viewer_speed``."""

    run: PathText
    show: str
    width: Side
    seconds: Positive
    overrides: list[str]
    picture: PathText | None


class VideoSpeed(Measurement):
    """Options of the job ``video_speed``."""

    run: PathText
    frames: Annotated[int, Field(ge=2)]
    overrides: list[str]
    rounds: Count


OPTIONS: Mapping[str, type[Shared]] = {
    "quality": Quality,
    "tradeoff": Tradeoff,
    "stability": Stability,
    "plan_study": PlanStudy,
    "tables": Tables,
    "pages": Pages,
    "fresh": Fresh,
    "status": Status,
    "dashboard": Dashboard,
    "candidates": Candidates,
    "guards": Guards,
    "renders": Renders,
    "ibgs": IBGS,
    "convergence": Convergence,
    "leave_one_out": LeaveOneOut,
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
    "flow_figure": Options,
    "networks": Networks,
    "peers": Peers,
    "degradation": Degradation,
    "similarity": Similarity,
    "splat_kernels": SplatKernels,
    "viewer_speed": ViewerSpeed,
    "video_speed": VideoSpeed,
}
"""The class of options of each job."""
