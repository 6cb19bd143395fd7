import av
import numpy as np
import pytest
from PIL import Image

import viewer.report.video
from mmi.foundation.errors import DatasetError, ParameterError
from viewer.report.video import VideoWriter

COUNT = 10


def frames(width=96, height=64):
    """Four coloured quarters, and a white square that moves to the right."""
    for i in range(COUNT):
        pixels = np.zeros((height, width, 3), dtype=np.uint8)
        half = height // 2, width // 2
        pixels[: half[0], : half[1]] = (200, 30, 40)
        pixels[: half[0], half[1] :] = (20, 180, 60)
        pixels[half[0] :, : half[1]] = (30, 40, 220)
        pixels[half[0] :, half[1] :] = (230, 220, 40)
        pixels[24:40, 8 * i : 8 * i + 16] = 255
        yield pixels


def write(path, size=(96, 64), rate=25.0):
    with VideoWriter(path, size, rate) as video:
        for pixels in frames(*size):
            video.add(pixels)


def read(path):
    with av.open(path) as container:
        stream = container.streams.video[0]
        decoded = list(container.decode(stream))
        times = [float(one.pts * one.time_base) for one in decoded]
        return stream.codec_context.name, [one.to_ndarray(format="rgb24") for one in decoded], times


def errors(found, expected):
    return [float(np.abs(a.astype(int) - b).mean()) for a, b in zip(found, expected, strict=True)]


@pytest.mark.parametrize("rate", [25.0, 30.0, 29.97, 12.5])
def test_mp4_comes_back(tmp_path, rate):
    write(tmp_path / "walk.mp4", rate=rate)
    name, found, times = read(tmp_path / "walk.mp4")
    assert name == "h264"
    assert np.diff(times) == pytest.approx(1.0 / rate, rel=1e-3)
    assert max(errors(found, frames())) < 4.0
    assert np.abs(found[0][8, 72].astype(int) - (20, 180, 60)).max() < 6  # colours keep their meaning
    assert [one.name for one in tmp_path.iterdir()] == ["walk.mp4"]


def test_mp4_says_how_its_colours_are_stored_and_can_start_before_it_is_loaded(tmp_path):
    write(tmp_path / "walk.mp4")
    with av.open(tmp_path / "walk.mp4") as container:
        context = container.streams.video[0].codec_context
        assert (context.pix_fmt, context.colorspace, context.color_range) == ("yuv420p", 1, 1)
    data = (tmp_path / "walk.mp4").read_bytes()
    assert data.index(b"moov") < data.index(b"mdat")


def test_without_h264_another_encoder_steps_in(tmp_path, monkeypatch):
    monkeypatch.setattr(viewer.report.video.av, "codecs_available", {"mpeg4", "libx265"})
    write(tmp_path / "walk.mp4")
    name, found, _ = read(tmp_path / "walk.mp4")
    assert name == "mpeg4"
    assert max(errors(found, frames())) < 12.0


def test_webp_comes_back_without_drift(tmp_path):
    write(tmp_path / "walk.webp", rate=30.0)
    with Image.open(tmp_path / "walk.webp") as image:
        assert (image.n_frames, image.size, image.info["loop"]) == (COUNT, (96, 64), 0)
        found, durations = [], []
        for i in range(COUNT):
            image.seek(i)
            found.append(np.asarray(image.convert("RGB")))
            durations.append(image.info["duration"])
    assert max(errors(found, frames())) < 6.0
    assert set(durations) == {33, 34}
    assert sum(durations) == round(1000 * COUNT / 30)
    assert [one.name for one in tmp_path.iterdir()] == ["walk.webp"]


@pytest.mark.parametrize("name", ["walk.mp4", "walk.webp"])
def test_odd_sizes_are_filled_up(tmp_path, name):
    write(tmp_path / name, size=(95, 63))
    path = tmp_path / name
    found = read(path)[1][0] if path.suffix == ".mp4" else np.asarray(Image.open(path).convert("RGB"))
    assert found.shape == (64, 96, 3)
    assert np.abs(found[:63, :95].astype(int) - next(frames(95, 63))).mean() < 6.0
    assert np.abs(found[63, 90].astype(int) - (230, 220, 40)).max() < 12  # more of the last row, nothing black


def test_a_suffix_in_capitals_is_one(tmp_path):
    write(tmp_path / "WALK.MP4")
    assert read(tmp_path / "WALK.MP4")[0] == "h264"


@pytest.mark.parametrize("name", ["walk.avi", "walk", "walk.mp4.part"])
def test_other_suffixes_are_refused(tmp_path, name):
    with pytest.raises(ParameterError, match=r"\.mp4 or \.webp expected"):
        VideoWriter(tmp_path / name, (96, 64), 25.0)


@pytest.mark.parametrize(("size", "rate"), [((0, 64), 25.0), ((96, 64), 0.0), ((96, 64), float("nan"))])
def test_senseless_sizes_and_rates_are_refused(tmp_path, size, rate):
    with pytest.raises(ParameterError, match="to 1000 frames"):
        VideoWriter(tmp_path / "walk.mp4", size, rate)


@pytest.mark.parametrize("name", ["walk.mp4", "walk.webp"])
@pytest.mark.parametrize("before", [0, 3])
def test_a_failed_video_leaves_nothing_and_keeps_the_older_one(tmp_path, name, before):
    (tmp_path / name).write_bytes(b"older")
    some = list(frames())
    with pytest.raises(RuntimeError, match="on the way"), VideoWriter(tmp_path / name, (96, 64), 25.0) as video:
        for pixels in some[:before]:
            video.add(pixels)
        raise RuntimeError("on the way")
    assert [one.name for one in tmp_path.iterdir()] == [name]
    assert (tmp_path / name).read_bytes() == b"older"


@pytest.mark.parametrize("name", ["walk.mp4", "walk.webp"])
def test_frames_of_another_size_and_no_frames_are_noticed(tmp_path, name):
    for wrong in (np.zeros((96, 64, 3), dtype=np.uint8), np.zeros((64, 96, 3)), np.zeros((64, 96), dtype=np.uint8)):
        with pytest.raises(ValueError, match="a frame"), VideoWriter(tmp_path / name, (96, 64), 25.0) as video:
            video.add(wrong)
    with pytest.raises(ValueError, match="at least one frame"), VideoWriter(tmp_path / name, (96, 64), 25.0):
        pass
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["walk.mp4", "walk.webp"])
def test_a_place_that_cannot_be_written_is_named(tmp_path, name):
    (tmp_path / "file").write_text("not a folder")
    (tmp_path / name).mkdir()
    for path in (tmp_path / "file" / name, tmp_path / name):
        with pytest.raises(DatasetError, match=f"{path}: a writable file expected, found"):
            write(path)
    assert sorted(one.name for one in tmp_path.iterdir()) == sorted(["file", name])
