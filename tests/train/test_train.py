import json
import shutil
import signal
from pathlib import Path

import pytest
import torch
from omegaconf import OmegaConf

from gaussian_enhancer.align.references import ReferenceConfig
from gaussian_enhancer.checkpoint import checkpoint_digest, find_checkpoint
from gaussian_enhancer.cli.train import _network, naming_configuration
from gaussian_enhancer.degrade.simulator import NoSecondStage, Simulator
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.infer.enhancer import SetEnhancer
from gaussian_enhancer.infer.weights import design_of, load_weights, save_weights
from gaussian_enhancer.network.fuse import Trust
from gaussian_enhancer.network.ssif_lr import SSIFLR
from gaussian_enhancer.runs.instantiate import build, require
from gaussian_enhancer.runs.run import result_values
from gaussian_enhancer.scene.renders import read_run
from gaussian_enhancer.train.crops import BalancedDraw
from gaussian_enhancer.train.data import RunsData
from gaussian_enhancer.train.ema import EMA
from gaussian_enhancer.train.metrics import psnr
from gaussian_enhancer.train.optimizers import decayed_groups
from gaussian_enhancer.train.optimizers import optimizer_configuration as made_optimizer
from gaussian_enhancer.train.run_samples import RunSamples, find_runs
from gaussian_enhancer.train.schedule import WarmupCosine
from support.command import run_command
from support.job_config import job_config
from support.paths import CONF


def configured(*overrides: str):
    return job_config("train", *overrides)


def settings(train: Path, validation: Path, runs: Path, *others: str) -> list[str]:
    return [
        f"data.train=[{train}]",
        f"data.validation=[{validation}]",
        f"runs={runs}",
        "trainer=smoke",
        "logger=csv",
        "fusion=sif",
        "fusion.widths=[8,8,8]",
        "data.augmentation.crop=32",
        "data.loading.batch_size=2",
        "data.steps_per_epoch=2",
        "runtime.progress=false",
        "runtime.threads=1",
        *others,
    ]


@pytest.mark.parametrize("alignment", ["none", "deformable", "reprojected", "reprojected_deformable"])
def test_every_alignment_trains_and_its_weights_enhance(alignment, plane_run, other_plane_run, tmp_path):
    from gaussian_enhancer.cli.train import run

    options = settings(plane_run, other_plane_run, tmp_path, f"alignment={alignment}")
    gain = run(configured(*options))
    assert gain is not None
    (weights,) = tmp_path.glob("train/*/weights.safetensors")
    loaded = load_weights(weights)
    assert loaded.card["steps"] == 2
    one = next(SetEnhancer(loaded.network, loaded.reference_config)(read_run(other_plane_run)))
    assert bool(torch.isfinite(one.image).all())
    assert run(configured(*options)) == pytest.approx(gain)


@pytest.mark.parametrize("loss", ["balanced", "charbonnier", "frequency", "relative", "relative_harm"])
def test_every_loss_builds(loss):
    cfg = configured(f"loss={loss}", "data.train=[]", "data.validation=[]")
    image = torch.rand(1, 3, 16, 16)
    total, _ = build(cfg.loss)(image, image.flip(-1), image)
    assert float(total) > 0


@pytest.mark.parametrize("fusion", ["sif", "sif_photos", "sif_undepth", "sif_mean"])
def test_every_fusion_builds(fusion):
    cfg = configured(f"fusion={fusion}", "data.train=[]", "data.validation=[]")
    assert build(cfg.fusion).design


@pytest.mark.parametrize("recipe", sorted(path.stem for path in (CONF / "recipe").glob("*.yaml")))
def test_every_recipe_composes_and_names_no_scene_that_is_kept_for_tests(recipe):
    job = "train_generator" if recipe == "simulator" else "train"
    cfg = job_config(job, f"+recipe={recipe}")
    if job == "train":
        build(cfg.fusion)
    sources = [*cfg.data.train, *cfg.data.validation]
    assert cfg.trainer.max_steps > 0
    assert sources
    kept = ("fox", "monstree", "unbounded_2000", "outdoor_2000", "indoor_2000", "object_2000", "object_3000")
    assert not [one for one in sources for name in kept if Path(f"runs/fit/{name}-3dgs-00000000").match(one)]


MISSING = ["data.train=[]", "data.validation=[]"]


@pytest.mark.parametrize(("gate", "kind"), [("none", "NoGate"), ("all", "AllGate"), ("random", "RandomGate")])
def test_every_gate_becomes_the_simulators(gate, kind):
    cfg = configured(*MISSING, f"gate={gate}", "generator=none", "data.simulation.share=1.0")
    simulator = build(naming_configuration(cfg).data.simulation.simulator)
    assert isinstance(simulator, Simulator)
    assert type(simulator.gate).__name__ == kind
    assert isinstance(simulator.second_stage, NoSecondStage)


def test_a_switch_of_a_gate_reaches_it():
    cfg = configured(*MISSING, "gate=all", "gate.types.blur=false", "data.simulation.share=0.5")
    drawn = build(cfg.data.simulation.simulator).gate.draw(torch.Generator().manual_seed(0))
    assert {"noise", "colour"} < {step.type for step in drawn}
    assert "blur" not in {step.type for step in drawn}
    data = build(cfg.data, samples={"cache": "unused"})
    assert isinstance(data.simulation.simulator, Simulator)
    assert data.simulation.share == 0.5


def test_a_simulator_without_effect_is_neither_built_nor_part_of_the_run(monkeypatch):
    idle = [
        naming_configuration(configured(*MISSING, *other))
        for other in ([], ["gate=all"], ["data.simulation.training_views=true"])
    ]
    assert result_values(idle[0]) == result_values(idle[1]) == result_values(idle[2])
    assert "gate" not in idle[0]
    monkeypatch.setattr(Simulator, "__init__", lambda self, *a, **k: pytest.fail("the simulator was built"))
    assert build(idle[0].data, samples={"cache": "unused"}).simulation is None
    shares = [
        naming_configuration(configured(*MISSING, "data.simulation.share=1.0", f"gate={gate}"))
        for gate in ("all", "random")
    ]
    assert len({str(result_values(cfg)) for cfg in (*shares, *idle)}) == 3


def test_weights_to_begin_with_are_named_by_what_they_hold(tmp_path):
    plainly = naming_configuration(configured(*MISSING))
    assert "initial" not in plainly
    copied = tmp_path / "copied.safetensors"
    copied.write_bytes(find_checkpoint("lr_tiny").read_bytes())
    shipped, copy, other = (
        naming_configuration(configured(*MISSING, f"initial={one}")) for one in ("lr_tiny", copied, "sr_tiny")
    )
    assert result_values(shipped) == result_values(copy)
    assert len({str(result_values(cfg)) for cfg in (plainly, shipped, other)}) == 3


@pytest.mark.parametrize(
    "words",
    [
        ["+recipe=lr_further"],
        ["+recipe=lr_converged"],
        ["+recipe=renders", "+ablation/renders=after_tsds"],
        ["+recipe=renders", "+ablation/renders=after_real"],
    ],
    ids=lambda words: words[-1],
)
def test_a_training_that_goes_on_from_weights_is_refused_without_them(words):
    with pytest.raises(InputError, match="initial: is mandatory"):
        require(configured(*MISSING, *words))
    begun = configured(*MISSING, *words, "initial=lr_tiny")
    require(begun)
    assert naming_configuration(begun).initial == checkpoint_digest(find_checkpoint("lr_tiny"))


def test_training_begins_with_weights_and_its_card_tells_of_them(plane_run, other_plane_run, tmp_path):
    from gaussian_enhancer.cli.train import run

    begun = load_weights("lr_tiny")
    begin = ["fusion=ssif_lr", "fusion.widths=[16,24,32]", "initial=lr_tiny"]
    options = settings(plane_run, other_plane_run, tmp_path, *begin)
    with pytest.raises(InputError, match="widths"):
        run(configured(*options, "fusion.widths=[16,24,40]"))
    # Too small a rate to leave them: what comes out is what was put in.
    run(configured(*options, "trainer.max_steps=1", "optimizer.lr=1.0e-12", "label=kept"))
    (written,) = tmp_path.glob("train/kept-*/weights.safetensors")
    kept = load_weights(written)
    for name, value in begun.network.state_dict().items():
        torch.testing.assert_close(kept.network.state_dict()[name], value)
    assert kept.card["initial"]["run"] == begun.card["run"]
    assert kept.card["initial"]["steps"] == begun.card["steps"]


def test_a_network_that_pools_references_begins_with_weights_that_do_not(tmp_path):
    unpooled = tmp_path / "unpooled.safetensors"
    save_weights(unpooled, SSIFLR((16, 24, 32), (1, 1, 2), fusion=Trust()), ReferenceConfig(), {})
    base = [*MISSING, "fusion=ssif_lr", "size=tiny", f"initial={unpooled}"]
    trust = "{_target_: gaussian_enhancer.network.fuse.Trust, pooled: true}"
    begun, network = (
        load_weights(str(unpooled)).network.state_dict(),
        _network(configured(*base, f"+fusion.fusion={trust}")),
    )
    assert len(begun) < len(network.state_dict())
    for name, value in network.state_dict().items():
        assert torch.equal(value, begun[name]) if name in begun else not value.any(), name
    with pytest.raises(InputError, match="fusion"):
        _network(configured(*base, f"+fusion.fusion={trust.replace('pooled: true', 'pooled: true, heads: 8')}"))


def test_parts_begin_with_weights_of_their_own(tmp_path):
    cascade = ["fusion=cascade", *MISSING]
    cfg = configured(*cascade, "+initial.first=lr_tiny")
    begun, network = load_weights("lr_tiny").network.state_dict(), _network(cfg)
    for name, value in network.first.state_dict().items():
        assert torch.equal(value, begun[name])
    assert not any(value.any() for name, value in network.second.state_dict().items() if name.startswith("tail.head"))
    wider = tmp_path / "wider.safetensors"
    save_weights(wider, SSIFLR((16, 24, 40), (1, 1, 2), fusion=Trust()), ReferenceConfig(), {})
    other = configured(*cascade, f"+initial.first={wider}")
    with pytest.raises(InputError, match="widths"):
        _network(other)
    with pytest.raises(InputError, match="no part of the network"):
        _network(configured(*cascade, "+initial.third=lr_tiny"))
    assert len({str(result_values(naming_configuration(one))) for one in (cfg, other, configured(*cascade))}) == 3


def test_a_part_begins_with_that_part_of_a_cascade():
    cascade = ["fusion=cascade", "size=tiny", *MISSING]
    begun = load_weights("sr_tiny").network.second.state_dict()
    second = _network(configured(*cascade, "+initial.second=sr_tiny")).second.state_dict()
    assert all(torch.equal(value, begun[name]) for name, value in second.items())


def test_a_frozen_network_of_a_cascade_keeps_its_values_and_is_part_of_the_run():
    cascade = ["fusion=cascade", *MISSING]
    frozen, plain = configured(*cascade, "frozen=[first]"), configured(*cascade)
    trained = {name for name, value in _network(frozen).named_parameters() if value.requires_grad}
    assert trained == {name for name, _ in _network(plain).named_parameters() if name.startswith("second.")}
    assert result_values(naming_configuration(frozen)) != result_values(naming_configuration(plain))
    assert "frozen" not in naming_configuration(plain)
    for missing in (configured(*cascade, "frozen=[third]"), configured(*MISSING, "frozen=[gather]")):
        with pytest.raises(InputError, match="no part of the network"):
            _network(missing)


def test_training_on_simulated_renders_writes_a_card(plane_run, other_plane_run, tmp_path):
    from gaussian_enhancer.cli.train import run

    others = ["data.simulation.share=1.0", "data.simulation.training_views=true", "gate=random"]
    run(configured(*settings(plane_run, other_plane_run, tmp_path, *others)))
    (folder,) = tmp_path.glob("train/*")
    card = json.loads((folder / "card.json").read_text())
    assert card["simulated"] == 1.0
    assert card["samples"] == 4 + len(read_run(plane_run).references)
    assert "RandomGate" in (folder / "config.yaml").read_text()


@pytest.mark.slow
def test_training_goes_on_after_a_kill(plane_run, other_plane_run, tmp_path):
    from gaussian_enhancer.cli.train import run

    few = ("trainer.max_steps=10", "save_every=5", "data.steps_per_epoch=4")
    options = settings(plane_run, other_plane_run, tmp_path, *few)
    killed = run_command("train", *options, dies_at_step=7)
    assert killed.returncode == -signal.SIGKILL, killed.stderr
    (checkpoint,) = tmp_path.glob("train/*/last.ckpt")
    assert torch.load(checkpoint, weights_only=True)["global_step"] == 5
    run(configured(*options))
    (file,) = tmp_path.glob("train/*/card.json")
    card = json.loads(file.read_text())
    assert card["steps"] == 10
    assert card["minutes"] is None  # the killed part was not timed
    rows = next(iter(tmp_path.glob("train/*/log/metrics.csv"))).read_text().splitlines()
    assert len(rows) > 1
    run(configured(*(option.replace(str(tmp_path), str(tmp_path / "whole")) for option in options)))
    resumed, uninterrupted = (
        load_weights(next(iter(folder.glob("train/*/weights.safetensors")))).network.state_dict()
        for folder in (tmp_path, tmp_path / "whole")
    )
    assert all(torch.equal(resumed[name], value) for name, value in uninterrupted.items())


def test_draws_are_balanced_over_sources():
    draws = [number for number, _ in BalancedDraw([1, 100], 2000, seed=0)]
    assert 900 < draws.count(0) < 1100
    assert max(draws) > 80
    sampler = BalancedDraw([3, 4], 20, seed=1)
    assert list(sampler) != list(sampler)
    assert list(BalancedDraw([3, 4], 20, seed=1)) == list(BalancedDraw([3, 4], 20, seed=1))


@pytest.mark.parametrize("seen", [0, 7, 19, 20, 33])
def test_draws_go_on_where_training_was_killed(seen):
    whole = BalancedDraw([3, 4], 20, seed=1)
    epochs = [*list(whole), *list(whole)]
    resumed = BalancedDraw([3, 4], 20, seed=1, count_used=lambda: seen)
    assert list(resumed) == epochs[seen : 20 * (seen // 20 + 1)]


def test_what_cannot_be_trained_on_is_refused(plane_run, tmp_path):
    with pytest.raises(InputError, match="no run"):
        find_runs(str(tmp_path / "absent-*"))
    shutil.copytree(plane_run, tmp_path / "run [v2]")
    assert find_runs(str(tmp_path / "run [v2]")) == [tmp_path / "run [v2]"]
    reference_config = build(configured("data.train=[]", "data.validation=[]").reference_config)
    data = RunsData([str(plane_run)], [str(plane_run)], RunSamples(reference_config, tmp_path, progress=False))
    with pytest.raises(InputError, match="both trained and validated"):
        data.setup()


def test_accumulated_gradients_are_refused(plane_run, other_plane_run, tmp_path):
    from gaussian_enhancer.cli.train import run

    options = settings(plane_run, other_plane_run, tmp_path, "+trainer.accumulate_grad_batches=2")
    with pytest.raises(InputError, match="accumulate_grad_batches: is not supported"):
        run(configured(*options))


def test_snapshots_are_all_taken_unless_the_last_alone_is_asked_for(plane_run, other_plane_run, tmp_path):
    reference_config = build(
        configured("data.train=[]", "data.validation=[]", "reference_config.references=0").reference_config
    )
    counts = []
    for snapshots in (True, False):
        samples = RunSamples(reference_config, tmp_path, snapshots=snapshots, progress=False)
        data = RunsData([str(plane_run)], [str(other_plane_run)], samples)
        data.setup()
        counts.append(sum(map(len, data.sources)))
    assert counts == [4, 2]


def test_rate_rises_then_falls_to_zero():
    schedule = WarmupCosine(steps=100, warmup=10)
    factors = [schedule(step) for step in range(101)]
    assert factors[0] == pytest.approx(0.1)
    assert max(factors) > 0.95
    assert factors[-1] == pytest.approx(0, abs=1e-9)


def test_the_defaults_are_what_is_shipped():
    cfg = configured(*MISSING)
    shipped = load_weights("lr_tiny").network
    assert design_of(build(cfg.fusion)) == design_of(shipped)
    assert set(cfg.loss.terms) == {"squared", "charbonnier", "dssim"}


@pytest.mark.parametrize("optimizer", ["adamw", "adam"])
@pytest.mark.parametrize("lr_scheduler", ["warmup_cosine", "cosine", "one_cycle", "constant"])
def test_every_optimizer_and_schedule_builds(optimizer, lr_scheduler):
    cfg = configured(*MISSING, f"optimizer={optimizer}", f"lr_scheduler={lr_scheduler}", "trainer.max_steps=20")
    network = torch.nn.Sequential(torch.nn.Conv2d(3, 4, 3), torch.nn.GroupNorm(2, 4))
    made = made_optimizer(decayed_groups(network.parameters()), build(cfg.optimizer), build(cfg.lr_scheduler), "a")
    convolutions, others = made["optimizer"].param_groups
    assert [len(group["params"]) for group in (convolutions, others)] == [1, 3]
    assert others["weight_decay"] == 0
    for _ in range(20):
        made["optimizer"].step()
        made["lr_scheduler"]["scheduler"].step()
    assert made["lr_scheduler"]["interval"] == "step"


def test_a_group_of_choices_is_any_class_of_torch():
    words = ["optimizer._target_=torch.optim.SGD", "~optimizer.betas", "+optimizer.momentum=0.5"]
    cfg = configured(*MISSING, *words, "lr_scheduler=constant")
    made = build(cfg.optimizer)(torch.nn.Linear(2, 2).parameters())
    assert isinstance(made, torch.optim.SGD)
    assert made.param_groups[0]["momentum"] == 0.5


def test_the_average_is_that_of_its_formula():
    average, value = torch.zeros(3), torch.ones(3)
    rule, expected = EMA(decay=0.9), 0.0
    for updates in range(1, 120):
        decay = min(0.9, (updates + 2) / (updates + 11))
        expected = decay * expected + (1 - decay)
        rule([average], [value], torch.tensor(updates))
    torch.testing.assert_close(average, torch.full((3,), expected))
    assert (1 + 2) / (1 + 11) < 0.9


def test_callbacks_of_the_user_are_called_beside_the_groups_own(plane_run, other_plane_run, tmp_path):
    """They were replaced in silence."""
    from gaussian_enhancer.cli.train import run

    added = "+trainer.callbacks=[{_target_: lightning.pytorch.callbacks.LearningRateMonitor, logging_interval: step}]"
    further = "+callbacks.timer={_target_: lightning.pytorch.callbacks.Timer, duration: '01:00:00:00'}"
    schedule = [
        "trainer.max_steps=2",
        "save_every=1",
        "lr_scheduler.lr_lambda.warmup=2",
        "optimizer.lr=0.5",
        "profiler=simple",
    ]
    assert run(configured(*settings(plane_run, other_plane_run, tmp_path, added, further, *schedule))) is not None
    (folder,) = tmp_path.glob("train/*")
    header, *rows = (folder / "log/metrics.csv").read_text().splitlines()
    assert "lr-AdamW" in header
    assert any(",0.25" in f",{row}" or row.startswith("0.25") for row in rows)  # half of 0.5 in the first step
    checkpoint = torch.load(folder / "last.ckpt", weights_only=True)
    assert {"Timer", "WeightAveraging"} <= {name.split("{")[0] for name in checkpoint["callbacks"]}
    assert "train_dataloader_next" in next(folder.glob("fit-profile*")).read_text()


def test_psnr_is_known():
    assert float(psnr(torch.zeros(1, 3, 4, 4), torch.full((1, 3, 4, 4), 0.1))) == pytest.approx(20, abs=1e-4)
    assert OmegaConf.is_config(configured("data.train=[]", "data.validation=[]"))
