"""The stages of a film may overlap, and neither the order of frames nor an error depends on it."""

import threading
import time
from functools import partial
from pathlib import Path

import pytest
import torch

from gaussian_enhancer.align.references import ReferenceConfig, ReferencePool
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.infer.enhancer import SetEnhancer
from gaussian_enhancer.infer.path_references import PathReferences
from gaussian_enhancer.network.network import Network
from gaussian_enhancer.scene.rendered import RenderedSet, RenderedView
from gaussian_enhancer.video.film import Film
from gaussian_enhancer.video.frames import FrameFolder
from support.synthetic_runs import plane_camera

FRAMES, STAGES = 8, 4
PAUSE = 0.25
"""Seconds of a stage; all other work of a frame takes milliseconds."""
HEIGHT, WIDTH = 32, 48


class Brightening(Network):
    """Brightens a render, after a while; remembers in which thread."""

    def __init__(self, pause: float = 0.0) -> None:
        super().__init__()
        self.pause, self.threads = pause, set()

    def stages(self, views):
        time.sleep(self.pause)
        self.threads.add(threading.get_ident())
        return (views.render + 0.1,)


class SlowFolder(FrameFolder):
    """Writing takes a while."""

    def write(self, index, image, candidates=()):
        time.sleep(PAUSE)
        super().write(index, image, candidates)


def image(index: int) -> torch.Tensor:
    return torch.full((3, HEIGHT, WIDTH), 0.05 * index)


PHOTO = partial(image, 1)


def drawn(index: int, pause: float) -> torch.Tensor:
    time.sleep(pause)
    return image(index)


def depth() -> torch.Tensor:
    return torch.full((1, HEIGHT, WIDTH), 3.0)


def path(pause: float = 0.0, read_photo=PHOTO, frames: int = FRAMES) -> RenderedSet:
    """A path past four photos; each frame is a little brighter than the one before."""
    cameras = [plane_camera(index, HEIGHT, WIDTH) for index in range(frames)]
    targets = tuple(
        RenderedView(f"frame {i}", partial(drawn, i, pause), camera, depth) for i, camera in enumerate(cameras)
    )
    references = tuple(RenderedView(f"photo {i}", PHOTO, cameras[i], depth, None, read_photo) for i in range(4))
    return RenderedSet("path", targets, references)


def filmed(
    rendered: RenderedSet,
    folder: FrameFolder,
    network: Network | None = None,
    smoothing: float = 0.0,
    overlapped: bool | None = True,
) -> Film:
    config = PathReferences.from_config(ReferenceConfig())
    enhancer = SetEnhancer(
        network or Brightening(), config, precision="float32", temporal_smoothing=smoothing, colour_clamping=0
    )
    return Film(enhancer, rendered, None, ReferencePool(rendered.references), folder, overlapped=overlapped)


def test_four_slow_stages_take_hardly_longer_than_one(tmp_path: Path) -> None:
    list(filmed(path(frames=4), FrameFolder(tmp_path / "warm-up")))  # kernels are compiled
    film = filmed(path(PAUSE), SlowFolder(tmp_path / "slow"), Brightening(PAUSE))
    started = time.perf_counter()
    for _ in film:
        time.sleep(PAUSE)  # as an encoder
    taken = time.perf_counter() - started
    alone = FRAMES * PAUSE
    assert alone <= taken < 0.6 * STAGES * alone  # 11 pauses where each stage is on time, 32 without any overlap


def test_frames_come_in_order_and_are_those_of_one_stage_after_the_other(tmp_path: Path) -> None:
    together = filmed(path(), FrameFolder(tmp_path / "a"), smoothing=0.5)
    sequential = filmed(path(), FrameFolder(tmp_path / "b"), smoothing=0.5)
    one_by_one = list(sequential.write_frames(list(sequential.enhance_frames(list(sequential.draw_frames())))))
    frames = list(together)
    assert [frame.index for frame in frames] == list(range(FRAMES))
    for frame, expected_frame in zip(frames, one_by_one, strict=True):
        assert torch.equal(frame.enhanced, expected_frame.enhanced)
        assert frame.candidates == expected_frame.candidates != ()
        names = (tmp_path / side / f"frame_{frame.index:06d}.png" for side in "ab")
        assert len({name.read_bytes() for name in names}) == 1


def test_references_are_read_by_the_stage_before(tmp_path: Path) -> None:
    threads, network = set(), Brightening()

    def read_photo():
        threads.add(threading.get_ident())
        return image(1)

    assert len(list(filmed(path(read_photo=read_photo), FrameFolder(tmp_path), network))) == FRAMES
    assert len(threads) == len(network.threads) == 1
    assert threads.isdisjoint(network.threads)


def test_on_a_processor_one_stage_follows_the_other(tmp_path: Path) -> None:
    network, before = Brightening(), threading.active_count()
    film = filmed(path(), FrameFolder(tmp_path / "a"), network, overlapped=None)
    assert not film.overlapped
    frames = iter(film)
    first = next(frames)
    assert threading.active_count() == before
    assert network.threads == {threading.get_ident()}
    together = list(filmed(path(), FrameFolder(tmp_path / "b")))
    for frame, expected_frame in zip([first, *frames], together, strict=True):
        assert torch.equal(frame.enhanced, expected_frame.enhanced)


@pytest.mark.parametrize("overlapped", [False, True])
def test_an_error_of_any_stage_comes_after_the_frames_before_it(tmp_path: Path, overlapped: bool) -> None:
    film = partial(filmed, overlapped=overlapped)

    def broken(name: str):
        raise InputError(name, "is damaged", "give another")

    rendered = path()
    targets = list(rendered.targets)
    targets[3] = RenderedView("frame 3", partial(broken, "frame 3"), targets[3].camera, depth)
    frames = []
    with pytest.raises(InputError, match="frame 3: is damaged"):
        frames.extend(film(RenderedSet("path", tuple(targets), rendered.references), FrameFolder(tmp_path / "a")))
    assert sorted(frame.name for frame in (tmp_path / "a").iterdir()) == [f"frame_{i:06d}.png" for i in range(3)]
    with pytest.raises(InputError, match="photo: is damaged"):
        list(film(path(read_photo=partial(broken, "photo")), FrameFolder(tmp_path / "b")))
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot be written"):
        list(film(path(), FrameFolder(tmp_path / "file")))


def test_a_film_that_is_left_ends_its_threads_and_goes_on(tmp_path: Path) -> None:
    film = filmed(path(), FrameFolder(tmp_path / "film"), smoothing=0.5)
    expected = [frame.enhanced for frame in film]
    before = threading.active_count()
    frames = iter(filmed(path(), FrameFolder(tmp_path / "resumed_film"), smoothing=0.5))
    next(frames)
    frames.close()
    assert threading.active_count() == before
    resumed_film = filmed(path(), FrameFolder(tmp_path / "resumed_film"), smoothing=0.5)
    assert resumed_film.stored[0]
    assert not resumed_film.stored[-1]
    assert all(
        torch.equal(frame.enhanced, expected_frame)
        for frame, expected_frame in zip(resumed_film, expected, strict=True)
    )
