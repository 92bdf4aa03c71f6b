from collections.abc import Iterator
from pathlib import Path

import pytest
import torch

from gaussian_enhancer.errors import InputError

av = pytest.importorskip("av", reason="PyAV is in the dependency group `test`")

from gaussian_enhancer.video.clip import Clip  # noqa: E402
from gaussian_enhancer.video.encode import Encoding, VideoWriter  # noqa: E402
from support.clips import GREYS, heard, write_clip  # noqa: E402


@pytest.mark.parametrize(("ending", "sound"), [("mp4", "aac"), ("webm", "libopus")])
def test_frames_are_read_in_any_order(tmp_path: Path, ending: str, sound: str) -> None:
    clip = Clip(write_clip(tmp_path / f"clip.{ending}", sound))
    assert (clip.count, clip.height, clip.width, clip.fps) == (len(GREYS), 48, 64, 10)
    assert clip.sound == (sound.removeprefix("lib"),)
    for index in (0, 1, 3, 2, 0, 5):
        frame = clip.frame(index)
        assert frame.shape == (3, 48, 64)
        assert float((frame - GREYS[index]).abs().max()) < 0.03
    with pytest.raises(InputError, match="has no frame 6; it has 6"):
        clip.frame(6)


def test_what_is_no_video_is_refused(tmp_path: Path) -> None:
    (tmp_path / "text.mp4").write_text("no video")
    with pytest.raises(InputError, match=r"text.mp4: cannot be read as a video"):
        Clip(tmp_path / "text.mp4")
    with pytest.raises(InputError, match="does not exist"):
        Clip(tmp_path / "absent.mp4")


def test_a_frame_that_cannot_be_decoded_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    clip = Clip(write_clip(tmp_path / "clip.mp4", "aac"))

    def broken(self: Clip) -> Iterator[object]:
        raise av.error.InvalidDataError(1094995529, "Invalid data found when processing input")
        yield

    monkeypatch.setattr(Clip, "_decode", broken)
    with pytest.raises(InputError, match="is damaged at frame 0"):
        Clip(clip.path).frame(0)


@pytest.mark.parametrize(("ending", "sound"), [("mp4", "aac"), ("webm", "libopus")])
def test_sound_is_copied_as_it_is(tmp_path: Path, ending: str, sound: str) -> None:
    source = write_clip(tmp_path / f"clip.{ending}", sound)
    with VideoWriter(tmp_path / "part", Encoding(ending, 10), 48, 64) as writer:
        for grey in GREYS:
            writer.write(torch.full((3, 48, 64), 1 - grey))
    writer.finish(tmp_path / f"made.{ending}", source)
    assert heard(tmp_path / f"made.{ending}") == heard(source)
    assert float((Clip(tmp_path / f"made.{ending}").frame(4) - (1 - GREYS[4])).abs().max()) < 0.03


def test_sound_that_a_container_cannot_hold_is_refused_before_anything_is_made() -> None:
    with pytest.raises(InputError, match="cannot hold sound in aac"):
        Encoding("webm").check(("aac",))
    Encoding("mp4").check(("aac",))
