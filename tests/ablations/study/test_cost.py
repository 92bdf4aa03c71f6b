import statistics
import subprocess
import sys

import pytest
import torch

from ablations.study.cost import deviation, memory_description, quartiles, times_faster
from gaussian_enhancer.metrics.cost import Timing
from support.paths import ROOT


def test_the_deviation_of_repeats() -> None:
    repeats = (250.0, 4000.0, 250.0)
    assert deviation(Timing(250.0, repeats)) == pytest.approx(statistics.stdev(repeats))


def test_protocols_say_which_memory_is_measured() -> None:
    assert memory_description(torch.device("cpu")) == "of the whole process"
    assert memory_description(torch.device("cuda")) == "allocated on the device"


HELD = """
import threading
import numpy as np
import psutil
from ablations.study import cost

read = threading.Event()

class Watched(psutil.Process):
    def memory_info(self):
        found = super().memory_info()
        read.set()
        return found

def hold(size):
    block = np.ones(size, np.uint8)
    if cost.psutil.Process is Watched:  # hold it until the watching thread has begun and ended a reading
        for _ in range(2):
            read.clear()
            read.wait()
    assert block[-1] == 1

{setting}
print(*(cost.peak_memory(lambda: hold(size * 2**20)) for size in (200, 20)))
"""


WATCHED = "cost._reset_high_water_mark, cost.psutil.Process = lambda: False, Watched"


@pytest.mark.parametrize("setting", ["", WATCHED])
def test_the_peak_is_that_of_the_call_and_not_of_an_earlier_one(setting: str) -> None:
    """In a process of its own, whose memory no other test has grown."""
    code = HELD.format(setting=setting)
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    large, small = map(int, done.stdout.split())
    assert 120 * 2**20 < large - small < 280 * 2**20


@pytest.mark.parametrize(
    ("repeats", "ends"), [((7.0,), (7.0, 7.0)), ((1.0, 2.0, 3.0, 4.0, 5.0), (2.0, 4.0)), ((4.0, 0.0), (1.0, 3.0))]
)
def test_quartiles_of_repeats(repeats, ends):
    assert quartiles(Timing(0.0, repeats)) == ends


def test_rounds_are_compared_one_by_one_so_that_a_slow_spell_falls_out() -> None:
    slow = 10.0  # strikes the last two rounds of both
    mine, theirs = (1.0, 1.0, 1.0, slow, slow), (2.0, 2.0, 2.0, 2 * slow, 2 * slow)
    own, other = (Timing(statistics.median(repeats), repeats) for repeats in (mine, theirs))
    assert times_faster(own, other) == (2.0, 2.0, 2.0)
    shifted = (2.0, 2.0, 2 * slow, 2 * slow, 2 * slow)  # one round more: the medians alone would say 20
    assert times_faster(own, Timing(statistics.median(shifted), shifted)) == (2.0, 2.0, 20.0)


@pytest.mark.parametrize(("rounds", "outside"), [(1, 0), (5, 0), (6, 0), (9, 1), (15, 3), (25, 7)])
def test_the_interval_of_the_median_leaves_out_as_many_rounds_as_the_sign_test_does(rounds, outside) -> None:
    theirs = tuple(float(k) for k in range(1, rounds + 1))
    ones = Timing(1.0, (1.0,) * rounds)
    middle, low, high = times_faster(ones, Timing(statistics.median(theirs), theirs))
    assert (middle, low, high) == ((rounds + 1) / 2, 1 + outside, rounds - outside)
