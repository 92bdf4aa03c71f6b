"""A folder of results: two tables over small scenes, one of them named to break the page, and the runs behind them."""

import random
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from PIL import Image

from ablations.study.description import MethodDescription, SceneGroup, TableDescription, write_description
from gaussian_enhancer.metrics.records import MISSING, Record, write_records

NASTY = "<script>document.title='broken'</script><img src=x onerror=alert(1)>"
SCENES = ("yard", NASTY)
GAIN = {"ge": 1.0, "gepp": 2.0}

QUALITY = TableDescription(
    name="table_2",
    title="Same resolution, Mip-NeRF 360",
    kind="quality",
    about="as in the paper",
    methods={
        "raw": MethodDescription("raw render", role=""),
        "ge": MethodDescription("GE", train=("+ablation/variant=ge",)),
        "gepp": MethodDescription("GE++", about="the whole of it", train=("+ablation/variant=gepp_lr",)),
    },
    baseline="raw",
    metrics=("psnr", "ssim"),
    splats=("3dgs", "2dgs"),
    datasets={"mip_nerf_360": SceneGroup("Mip-NeRF 360", SCENES, "procedural worlds")},
    seeds=(0, 1),
    paper={"3dgs": {"raw": (28.17, 0.854), "ge": (28.61, 0.856), "gepp": None}},
)

REPEATS = TableDescription(
    name="table_10",
    title="Repeated",
    kind="repeats",
    about="over trainings",
    methods={name: QUALITY.methods[name] for name in ("raw", "gepp")},
    baseline="raw",
    metrics=("psnr", "ssim"),
    splats=("3dgs",),
    datasets={"mip_nerf_360": SceneGroup("Mip-NeRF 360", SCENES)},
    seeds=(0, 1),
    paper={"mip_nerf_360": {"max": (0.92, 0.02), "min": (0.69, 0.014), "mean": (0.81, 0.016), "std": (0.09, 0.002)}},
)


def record(scene: str, splat: str, view: str, method: str, seed: int | None, psnr: float, ssim: float) -> Record:
    where = SCENES.index(scene) if scene in SCENES else 9
    sources = {"fit": f"scene{where}-{splat}"}
    if seed is not None:
        sources |= {"train": f"{method}-seed{seed}", "enhance": f"scene{where}-{splat}-{method}-{seed}"}
    values: dict[str, float | None] = {"psnr": psnr, "ssim": ssim}
    made = {"commit": "0123abc", "machine": "2 cores <b>", "time": f"2026-11-21T10:00:0{seed or 0}+00:00"}
    return Record(
        "quality",
        f"run{where}",
        scene,
        splat,
        view,
        method,
        values,
        {},
        (24, 16),
        "8 bit",
        **made,
        seed=seed,
        sources=sources,
    )


def measured(views: Sequence[str] = ("a.png", "b.png", "c.png")) -> list[Record]:
    """Every row and seed on 3DGS; nothing on 2DGS but a reason."""
    chance = random.Random(0)
    found = []
    for scene in SCENES:
        for view in views:
            raw = record(scene, "3dgs", view, "raw", None, 20 + 5 * chance.random(), 0.5 + 0.2 * chance.random())
            found.append(raw)
            for row, gain in GAIN.items():
                for seed in (0, 1):
                    psnr = (raw.metrics["psnr"] or 0) + gain + 0.1 * seed + 0.3 * chance.random()
                    found.append(record(scene, "3dgs", view, row, seed, psnr, 0.8 + 0.1 * chance.random()))
        found += [
            Record(
                MISSING,
                "",
                scene,
                "2dgs",
                "",
                row,
                {},
                {"row": "is not fitted <yet>"},
                commit="-",
                machine="-",
                time="-",
            )
            for row in QUALITY.methods
        ]
    first = next(index for index, one in enumerate(found) if one.variant == "gepp")
    found[first] = replace(
        found[first], metrics={"psnr": found[first].metrics["psnr"], "ssim": None}, reasons={"ssim": "too small"}
    )
    return found


def write_results(folder: Path, records: Sequence[Record] | None = None) -> Path:
    """The two tables; the second shares its records with the first."""
    records = measured() if records is None else list(records)
    for table in (QUALITY, REPEATS):
        write_description(folder / f"{table.name}.json", table)
        own = [one for one in records if one.variant in table.methods and one.splat in table.splats]
        write_records(folder / f"{table.name}.jsonl", own)
    return folder


def write_runs(runs: Path, *, pictures: bool = True) -> Path:
    """Two trainings of GE++ with logs and settings, one of GE without a log, and an enhanced run of each scene."""
    for seed in (0, 1):
        folder = runs / "train" / f"gepp-seed{seed}"
        (folder / "log").mkdir(parents=True)
        steps = "".join(f"{step},,{1 / (step + 1 + seed)}\n" for step in range(0, 100, 10))
        (folder / "log" / "metrics.csv").write_text(f"step,gain/psnr,train/total\n{steps}99,1.5,\n")
        (folder / "config.yaml").write_text(
            f"seed: {seed}\nfusion: {{widths: [16, 24], refine: {{_target_: a.B}}}}\nlabel: <b>same</b>\n"
            + ("extra: true\n" if seed else "")
        )
    (runs / "train" / "ge-seed0").mkdir(parents=True)
    for where in range(len(SCENES) if pictures else 0):
        side = runs / "enhance" / f"scene{where}-3dgs-gepp-0" / "test" / "ours_30"
        for part, grey in (("renders", 40), ("enhanced", 120), ("gt", 200)):
            for number, view in enumerate(("a.png", "b.png", "c.png")):
                (side / part).mkdir(parents=True, exist_ok=True)
                Image.new("RGB", (24, 16), (grey + where, grey + number, grey)).save(side / part / view)
    return runs
