import subprocess
import sys
from pathlib import Path

import pytest
import torch

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.video.encode import CODECS, Encoding, VideoWriter
from support.clips import decoded

av = pytest.importorskip("av", reason="PyAV is in the dependency group `test`")
HEIGHT, WIDTH = 48, 64


def frame(index: int) -> torch.Tensor:
    """Two plain halves; the right one's blue grows by 8/255 a frame."""
    image = torch.zeros(3, HEIGHT, WIDTH)
    image[0], image[1, :, WIDTH // 2 :], image[2, :, WIDTH // 2 :] = 0.8, 0.6, 8 * index / 255
    return image


def write(path: Path, encoding: Encoding, count: int) -> VideoWriter:
    with VideoWriter(path, encoding, HEIGHT, WIDTH) as writer:
        for index in range(count):
            writer.write(frame(index))
    return writer


@pytest.mark.parametrize("container", CODECS)
def test_what_is_encoded_is_what_is_decoded(tmp_path, container):
    encoding = Encoding(container, 24, 8)
    encoding.check()
    writer = write(tmp_path / f"part.{container}", encoding, 30)
    writer.finish(tmp_path / f"whole.{container}")
    assert [path.name for path in tmp_path.iterdir()] == [f"whole.{container}"]
    frames = decoded(tmp_path / f"whole.{container}")
    assert len(frames) == 30
    for index in (0, 11, 29):
        for column in (8, 56):  # away from the edge, where colour is stored at half the resolution
            torch.testing.assert_close(frames[index][:, 24, column], frame(index)[:, 24, column], atol=4 / 255, rtol=0)
    with av.open(str(tmp_path / f"whole.{container}")) as source:
        assert source.streams.video[0].average_rate == 24
        assert source.streams.video[0].codec_context.colorspace == 1  # BT.709


def test_seconds_follow_the_frame_rate(tmp_path):
    write(tmp_path / "part.mp4", Encoding("mp4", 12.5), 25).finish(tmp_path / "a.mp4")
    with av.open(str(tmp_path / "a.mp4")) as source:
        assert float(source.duration / av.time_base) == pytest.approx(2.0, abs=0.05)


@pytest.mark.parametrize("container", CODECS)
def test_an_interrupted_video_plays_every_frame_that_was_written(tmp_path, container):
    path = tmp_path / f"part.{container}"
    writer = VideoWriter(path, Encoding(container, 24), HEIGHT, WIDTH)

    def interrupted() -> None:
        with writer:
            for index in range(17):
                writer.write(frame(index))
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert len(decoded(path)) == 17


def test_a_killed_video_plays(tmp_path):
    program = (
        "import os, torch; from pathlib import Path;"
        "from gaussian_enhancer.video.encode import Encoding, VideoWriter;"
        f"writer = VideoWriter(Path({str(tmp_path / 'part.mp4')!r}), Encoding('mp4', 4), {HEIGHT}, {WIDTH});"
        f"[writer.write(torch.rand(3, {HEIGHT}, {WIDTH})) for _ in range(150)];"
        "os.kill(os.getpid(), 9)"
    )
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == -9
    assert 20 <= len(decoded(tmp_path / "part.mp4")) <= 150


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"container": "avi"}, "format: is 'avi'; choose mp4, webm or frames"),
        ({"fps": 0}, "fps: is 0"),
        ({"fps": float("nan")}, "fps: is nan"),
        ({"quality": 52}, "from 0 .best. to 51"),
        ({"container": "webm", "quality": 64}, "to 63"),
    ],
)
def test_values_out_of_range_are_refused(values, message):
    with pytest.raises(InputError, match=message):
        Encoding(**values)


def test_a_missing_encoder_is_named_with_what_there_is(monkeypatch):
    def missing(name: str, mode: str) -> None:
        raise av.codec.codec.UnknownCodecError(name)

    monkeypatch.setattr(av.codec, "Codec", missing)
    with pytest.raises(InputError, match=r"needs the encoder libx264, which .* lacks; choose format=webm or frames"):
        Encoding("mp4").check()


def test_a_missing_library_is_named_with_the_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "av", None)
    with pytest.raises(InputError, match=r"needs PyAV.*gaussian-enhancer\[video\]"):
        Encoding("mp4").check()


def test_a_folder_that_cannot_be_written_is_refused(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot be written"):
        VideoWriter(tmp_path / "file" / "a.mp4", Encoding(), HEIGHT, WIDTH)
