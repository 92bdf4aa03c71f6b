"""The benchmark beside published networks: its parts, its page, and how much slower than a convolution ours may get."""

import time
from dataclasses import replace

import pytest
import torch
from omegaconf import OmegaConf
from torch import nn

from ablations.benchmarks import peers
from ablations.benchmarks.peer_networks import (
    CAST,
    BytesMoved,
    Peer,
    built,
    enhancement,
    names,
    work,
    yardsticks,
)
from ablations.benchmarks.pipeline_parts import PARTS, READ, REST, PartTimer, clocked_parts, write_clocked
from ablations.benchmarks.synthetic_views import read_views, synthetic_views, write_views
from ablations.benchmarks.trials import trials
from ablations.report.performance import (
    COLD,
    COMMAND,
    ENHANCEMENT,
    IMPORTS,
    NETWORK,
    PIPELINE,
    TARGETS,
    TRIED,
    YARDSTICK,
    PageRecords,
    Target,
    gains,
    performance_page,
    performance_plot,
    times_ours,
)
from ablations.study.cost import times_faster
from ablations.study.missing import missing_record
from ablations.suite.costs import plane
from ablations.tradeoff.summary import HIGH, LOW, TIME
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.infer.enhancer import SetEnhancer
from gaussian_enhancer.infer.options import EnhancementOptions
from gaussian_enhancer.infer.planner import Planner
from gaussian_enhancer.infer.weights import load_weights
from gaussian_enhancer.metrics.cost import Timing, time_interleaved
from gaussian_enhancer.metrics.records import Record, read_records
from support.job_config import initialised, job_config

CPU = torch.device("cpu")


def small_views(height: int, width: int, family: str = "", finer: bool = False):
    """A textured plane instead of a scene that has to be baked."""
    return plane(height, width, 4 if finer else 1)


def of_weights(name: str = "lr_tiny") -> Peer:
    pretrained = load_weights(name)
    network = pretrained.network.eval().to(memory_format=torch.channels_last)
    return Peer(name, network, pretrained.network.scale, pretrained)


def test_views_come_back_from_their_folder(tmp_path) -> None:
    views = plane(24, 32, 4)
    write_views(views, tmp_path)
    found = read_views(tmp_path)
    assert [view.name for view in found.references] == [view.name for view in views.references]
    for one, other in zip((*views.targets, *views.references), (*found.targets, *found.references), strict=True):
        assert torch.equal(one.read_depth(), other.read_depth())
        assert torch.allclose(one.read_fine_photo(), other.read_fine_photo(), atol=0.5 / 255 + 1e-6)
        assert torch.allclose(one.camera.world_to_camera, other.camera.world_to_camera, atol=1e-5)


@pytest.mark.slow
def test_synthetic_views_lose_half_their_resolution_and_keep_depth() -> None:
    views = synthetic_views(48, 64, "object", finer=True)
    (target,) = views.targets
    assert len(views.references) == 5
    assert target.name not in {view.name for view in views.references}
    assert target.read_fine_photo().shape == (3, 192, 256)
    assert target.read_depth().max() > 0
    assert target.read() is target.read()
    detail = [(image - image.roll(1, -1)).abs().mean() for image in (target.read(), target.read_photo())]
    assert detail[0] < 0.9 * detail[1]


def test_bytes_are_those_of_operations_without_views() -> None:
    image = torch.ones(10, 10)
    with BytesMoved() as counter:
        _ = (image + image.t()).view(100)
    assert counter.count == 3 * 400


class Doubled(nn.Module):
    def __init__(self) -> None:
        super().__init__()
        self.conv = nn.Conv2d(3, 3, 1, bias=False)

    def forward(self, image: torch.Tensor) -> torch.Tensor:
        return nn.functional.interpolate(self.conv(image), scale_factor=2)


def test_work_is_for_a_pixel_of_the_image_that_comes_out() -> None:
    peer = Peer("doubled", Doubled(), 2)
    operations, moved = work(peer, "float32", 0, side=16)
    assert operations == 9 / 4
    halves = [work(peer, name, 0, side=16)[1] for name in ("float32", CAST)]
    assert moved == halves[0]
    assert halves[0] == pytest.approx(2 * halves[1])


def test_a_published_network_is_built_by_its_path_and_one_that_is_missing_is_refused() -> None:
    published = {"one": {"_target_": "torch.nn.Conv2d", "in_channels": 3, "out_channels": 3, "kernel_size": 1}}
    cfg = OmegaConf.create({"ours": {}, "published": published, "networks": None})
    assert names(cfg) == ("one",)
    assert built(cfg, "one", CPU).scale == 1
    cfg.published.two = {"_target_": "no_such_package.Network"}
    with pytest.raises(InputError, match="nox -s bench"):
        built(cfg, "two", CPU)
    with pytest.raises(InputError, match="choose among one, two"):
        names(OmegaConf.merge(cfg, {"networks": ["three"]}))


def test_every_network_of_ours_is_built_and_computes() -> None:
    with initialised():
        from hydra import compose

        cfg = compose("peers")
        assert compose("peers", ["device=cuda"]).runtime.device == "cuda"
        for name in cfg.ours:
            peer = built(cfg, name, CPU)
            image = peers.forward(peer, "bfloat16", 32, 32, cfg.references)()
            assert image.shape == (1, 3, 32 * peer.scale, 32 * peer.scale)


@pytest.mark.parametrize("name", ["lr_tiny", "sr_tiny"])
def test_clocks_change_no_image_and_parts_add_up_to_the_whole(tmp_path, name: str) -> None:
    views, peer, timer = plane(64, 96, 4 if name == "sr_tiny" else 1), of_weights(name), PartTimer(CPU)
    enhance = enhancement(peer, "float32", views, CPU)
    with clocked_parts(timer), timer.lap("view"):
        began = time.perf_counter()
        clocked = enhance()
        write_clocked(clocked, tmp_path / "image.png")
        taken = 1e3 * (time.perf_counter() - began)
    options = EnhancementOptions(precision="float32")
    config = options.reference_config(peer.pretrained, "surface")
    enhancer = options.enhancer(peer.pretrained, config)
    assert isinstance(enhancer, SetEnhancer)
    (one,) = enhancer(views, Planner(options.rules, config, views))
    assert torch.equal(clocked, one.image)
    (lap,) = timer.laps["view"]
    used = {part for part, value in lap.items() if value > 0}
    aligning, limiting = (
        {"search depth", "warp", "check and rank", "align, the rest"},
        {"clamp colours", "complete colours"},
    )
    assert used == {READ, "plan", *aligning, "network", *limiting, "confidence", "write", REST}
    assert sum(lap.values()) == pytest.approx(taken, rel=0.05, abs=1)
    assert set(lap) == {*PARTS, REST}
    enhance()
    assert len(timer.laps["view"]) == 1


def test_a_part_within_a_part_is_its_own(monkeypatch) -> None:
    now = iter(range(100))
    timer = PartTimer(CPU)
    monkeypatch.setattr(timer, "_now", lambda: next(now))
    inner = timer.around("network", lambda: None)
    outer = timer.around("plan", lambda: (inner(), inner()))
    with timer.lap("a"):
        outer()
    assert (timer.laps["a"][0]["network"], timer.laps["a"][0]["plan"]) == (2, 3)
    assert timer.laps["a"][0][REST] == 2


def test_a_graphics_card_is_waited_for_at_both_ends(monkeypatch) -> None:
    waited: list[object] = []
    monkeypatch.setattr(torch.cuda, "synchronize", waited.append)
    timer = PartTimer(torch.device("cuda"))
    with timer.lap("a"):
        timer.around("network", lambda: None)()
    assert len(waited) == 4
    waited.clear()
    time_interleaved({"a": lambda: None, "b": lambda: None}, repeats=3, warm_up=0, device="cuda")
    assert len(waited) == 2 * 2 * 3


def test_a_time_is_also_a_ratio_within_the_round() -> None:
    own, yardstick = Timing(20.0, (10.0, 20.0, 60.0)), Timing(5.0, (5.0, 5.0, 20.0))
    found = peers._time(own, 0.5, yardstick)
    assert (found[TIME], found[LOW], found[HIGH]) == (40.0, 30.0, 80.0)
    assert (found["yardsticks"], found["yardsticks_low"], found["yardsticks_high"]) == (3.0, 2.0, 4.0)


def some_records() -> tuple[Record, ...]:
    common = {
        "parameters": 1e6, "scale": 1.0, "giga_multiply_adds_per_megapixel": 10.0, "gigabytes_per_megapixel": 2.0,
        TIME: 100.0, LOW: 90.0, HIGH: 120.0, "yardsticks": 2.0, "peak_memory_mb": 300.0,
    }  # fmt: skip

    def against(times: float) -> dict[str, float]:
        return {**common, "times_ours": times, "times_ours_low": times - 1, "times_ours_high": times + 1}

    def pipeline(size: tuple[int, int], each: float, network: float) -> Record:
        values = {"scale": 1.0, "milliseconds": 250.0, "decoded_milliseconds": 200.0, TIME: each, LOW: each, HIGH: each}
        values |= {"yardsticks": 3.0, "part: read": 50.0, "part: network": network, "part: write": 200.0 - network}
        return Record(PIPELINE, "", "", "", "", "lr_tiny", values, size=size)

    rates = {"convolution, bfloat16": 1000.0, "convolution, float32": 250.0, "copy": 10.0}
    return (
        *(Record(YARDSTICK, "", "", "", "GB", name, {"milliseconds": 1.0, "a_second": r}) for name, r in rates.items()),
        Record(NETWORK, "", "ours", "bfloat16", "", "lr_tiny", against(0.5), size=(256, 256)),
        Record(ENHANCEMENT, "", "ours", "bfloat16", "", "lr_tiny", against(1.0), size=(256, 256)),
        Record(NETWORK, "", "published", "bfloat16", "", "NAFNet-w32", against(30.0), size=(256, 256)),
        Record(NETWORK, "", "published", "bfloat16 weights", "", "NAFNet-w32", against(14.0), size=(256, 256)),
        Record(NETWORK, "", "published", "float32", "", "NAFNet-w32", against(2.0), size=(256, 256)),
        missing_record("SCUNet", "RuntimeError: mixes types", splat="bfloat16 weights", view=NETWORK),
        pipeline((320, 240), 2000.0, 150.0),
        pipeline((1008, 756), 210.0, 120.0),
        pipeline((2304, 1728), 300.0, 180.0),
        *(Record(COLD, "", "", "", "", n, {"milliseconds": v, LOW: v, HIGH: v}, size=(320, 240))
          for n, v in ((COMMAND, 2500.0), (IMPORTS, 1500.0))),
    )  # fmt: skip


def quality(table: str = "lr/", **psnr: float) -> tuple[Record, ...]:
    return tuple(
        Record("quality", "", "scene", "3dgs", f"{view}.png", f"{table}{name}", {"psnr": value + view})
        for name, value in psnr.items()
        for view in range(2)
    )


def lines_of(page: str) -> dict[str, list[str]]:
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in page.splitlines() if line.startswith("|")]
    return {row[0]: row[1:] for row in reversed(rows)}


def test_the_page_states_verdicts_bounds_and_what_is_missing(tmp_path) -> None:
    tried = Record(TRIED, "", "", "kept", "less", "a copy less", {
        "before": 10.0, "after": 5.0, "times": 2.0, "times_low": 1.9, "times_high": 2.1,
    })  # fmt: skip
    shipped, trained = quality(raw=20.0, lr_tiny=21.5), quality("", raw=20.0, nafnet=20.5, ssif_lr=21.0)
    sources = PageRecords((*some_records(), tried), shipped, trained)
    files = {name: tmp_path / f"results/{name}.jsonl" for name in PageRecords.FILES}
    page = performance_page(sources, files, tmp_path / "results/peers.svg", tmp_path / "page.md")
    lines = lines_of(page)
    assert lines["`lr_tiny` at 1008x756, decoded images to a file"] == [
        "at most 220 ms / MP", "210 ms / MP", "met", "network 60%, write 40%",
    ]  # fmt: skip
    assert lines["`lr_tiny` at 320x240, decoded images to a file"][1:3] == ["200 ms", "**missed**"]
    assert lines["start of `enhance` to its first image"][1:] == [
        "2,500 ms", "**missed**", "`import torch` alone takes 1,500 ms",
    ]  # fmt: skip
    assert lines["largest over least time a megapixel, from 0.25 megapixels on"][1:3] == ["1.43", "**missed**"]
    assert lines["`lr_tiny`, times as fast as NAFNet-w32"][1:3] == ["14", "**missed**"]
    assert lines["`lr_tiny`, times as fast as Restormer"][1:3] == ["not measured", ""]
    assert lines["PSNR beyond `nafnet` at equal budget"][1:3] == ["0.5 dB", "met"]
    assert lines["NAFNet-w32"][7:9] == ["10", "200"]
    assert lines["a copy less"] == ["less", "10 ms", "5 ms", "2 [1.9, 2.1]", "kept"]
    assert "`SCUNet`, bfloat16 weights: RuntimeError: mixes types" in page
    assert "](results/peers.svg)" in page
    assert "nothing on this page was measured on one" in page
    svg = performance_plot(sources)
    assert "+1.50 dB" in svg
    assert "nafnet" not in svg  # its time is not known


def test_our_network_with_the_papers_choices_is_not_called_the_paper(tmp_path) -> None:
    trained = quality("", raw=20.0, paper=20.02, ssif_lr=21.0)
    measured = [replace(r, variant="paper") if r.variant == "lr_tiny" else r for r in some_records()]
    sources = PageRecords(tuple(measured), (), trained)
    files = {name: tmp_path / f"results/{name}.jsonl" for name in PageRecords.FILES}
    page = performance_page(sources, files, tmp_path / "results/peers.svg", tmp_path / "page.md")
    assert "\n| ours with the paper's choices | +0.02 |" in page
    assert "| ours with the paper's choices | ours | network |" in page
    assert "`paper`" not in page.split("## Networks")[1].split("\n## The whole pipeline")[0]
    assert "ours with the paper's choices, +0.02 dB" in performance_plot(sources)


def test_a_page_without_records_says_so_everywhere(tmp_path) -> None:
    files = {name: tmp_path / f"{name}.jsonl" for name in PageRecords.FILES}
    page = performance_page(PageRecords(), files, tmp_path / "a.svg", tmp_path / "page.md")
    assert all(target.line(PageRecords())[2] == "not measured" for target in TARGETS)
    assert page.count("Not measured yet") == 6
    assert "nothing was measured" in performance_plot(PageRecords())


def test_a_card_is_named_where_one_was_measured(tmp_path) -> None:
    records = tuple(replace(one, protocol="GPU: medians", machine="a card") for one in some_records())
    files = {name: tmp_path / f"{name}.jsonl" for name in PageRecords.FILES}
    assert "Measured on a card." in performance_page(
        PageRecords(records), files, tmp_path / "a.svg", tmp_path / "page.md"
    )


def test_gains_and_ratios_are_of_the_rows_that_are_there() -> None:
    assert gains(PageRecords(equal_budget=quality("", nafnet=20.0))) == {}
    shipped, trained = quality(raw=21.0, lr_tiny=21.5), quality("", raw=20.0, sif=21.25)
    assert gains(PageRecords(quality=shipped, equal_budget=trained)) == {"sif": 1.25, "lr_tiny": 0.5}
    assert times_ours(PageRecords(some_records()), "NAFNet-w32") == 14.0  # float32 is not what ours is measured in
    assert times_ours(PageRecords(some_records()), "Restormer") is None


@pytest.mark.parametrize(
    ("most", "value", "verdict"), [(True, 1.0, "met"), (True, 1.1, "**missed**"), (False, 0.9, "**missed**")]
)
def test_a_target_is_met_up_to_its_limit(most: bool, value: float, verdict: str) -> None:
    assert Target("", 1.0, "", lambda _: value, lambda _: "", most).line(PageRecords())[3] == verdict


def test_the_job_measures_and_makes_its_page_and_makes_it_again(tmp_path, job, monkeypatch) -> None:
    monkeypatch.setattr(peers, "synthetic_views", small_views)
    monkeypatch.setattr(peers, "SMALL", (48, 64))
    records, page = tmp_path / "peers.jsonl", tmp_path / "page.md"
    outputs = (
        f"records={records}",
        f"page={page}",
        f"quality={tmp_path}/none.jsonl",
        f"equal_budget={tmp_path}/none.jsonl",
    )
    few = ("networks=[lr_tiny,nafnet]", "dtypes=[float32]", "height=64", "width=64", "rounds=2", "cold_rounds=1")
    sizes = ("pipeline.lr_tiny=[64x48]", "pipeline.sr_tiny=[]")
    monkeypatch.setattr(peers, "cold_records", lambda *_: iter(()))
    job("peers", *outputs, *few, *sizes, "memory=false", "device=cpu", "tried=64x48")
    found = read_records(records)
    kinds = [(one.kind, one.variant) for one in found if one.kind not in (YARDSTICK, TRIED)]
    assert kinds == [
        (NETWORK, "lr_tiny"), (ENHANCEMENT, "lr_tiny"), (NETWORK, "nafnet"), (ENHANCEMENT, "nafnet"),
        (PIPELINE, "lr_tiny"),
    ]  # fmt: skip
    first = next(one for one in found if one.kind == NETWORK)
    assert first.metrics["giga_multiply_adds_per_megapixel"] == pytest.approx(34.35, abs=0.1)
    assert sum(one.kind == TRIED for one in found) == 14
    pipeline = next(one for one in found if one.kind == PIPELINE).metrics
    assert pipeline["part: read"] > 0
    assert pipeline["part: write"] > 0
    assert pipeline["milliseconds"] > pipeline["decoded_milliseconds"] > 0
    text = page.read_text()
    page.unlink()
    job("peers", *outputs, "records_only=true")
    assert page.read_text() == text
    assert (tmp_path / "peers.svg").is_file()


def test_a_part_of_the_networks_does_not_replace_the_committed_records() -> None:
    few = ("networks=[lr_tiny]", "page=page.md")
    with pytest.raises(InputError, match=r"networks: names a part, but all records in docs/results/peers\.jsonl"):
        peers.study(job_config("peers", *few), torch.device("cpu"))
    for elsewhere in ("records=found.jsonl", "records_only=true"):
        assert peers.study(job_config("peers", *few, elsewhere), torch.device("cpu")).replaces_file


def tensors(found: torch.Tensor | tuple[torch.Tensor, ...]) -> tuple[torch.Tensor, ...]:
    return (found,) if isinstance(found, torch.Tensor) else found


def test_both_ways_of_a_trial_give_the_same() -> None:
    photo = plane(48, 64).targets[0].read_photo()
    found = list(trials(48, 64, photo))
    assert [one.kept for one in found].count(False) == 1
    for one in (one for one in found if "PNG" not in one.change):  # those write files; tests/scene/test_png.py
        for before, after in zip(*map(tensors, (one.before(), one.after())), strict=True):
            assert before.shape == after.shape
            assert torch.allclose(before, after, atol=1e-6)
            layouts = {value.is_contiguous(memory_format=torch.channels_last) for value in (before, after)}
            assert before.ndim != 4 or len(layouts) == 1


@pytest.mark.slow
def test_peaks_are_of_a_process_of_their_own_and_the_command_line_starts(tmp_path, monkeypatch) -> None:
    from ablations.benchmarks.peak_above_imports import enhancement_peak, network_peak

    write_views(plane(48, 64), tmp_path / "small")
    write_views(plane(192, 256), tmp_path / "large")
    with initialised():
        from hydra import compose

        cfg = compose("peers", ["runtime.threads=1", "cold_rounds=1", "height=256", "width=256", "device=cpu"])
        one, two = (network_peak(cfg, name, "float32") for name in ("lr_tiny", "edvr, base"))
        assert 2 < one < two < 1000
        large = enhancement_peak(cfg, "lr_tiny", "float32", tmp_path / "large", tmp_path / "small")
        assert 2 < large < 1000
        cold = {record.variant: record for record in peers.cold_records(cfg, tmp_path / "small", tmp_path)}
    assert (tmp_path / "first/0.png").is_file()
    assert cold[COMMAND].metrics["milliseconds"] > cold[IMPORTS].metrics["milliseconds"] > 100


@pytest.mark.slow
@pytest.mark.parametrize(("whole", "most"), [(False, 5.0), (True, 10.0)])
def test_ours_is_at_most_so_many_times_a_convolution(whole: bool, most: float) -> None:
    """Guards against changes that make enhancement much slower; the machine's own speed cancels."""
    peer = of_weights()
    call = enhancement(peer, "float32", plane(256, 256), CPU) if whole else peers.forward(peer, "float32", 256, 256, 3)
    yardstick = next(found for name, found, *_ in yardsticks(CPU) if name == "convolution, float32")
    times = time_interleaved({"ours": call, "yardstick": yardstick}, repeats=5, warm_up=2)
    ratio, *_ = times_faster(times["yardstick"], times["ours"])
    assert ratio < most
