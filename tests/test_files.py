import gc
import multiprocessing
import os
import resource
import stat
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.files import atomic_write, load_array, matching_paths, save_array


def test_the_file_appears_when_the_block_ends(tmp_path: Path) -> None:
    target = tmp_path / "deep" / "a.txt"
    with atomic_write(target) as temporary:
        assert temporary.suffix == ".txt"
        temporary.write_text("new")
        assert not target.exists()
    assert target.read_text() == "new"
    assert [p.name for p in target.parent.iterdir()] == ["a.txt"]


def test_permissions_follow_the_mask(tmp_path: Path) -> None:
    before = os.umask(0o027)
    try:
        with atomic_write(tmp_path / "a") as temporary:
            temporary.write_text("x")
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "a").stat().st_mode) == 0o640


@pytest.mark.parametrize("error", [OSError(28, "No space left on device"), ValueError("ours"), KeyboardInterrupt()])
def test_an_error_leaves_the_old_file_alone(tmp_path: Path, error: BaseException) -> None:
    (tmp_path / "a").write_text("old")

    def interrupted() -> None:
        with atomic_write(tmp_path / "a") as temporary:
            temporary.write_text("half")
            raise error

    with pytest.raises(InputError if isinstance(error, OSError) else type(error)):
        interrupted()
    assert (tmp_path / "a").read_text() == "old"
    assert len(list(tmp_path.iterdir())) == 1


def test_a_folder_that_is_a_file_is_refused_by_name(tmp_path: Path) -> None:
    (tmp_path / "a").write_text("a file")
    with pytest.raises(InputError, match=r"a/b: cannot be written \(.*\); free some space or choose another folder"):
        save_array(tmp_path / "a" / "b", np.zeros(3))


@pytest.mark.parametrize("size", [700, 5000])
def test_an_array_that_does_not_fit_is_refused(tmp_path: Path, size: int) -> None:
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4 * size, hard))  # the header's 128 bytes are what is missing
    try:
        with pytest.raises(InputError, match=r"a\.npy: cannot be written"):
            save_array(tmp_path / "a.npy", np.zeros(size, np.float32))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert not list(tmp_path.iterdir())
    save_array(tmp_path / "a.npy", np.arange(size))
    assert np.load(tmp_path / "a.npy")[-1] == size - 1


@pytest.fixture
def restless_collector() -> Iterator[None]:
    """A garbage collector that runs often, and lets other threads run while it does."""

    def give_way(phase: str, info: dict[str, int]) -> None:
        time.sleep(0)

    before = gc.get_threshold()
    gc.set_threshold(5, 1, 1)
    gc.callbacks.append(give_way)
    yield
    gc.callbacks.remove(give_way)
    gc.set_threshold(*before)


def test_threads_read_arrays_at_once(tmp_path: Path, restless_collector: None) -> None:
    save_array(tmp_path / "a.npy", np.zeros((48, 64), np.float32))
    with ThreadPoolExecutor(4) as threads:
        read = list(threads.map(lambda _: load_array(tmp_path / "a.npy").shape, range(2000)))
    assert set(read) == {(48, 64)}


def test_a_worker_forked_while_threads_read_can_read(tmp_path: Path) -> None:
    save_array(tmp_path / "a.npy", np.zeros(3))
    fork = multiprocessing.get_context("fork")
    with ThreadPoolExecutor(2) as threads:
        reading = [threads.submit(lambda: load_array(tmp_path / "a.npy")) for _ in range(3000)]
        workers = [fork.Process(target=load_array, args=(tmp_path / "a.npy",)) for _ in range(8)]
        for worker in workers:
            worker.start()
        for worker in workers:
            worker.join(30)
        assert [worker.exitcode for worker in workers] == [0] * 8
        assert all(read.result().shape == (3,) for read in reading)


def test_several_arrays_are_refused_where_one_is_expected(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", a=np.zeros(3), b=np.ones(2))
    with pytest.raises(ValueError, match="holds several arrays"):
        load_array(tmp_path / "a.npz")
    assert load_array(tmp_path / "a.npz", lambda names: names[1]).tolist() == [1, 1]


def test_patterns_match_and_paths_that_exist_are_taken_as_they_are(tmp_path: Path) -> None:
    for name in ("b", "a", "run [v2]"):
        (tmp_path / name).mkdir()
    assert matching_paths(str(tmp_path / "?")) == [tmp_path / "a", tmp_path / "b"]
    assert matching_paths(str(tmp_path / "run [v2]")) == [tmp_path / "run [v2]"]
    assert matching_paths(str(tmp_path / "none*")) == []
    assert matching_paths(str(tmp_path / "none")) == [tmp_path / "none"]
