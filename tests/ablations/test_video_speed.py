"""The share that the measurement of videos states is that of the slowest stage."""

import json

import pytest

from ablations.benchmarks.video_speed import STAGES, TOGETHER, summary
from gaussian_enhancer.metrics.cost import Timing

FRAMES = 4


def test_the_share_is_that_of_the_slowest_stage():
    seconds = {"render": 1.0, "enhance": 4.0, "write": 0.5, "encode": 2.5, TOGETHER: 5.0}
    found = summary({name: Timing(1000 * value, (1000 * value,)) for name, value in seconds.items()}, 10)
    assert (found["slowest"], found["share"]) == ("enhance", 0.8)
    assert found["one_after_the_other"] == 800
    assert found["milliseconds_a_frame"][TOGETHER] == 500


def test_every_stage_makes_every_frame_and_is_recorded(sheet_run, tmp_path, job, capsys, monkeypatch):
    pytest.importorskip("av", reason="PyAV is in the dependency group `test`")
    from gaussian_enhancer.video.encode import VideoWriter
    from gaussian_enhancer.video.film import Film
    from gaussian_enhancer.video.frames import FrameFolder

    counts = dict.fromkeys(("enhance", "write", "encode"), 0)

    def counted(owner, method, name):
        original = getattr(owner, method)

        def call(*args):
            counts[name] += 1
            return original(*args)

        monkeypatch.setattr(owner, method, call)

    counted(Film, "_enhance", "enhance")
    counted(FrameFolder, "write", "write")
    counted(VideoWriter, "write", "encode")
    words = (
        f"run={sheet_run}",
        f"frames={FRAMES}",
        "rounds=1",
        "overrides=['layout=side_by_side']",
        "runtime.device=cpu",
    )
    job("video_speed", *words, f"records={tmp_path}/found.json")
    found = json.loads((tmp_path / "found.json").read_text())
    head, _, row = capsys.readouterr().out.splitlines()
    assert [word.strip() for word in head.split("|")[2:6]] == list(STAGES)
    assert row.startswith(f"| {found['threads']} | {found['milliseconds_a_frame']['render']:.0f} ms |")
    # alone and together, in a warm-up and in a round; enhanced once more to have frames to write and encode
    assert counts == {"enhance": 5 * FRAMES, "write": 4 * FRAMES, "encode": 4 * FRAMES}
    assert (found["run"], found["frames"], found["size"]) == ("plane", FRAMES, "128x48")
    assert set(found["milliseconds_a_frame"]) == {*STAGES, TOGETHER}
    assert all(value > 0 for value in found["milliseconds_a_frame"].values())
