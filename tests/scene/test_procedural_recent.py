"""Rendered pictures are kept up to a size, and what is handed out can be changed without harm."""

import threading
from concurrent.futures import ThreadPoolExecutor

import torch

from gaussian_enhancer.scene.procedural.recent import TensorCache


def test_makes_once_and_hands_out_copies():
    recent, made = TensorCache(capacity=1000), []

    def make():
        made.append(1)
        return torch.ones(3)

    recent.get("a", make).zero_()
    assert torch.equal(recent.get("a", make), torch.ones(3))
    assert len(made) == 1


def test_forgets_the_least_recently_used():
    recent = TensorCache(capacity=2 * 40)
    for key in ("a", "b"):
        recent.get(key, lambda: torch.zeros(10))
    recent.get("a", lambda: torch.ones(10))
    recent.get("c", lambda: torch.zeros(10))
    assert list(recent.tensors) == ["a", "c"]
    assert recent.size == 80


def test_never_keeps_what_is_too_large():
    recent = TensorCache(capacity=39)
    recent.get("a", lambda: torch.zeros(10))
    assert not recent.tensors
    assert recent.size == 0


def test_threads_that_make_the_same_picture_count_it_once():
    recent, together = TensorCache(capacity=100), threading.Barrier(4)

    def make() -> torch.Tensor:
        together.wait()
        return torch.zeros(10)

    with ThreadPoolExecutor(4) as pool:
        list(pool.map(lambda _: recent.get("a", make), range(4)))
    assert (list(recent.tensors), recent.size) == (["a"], 40)
