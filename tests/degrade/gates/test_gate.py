import itertools
import math
from collections import Counter

import pytest
import torch

from gaussian_enhancer.degrade.artefact_types import TYPES
from gaussian_enhancer.degrade.gates import adaptive
from gaussian_enhancer.degrade.gates import gate as gates
from gaussian_enhancer.degrade.gates.adaptive import AdaptiveGate, MixedGate
from gaussian_enhancer.degrade.gates.gate import AllGate, ArtefactStep, NoGate, RandomGate, enabled_types
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.runs.instantiate import build
from support.job_config import job_config

DRAWS = 3000
EVERY = dict.fromkeys(TYPES, 0.9)
GATES = {
    "all": lambda types: AllGate(types),
    "random": lambda types: RandomGate(types, chance=0.9),
    "adaptive": lambda types: AdaptiveGate(EVERY, types=types),
    "mixed": lambda types: MixedGate((AdaptiveGate(EVERY, types=types), AdaptiveGate(EVERY, types=types))),
}


def draws(gate, count=DRAWS, seed=0):
    generator = torch.Generator().manual_seed(seed)
    return [gate.draw(generator) for _ in range(count)]


def near(count, chance, total):
    """Within 4.5 standard deviations of a binomial count: one wrong alarm in 100 000."""
    return abs(count - chance * total) <= 4.5 * math.sqrt(chance * (1 - chance) * total)


def test_types_pass_at_their_chance_and_stay_within_a_region_at_theirs():
    drawn = draws(RandomGate(chances={"needle": 0.8, "jpeg": 0.0, "colour": 1.0}, regional=0.25))
    counts = Counter(step.type for steps in drawn for step in steps)
    for name in TYPES:
        assert near(counts[name], {"needle": 0.8, "jpeg": 0.0, "colour": 1.0}.get(name, 0.3), DRAWS), name
    regional = sum(step.regional for steps in drawn for step in steps)
    assert near(regional, 0.25, sum(counts.values()))


def test_two_to_four_types_act_on_average():
    assert 2 < sum(map(len, draws(RandomGate()))) / DRAWS < 4


@pytest.mark.parametrize("gate", [AllGate(), RandomGate(chance=1.0), AdaptiveGate(dict.fromkeys(TYPES, 1.0))])
def test_strengths_are_uniform_and_every_place_of_the_order_equally_likely(gate):
    drawn = draws(gate, 2000)
    assert all(sorted(step.type for step in steps) == sorted(TYPES) for steps in drawn)
    strengths = torch.tensor([[step.strength for step in steps] for steps in drawn])
    assert 0 < strengths.min() <= strengths.max() <= 1
    for edge in (0.1, 0.5, 0.9):
        assert near(int((strengths < edge).sum()), edge, strengths.numel())
    places = Counter((step.type, place) for steps in drawn for place, step in enumerate(steps))
    pairs = Counter((first.type, second.type) for steps in drawn for first, second in itertools.pairwise(steps))
    assert all(near(places[name, place], 1 / len(TYPES), 2000) for name in TYPES for place in range(len(TYPES)))
    assert all(near(pairs[a, b], 1 / len(TYPES), 2000) for a in TYPES for b in TYPES if a != b)


@pytest.mark.parametrize("name", TYPES)
@pytest.mark.parametrize("gate", GATES)
def test_a_switch_removes_its_type_and_changes_nothing_about_the_others(gate, name):
    with_all, without = draws(GATES[gate]({}), 60), draws(GATES[gate]({name: False}), 60)
    assert any(step.type == name for steps in with_all for step in steps)
    assert without == [tuple(step for step in steps if step.type != name) for steps in with_all]


@pytest.mark.parametrize("gate", GATES)
def test_a_new_type_changes_nothing_about_the_others(gate, monkeypatch):
    before = draws(GATES[gate]({}), 60)
    for module in (gates, adaptive):
        monkeypatch.setattr(module, "TYPES", ("ageing", *TYPES, "zebra"))
    monkeypatch.setitem(EVERY, "ageing", 0.9)
    after = draws(GATES[gate]({}), 60)
    assert any(step.type == "ageing" for steps in after for step in steps)
    assert before == [tuple(step for step in steps if step.type in TYPES) for steps in after]


def test_no_gate_and_a_gate_with_every_switch_off_let_nothing_pass():
    off = dict.fromkeys(TYPES, False)
    for gate in (NoGate(), *(make(off) for make in GATES.values())):
        assert draws(gate, 20) == [()] * 20


@pytest.mark.parametrize(
    ("make", "named"),
    [
        (lambda: RandomGate(types={"needles": False}), "gate.types.needles"),
        (lambda: AllGate(types={"needles": False}), "gate.types.needles"),
        (lambda: AdaptiveGate({}, types={"needles": False}), "gate.types.needles"),
        (lambda: enabled_types({"needle": "off"}), "gate.types.needle"),
        (lambda: RandomGate(chances={"blurr": 0.5}), "gate.chances.blurr"),
        (lambda: RandomGate(chances={"blur": 1.5}), "gate.chances.blur"),
        (lambda: RandomGate(chance=-0.1), "gate.chance"),
        (lambda: RandomGate(chance=math.nan), "gate.chance"),
        (lambda: RandomGate(regional=2.0), "gate.regional"),
        (lambda: ArtefactStep("blurr", 0.5), "step.blurr"),
        (lambda: ArtefactStep("blur", 0.0), "strength of blur"),
        (lambda: ArtefactStep("blur", 1.01), "strength of blur"),
    ],
)
def test_refuses_what_is_no_type_or_out_of_range_by_name(make, named):
    with pytest.raises(InputError) as refusal:
        make()
    assert refusal.value.subject == named


def composed(name, *overrides):
    given = [f"+gate={name}", *(f"gate.{word}" for word in overrides)]
    return build(job_config("base", *given).gate)


@pytest.mark.parametrize("name", ["all", "random", "naive"])
def test_configurations_switch_single_types_off(name):
    on = {step.type for steps in draws(composed(name), 60) for step in steps}
    less = {step.type for steps in draws(composed(name, "types.blur=false"), 60) for step in steps}
    assert on == ({"blur", "noise", "jpeg"} if name == "naive" else set(TYPES))
    assert less == on - {"blur"}


def test_every_type_has_its_line_of_configuration():
    switches = job_config("base", "+artefacts=all").artefacts
    assert dict(switches) == dict.fromkeys(TYPES, True)


def test_configurations_of_no_gate_and_of_the_adaptive_one(tmp_path):
    assert composed("none") == NoGate()
    with pytest.raises(InputError, match=r"file: is mandatory"):
        composed("adaptive")
    AdaptiveGate({"blur": 1.0, "needle": 1.0}).to_file(tmp_path / "gate.json")
    gate = composed("adaptive", f"file={tmp_path / 'gate.json'}", "types.needle=false")
    assert {step.type for steps in draws(gate, 20) for step in steps} == {"blur"}
