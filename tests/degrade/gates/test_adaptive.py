import json
import math

import pytest
import torch

from gaussian_enhancer.degrade.artefact_types import TYPES
from gaussian_enhancer.degrade.artefacts.view import View
from gaussian_enhancer.degrade.gates.adaptive import (
    AdaptiveGate,
    Growth,
    MixedGate,
    adaptive_gate,
    calibrate_gate,
    calibrate_on_splat,
)
from gaussian_enhancer.degrade.gates.calibration import (
    MIN_RELATIVE_ENERGY,
    ROUNDING,
    STRENGTHS,
    Responses,
    measure_responses,
    solve_gate,
    solve_weights,
)
from gaussian_enhancer.degrade.gates.fingerprint import ENERGIES, Fingerprint, measure_fingerprint
from gaussian_enhancer.degrade.gates.gate import RandomGate
from gaussian_enhancer.degrade.simulator import Simulator
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.scene.rendered import RenderedSet, RenderedView
from support.textured_photo import textured_photo

TESTED = ("blur", "noise", "cloudy", "floater")
SWITCHES = {name: name in TESTED for name in TYPES}
SIZE = (48, 64)


PHOTOS = [(textured_photo(SIZE, seed, layers=5) * 255).round() / 255 for seed in range(4)]


def simulated(gate, count, seed):
    """Pairs of simulated renders and their photos."""
    photos = [PHOTOS[i % len(PHOTOS)] for i in range(count)]
    done = Simulator(gate)(View(torch.stack(photos)), torch.Generator().manual_seed(seed))
    return list(done.image), photos


def only(chances, limits=None):
    return AdaptiveGate(chances, limits or {}, types=SWITCHES)


@pytest.fixture(scope="module")
def measured():
    return measure_responses(PHOTOS, TESTED, torch.Generator().manual_seed(0), regional=0.5, draws=8)


def contributions(measured, chances, limits):
    return chances[:, None] * measured.mean_below(limits)


@pytest.mark.parametrize("known", TESTED)
def test_the_known_type_gets_by_far_the_largest_share(measured, known):
    scene = measure_fingerprint(*simulated(only({known: 1.0}), 32, seed=1)).energies()
    chances, limits = solve_gate(measured, scene)
    shares = (contributions(measured, chances, limits) / scene.clamp_min(ROUNDING)).sum(1)
    shares = shares / shares.sum()
    assert shares[TESTED.index(known)] > 0.7, dict(zip(TESTED, shares.tolist(), strict=True))


@pytest.mark.parametrize(
    ("chances", "limits"),
    [
        ({"noise": 0.8}, {"noise": 0.5}),
        ({"blur": 0.8, "noise": 0.5}, {"blur": 0.6}),
        ({"noise": 1.0, "cloudy": 0.7}, {"noise": 0.3}),
        ({"blur": 0.6, "floater": 0.8}, {"floater": 0.7}),
    ],
)
def test_simulated_energies_under_the_calibrated_gate_are_the_scenes_within_a_factor_of_two(measured, chances, limits):
    scene = measure_fingerprint(*simulated(only(chances, limits), 144, seed=2)).energies()
    solution = (dict(zip(TESTED, values.tolist(), strict=True)) for values in solve_gate(measured, scene))
    again = measure_fingerprint(*simulated(only(*solution), 144, seed=3)).energies()
    ratio = (again / scene)[scene > MIN_RELATIVE_ENERGY * scene.max()]
    assert len(ratio) >= 1
    assert ratio.min() > 0.5, ratio
    assert ratio.max() < 2, ratio


def test_responses_start_at_nothing_and_grow_with_the_strength(measured):
    assert measured.curves.shape == (len(TESTED), len(STRENGTHS) + 1, len(ENERGIES))
    assert torch.equal(measured.curves[:, 0], torch.zeros(len(TESTED), len(ENERGIES), dtype=torch.float64))
    assert (measured.curves.sum(2).diff(dim=1) > 0).all()


def test_mean_responses_below_a_limit_are_the_integral_of_the_curve():
    knots = torch.tensor((0.0, *STRENGTHS), dtype=torch.float64)
    linear = Responses(("blur", "noise"), torch.stack([knots, 3 * knots])[..., None].expand(-1, -1, 6))
    limits = torch.tensor([1.0, 0.6], dtype=torch.float64)
    torch.testing.assert_close(linear.mean_below(limits)[:, 0], torch.tensor([0.5, 0.9], dtype=torch.float64))


def test_a_weaker_scene_gets_lower_chances_and_limits(measured):
    unit = measured.mean_below(torch.ones(len(TESTED), dtype=torch.float64))[1]
    found = [solve_gate(measured, share * unit) for share in (0.1, 0.3, 0.9)]
    chances, limits = (torch.stack([pair[i][1] for pair in found]) for i in (0, 1))
    assert (chances.diff() > 0).all()
    assert (limits.diff() > 0).all()
    # A share of w is met by a chance of sqrt(w), and by a strength for the rest.
    torch.testing.assert_close(chances, torch.tensor([0.1, 0.3, 0.9], dtype=torch.float64).sqrt(), rtol=0.1, atol=0)


def test_weights_are_not_negative_and_explain_a_sum_of_independent_responses():
    unlike = torch.rand(4, 6, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    truth = torch.tensor([0.5, 0.0, 2.0, 0.0], dtype=torch.float64)
    found = solve_weights(unlike, truth @ unlike)
    assert (found >= 0).all()
    torch.testing.assert_close(found @ unlike, truth @ unlike, rtol=0.1, atol=0)
    assert solve_weights(torch.zeros(2, 6, dtype=torch.float64), torch.ones(6, dtype=torch.float64)).tolist() == [0, 0]


def test_types_that_look_alike_share():
    alike = torch.ones(2, 6, dtype=torch.float64)
    first, second = solve_weights(alike, torch.ones(6, dtype=torch.float64)).tolist()
    assert first == pytest.approx(second, rel=1e-6)
    assert first + second == pytest.approx(1, rel=0.02)


def test_held_out_factors_ask_for_more_and_switches_leave_types_out():
    scene = Fingerprint(*[(1 / 255) ** 2] * 6, views=3)
    generator = torch.Generator().manual_seed

    def total(factor):
        gate = calibrate_gate(
            scene, PHOTOS[:2], generator(0), types=SWITCHES, held_out=dict.fromkeys(ENERGIES, Growth(factor))
        )
        assert set(gate.chances) == set(TESTED)
        return sum(gate.chances[name] * gate.limits[name] ** 2 for name in TESTED)

    assert total(4.0) > 1.5 * total(1.0)
    with pytest.raises(InputError, match=r"held_out\.brightness: is no energy"):
        calibrate_gate(scene, PHOTOS, generator(0), held_out={"brightness": Growth(2.0)})
    with pytest.raises(InputError, match="0 photos"):
        calibrate_gate(scene, [], generator(0), types=SWITCHES)


def test_a_run_is_calibrated_on_its_training_views():
    render = (PHOTOS[0] + 0.1 * torch.randn(PHOTOS[0].shape, generator=torch.Generator().manual_seed(9))).clamp(0, 1)
    views = tuple(RenderedView(f"{i}.png", lambda: render, read_photo=lambda: PHOTOS[0]) for i in range(2))
    rendered = RenderedSet("run", (), views)
    gate = calibrate_on_splat(rendered, torch.Generator().manual_seed(0), types=SWITCHES, photos=1)
    found = measure_fingerprint([render] * 2, [PHOTOS[0]] * 2)
    assert gate == calibrate_gate(found, [PHOTOS[0]], torch.Generator().manual_seed(0), types=SWITCHES)
    assert gate.chances["noise"] > 0.3 > gate.chances["blur"]


def test_survives_its_file_and_several_files_take_turns(tmp_path):
    gates = [only({"blur": 1.0}, {"blur": 0.25}), only({"noise": 1.0})]
    for i, gate in enumerate(gates):
        gate.to_file(tmp_path / f"{i}.json")
        assert AdaptiveGate.from_file(tmp_path / f"{i}.json", SWITCHES) == gate
    assert adaptive_gate(str(tmp_path / "0.json"), SWITCHES) == gates[0]
    mixed = adaptive_gate([str(tmp_path / "0.json"), str(tmp_path / "1.json")])
    bracketed = tmp_path / "gates[1]" / "0.json"
    gates[0].to_file(bracketed)
    assert adaptive_gate(str(bracketed), SWITCHES) == gates[0]
    generator = torch.Generator().manual_seed(0)
    drawn = [mixed.draw(generator) for _ in range(1000)]
    first = sum(steps[0].type == "blur" for steps in drawn)
    assert {tuple(step.type for step in steps) for steps in drawn} == {("blur",), ("noise",)}
    assert abs(first - 500) < 4.5 * math.sqrt(250)


def test_chances_and_limits_hold():
    gate = AdaptiveGate({"blur": 0.7, "needle": 0.2}, {"blur": 0.3}, regional=0.1)
    generator = torch.Generator().manual_seed(0)
    drawn = [step for _ in range(3000) for step in gate.draw(generator)]
    for name, chance, limit in (("blur", 0.7, 0.3), ("needle", 0.2, 1.0)):
        strengths = [step.strength for step in drawn if step.type == name]
        assert abs(len(strengths) - 3000 * chance) < 4.5 * math.sqrt(3000 * chance * (1 - chance))
        assert 0.98 * limit < max(strengths) <= limit
    assert {step.type for step in drawn} == {"blur", "needle"}
    regional = sum(step.regional for step in drawn)
    assert abs(regional - 0.1 * len(drawn)) < 4.5 * math.sqrt(0.09 * len(drawn))


def test_types_that_a_scene_does_not_show_are_named_and_never_drawn():
    scene = measure_fingerprint(*simulated(only({"noise": 1.0}), 8, seed=4))
    gate = calibrate_gate(scene, PHOTOS[:2], torch.Generator().manual_seed(0), types=SWITCHES, held_out={})
    assert {"needle", "jpeg"} <= set(gate.disabled_types)
    assert "noise" not in gate.disabled_types
    generator = torch.Generator().manual_seed(0)
    seen = {step.type for _ in range(500) for step in gate.draw(generator)}
    assert not seen & set(gate.disabled_types)
    assert seen | set(gate.disabled_types) >= set(TESTED)
    assert gate.table().splitlines()[-1] == f"left out: {', '.join(gate.disabled_types)}"
    everything = AdaptiveGate(dict.fromkeys(TYPES, 0.5))
    assert everything.disabled_types == ()
    assert "left out" not in everything.table()


GOOD = {"chances": {"blur": 0.5}, "limits": {"blur": 0.5}, "regional": 0.5}


@pytest.mark.parametrize(
    ("record", "named"),
    [
        ({**GOOD, "chances": {"blurr": 0.5}}, "gate.chances.blurr"),
        ({**GOOD, "chances": {"blur": 1.5}}, "blur: is 1.5"),
        ({**GOOD, "chances": {"blur": "often"}}, "often"),
        ({**GOOD, "chances": 0.5}, "chances"),
        ({**GOOD, "limits": {"blur": 0.0}}, "gate.limits.blur"),
        ({**GOOD, "regional": 7}, "gate.regional"),
        ({"chances": {}, "limits": {}}, "regional"),
    ],
)
def test_refuses_a_broken_file_by_name(tmp_path, record, named):
    path = tmp_path / "gate.json"
    path.write_text(json.dumps(record))
    with pytest.raises(InputError, match=named):
        adaptive_gate(str(path))


def test_refuses_no_file_and_a_file_that_is_not_there(tmp_path):
    with pytest.raises(InputError, match=r"gate\.file: names no file"):
        adaptive_gate([])
    with pytest.raises(InputError, match="does not exist"):
        adaptive_gate(str(tmp_path / "none.json"))
    with pytest.raises(InputError, match="names no file of a gate"):
        adaptive_gate([str(tmp_path / "none*.json"), str(tmp_path / "0.json")])
    assert MixedGate((RandomGate(),)).draw(torch.Generator().manual_seed(1)) is not None
