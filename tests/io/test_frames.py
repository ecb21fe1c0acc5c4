"""Frames of videos and images: numbers, times, gaps, what is left out, and what is broken."""

import sys
from fractions import Fraction

import cv2
import numpy as np
import pytest

from fgrecon.core.errors import InvalidInputError, MissingPackageError
from fgrecon.io.frames import numbered_frames, open_frames
from fgrecon.io.images import write_png
from fgrecon.io.source_frames import Choice
from fgrecon.io.video_frames import check_video, write_video


def grey(level, height=48, width=64):
    return np.full((height, width, 3), level, dtype=np.uint8)


def film(path, frames):
    with write_video(path, rate=10) as add:
        for image, time in frames:
            add(image, time)


def images(folder, names):
    folder.mkdir(exist_ok=True)
    for place, name in enumerate(names):
        write_png(folder / name, grey(10 + 20 * place))
    return folder


@pytest.fixture(scope="module")
def video(tmp_path_factory):
    """Twelve frames at ten a second, with a second missing after the sixth."""
    path = tmp_path_factory.mktemp("video") / "drive.mp4"
    with write_video(path, rate=10) as add:
        for number in range(12):
            add(grey(10 + 15 * number, 49, 65), 5.0 + 0.1 * number + (number >= 6))
    return path


def test_a_video_tells_its_times(video):
    source = open_frames(video)
    frames = list(source.read())
    assert source.count == 12
    assert [frame.number for frame in frames] == list(range(12))
    assert [frame.time for frame in frames] == pytest.approx([0.1 * n + (n >= 6) for n in range(12)], abs=1e-4)
    assert [frame.image.mean() for frame in frames] == pytest.approx([10 + 15 * n for n in range(12)], abs=3)
    assert frames[0].image.shape == (48, 64, 3)
    assert frames[3].name == "drive.mp4#3"


def test_browsers_play_what_is_written(video):
    import av

    with av.open(str(video)) as container:
        codec = container.streams.video[0].codec_context
        assert (codec.name, codec.pix_fmt) == ("h264", "yuv420p")
    content = video.read_bytes()
    assert content.find(b"moov") < content.find(b"mdat")


@pytest.mark.parametrize(
    ("choice", "numbers"),
    [
        ({"every": 5}, [0, 5, 10]),
        ({"start": 0.25, "end": 1.75}, [3, 4, 5, 6, 7]),
        ({"every": 2, "start": 1.0}, [6, 8, 10]),
    ],
)
def test_some_of_a_videos_frames(video, choice, numbers):
    assert [frame.number for frame in open_frames(video, **choice).read()] == numbers
    assert [frame.number for frame in open_frames(video, **choice).read(after=5)] == [n for n in numbers if n > 5]


def test_a_video_that_breaks_off_or_is_damaged_has_gaps(video, tmp_path):
    content = bytearray(video.read_bytes())
    with write_video(tmp_path / "noise.mkv", rate=10) as add:
        rng = np.random.default_rng(0)
        for _ in range(20):
            add(rng.integers(0, 255, (96, 128, 3), dtype=np.uint8), None)
    content = bytearray((tmp_path / "noise.mkv").read_bytes())
    middle = len(content) // 2
    content[middle : middle + 2000] = bytes(2000)
    (tmp_path / "damaged.mkv").write_bytes(content)
    frames = list(open_frames(tmp_path / "damaged.mkv").read())
    broken = [frame for frame in frames if frame.image is None]
    assert 1 <= len(broken) < len(frames) <= 20
    assert all("damaged.mkv: frame" in frame.problem for frame in broken)
    (tmp_path / "half.mkv").write_bytes((tmp_path / "noise.mkv").read_bytes()[:middle])
    *_, last = half = list(open_frames(tmp_path / "half.mkv").read())
    assert 0 < sum(frame.image is not None for frame in half) < 20
    assert last.image is None
    assert "breaks off" in last.problem


def test_frames_that_are_shown_in_another_order_than_they_are_stored_keep_their_times_where_some_are_lost(tmp_path):
    noise = np.random.default_rng(0).integers(0, 60, (40, 96, 128, 3), dtype=np.uint8)
    film(tmp_path / "whole.mp4", [(image + 4 * number, 0.1 * number) for number, image in enumerate(noise)])
    content = (tmp_path / "whole.mp4").read_bytes()
    (tmp_path / "cut.mp4").write_bytes(content[: len(content) // 2])
    frames = list(open_frames(tmp_path / "cut.mp4").read())
    assert [frame.number for frame in frames] == list(range(len(frames)))
    times = [frame.time for frame in frames]
    assert (np.diff(times) > 0.0).all()
    good = [frame for frame in frames if frame.image is not None]
    assert 10 < len(good) < 30
    whole = {round(frame.time, 3): frame.image for frame in open_frames(tmp_path / "whole.mp4").read()}
    assert np.mean([np.array_equal(frame.image, whole[round(frame.time, 3)]) for frame in good]) > 0.8


def test_frames_of_another_size_in_a_video_are_gaps(tmp_path):
    import av

    with av.open(str(tmp_path / "two.avi"), "w") as container:
        stream = container.add_stream("mjpeg", rate=10)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuvj420p"
        for place in range(6):
            picture = cv2.imencode(".jpg", grey(100, 48 if place < 3 else 24))[1]
            packet = av.Packet(picture.tobytes())
            packet.stream, packet.time_base, packet.pts, packet.dts = stream, Fraction(1, 10), place, place
            container.mux(packet)
    frames = list(open_frames(tmp_path / "two.avi").read())
    assert [frame.image is not None for frame in frames] == [True] * 3 + [False] * 3
    assert all(frame.other_size and "64 x 24" in frame.problem for frame in frames[3:])
    assert [frame.other_size for frame in open_frames(tmp_path / "two.avi").read(after=3)] == [True, True]


def test_numbered_images_with_gaps_and_one_that_cannot_be_read(tmp_path):
    folder = images(tmp_path / "drive", ["left_9.png", "left_10.png", "left_12.png"])
    (folder / "left_13.png").write_bytes(b"torn")
    (folder / "notes.txt").write_text("")
    source = open_frames(folder, rate=5)
    frames = list(source.read())
    assert [(f.number, f.time) for f in frames] == [(9, 1.8), (10, 2.0), (12, 2.4), (13, 2.6)]
    assert [f.image is None for f in frames] == [False, False, False, True]
    assert "left_13.png" in frames[3].problem
    assert not source.assumed_rate
    assert open_frames(folder).assumed_rate
    assert [f.number for f in open_frames(folder, rate=5, start=0.3).read(after=12)] == [13]
    assert open_frames(folder, rate=5, end=0.3).numbers == (9, 10)
    assert open_frames(str(folder / "left_1*.png"), rate=5).numbers == (10, 12, 13)


@pytest.mark.parametrize(
    ("names", "times"),
    [
        (["1311868164.363181.png", "1311868164.263181.png"], [1311868164.263181, 1311868164.363181]),
        (["1532402928112.png", "1532402927612.png"], [1532402927.612, 1532402928.112]),
        (["1532402928112460000.png", "1532402927612460000.png"], [1532402927.61246, 1532402928.11246]),
    ],
)
def test_names_that_are_times(tmp_path, names, times):
    source = open_frames(images(tmp_path / "stamped", names))
    assert source.numbers == (0, 1)
    assert source.times == pytest.approx(times, abs=1e-6)
    assert not source.assumed_rate
    with pytest.raises(InvalidInputError, match=r"fps: got 10.*tell their times"):
        open_frames(tmp_path / "stamped", rate=10)


def test_numbers_with_many_zeros_before_them_are_no_times(tmp_path):
    source = open_frames(images(tmp_path / "coco", [f"{number:012d}.png" for number in (3, 4)]), rate=10)
    assert (source.numbers, source.times) == ((3, 4), (0.3, 0.4))


def test_dates_are_in_order(tmp_path):
    folder = images(tmp_path / "dates", ["20230101120100.png", "20230101120059.png"])
    source = open_frames(folder)
    assert (source.names, source.numbers) == (("20230101120059.png", "20230101120100.png"), (0, 1))
    assert source.assumed_rate
    assert open_frames(folder, rate=1).times == (0.0, 1.0)


def test_images_of_one_name_are_distinguished(tmp_path):
    for camera in ("left", "right"):
        images(tmp_path / camera, ["000000.png", "000001.png"])
    source = open_frames(str(tmp_path / "*" / "*.png"))
    names = ["left/000000.png", "left/000001.png", "right/000000.png", "right/000001.png"]
    assert [(frame.number, frame.name) for frame in source.read()] == list(enumerate(names))


def test_images_of_another_size_are_gaps(tmp_path):
    folder = images(tmp_path / "x", ["0.png", "1.png", "2.png", "3.png"])
    (folder / "0.png").write_bytes(b"torn")
    write_png(folder / "2.png", grey(9, 24, 32))
    source = open_frames(folder, rate=10)
    for after in (None, 0, 1):
        frames = {frame.number: frame for frame in source.read(after)}
        assert [number for number, frame in frames.items() if frame.image is None] == [0, 2][after is not None :]
        assert "2.png: 32 x 24 pixels, not 64 x 48" in frames[2].problem
        assert [number for number, frame in frames.items() if frame.other_size] == [2]


def test_names_that_tell_nothing_are_in_order(tmp_path):
    source = open_frames(images(tmp_path / "x", ["b.png", "a.png"]), rate=2)
    assert [path.name for path in source.paths] == ["a.png", "b.png"]
    assert source.times == (0.0, 0.5)


def test_frames_without_images(tmp_path):
    source = numbered_frames(tmp_path / "keypoints.json", {7: "a", 3: "b", 4: "c"}, Choice(), rate=10)
    assert [(f.number, f.time, f.image, f.problem) for f in source.read(after=3)] == [
        (4, 0.4, None, None),
        (7, 0.7, None, None),
    ]
    assert numbered_frames(source.path, [3, 4, 7], Choice(end=0.2)).numbers == (3, 4)
    timed = numbered_frames(source.path, [1, 0], Choice(), times={0: 5.0, 1: 5.1})
    assert (timed.numbers, timed.times, timed.assumed_rate) == ((0, 1), (5.0, 5.1), False)


def test_kittis_drives_have_their_left_images(tmp_path):
    (tmp_path / "drive").mkdir()
    images(tmp_path / "drive" / "image_03", ["000000.png"])
    images(tmp_path / "drive" / "image_02", ["000004.png"])
    assert open_frames(tmp_path / "drive").numbers == (4,)


@pytest.mark.parametrize(
    ("arguments", "field"),
    [
        ({"rate": 0.0}, "fps"),
        ({"every": 0}, "every"),
        ({"start": -1.0}, "start"),
        ({"start": 2.0, "end": 1.0}, "end"),
        ({"start": 99.0}, "start"),
    ],
)
def test_what_cannot_be_chosen_is_refused(tmp_path, arguments, field):
    folder = images(tmp_path / "x", ["0.png"])
    with pytest.raises(InvalidInputError) as caught:
        open_frames(folder, **arguments)
    assert caught.value.field == field


def test_what_is_no_source_is_refused(tmp_path, video):
    (tmp_path / "none.mp4").write_bytes(b"no video")
    for source in (tmp_path, tmp_path / "none.mp4", tmp_path / "*.png"):
        with pytest.raises(InvalidInputError, match="source"):
            open_frames(source)
    with pytest.raises(InvalidInputError, match="times of its own"):
        open_frames(video, rate=10)


def test_pyav_is_asked_for_where_it_is_missing(video, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "av", None)
    for use in (lambda: open_frames(video), lambda: check_video("a.mp4")):
        with pytest.raises(MissingPackageError, match="pip install 'av>=14'"):
            use()


def test_a_codec_that_is_missing_is_reported_before_the_work(tmp_path, monkeypatch):
    monkeypatch.setattr("fgrecon.io.video_frames._CODEC", "libnone")
    with pytest.raises(InvalidInputError, match="without the codec libnone"):
        check_video(tmp_path / "a.mp4")


def test_a_video_is_whole_or_not_at_all(tmp_path):
    path = tmp_path / "a.mp4"
    for frames, complaint in (
        ([(grey(1), None), (grey(1, 20, 20), None)], "one size"),
        ([(grey(1), 1.0), (grey(1), 1.0)], "times that grow"),
        ([], "at least one"),
    ):
        with pytest.raises(InvalidInputError, match=complaint):
            film(path, frames)
    with pytest.raises(InvalidInputError, match="mp4"):
        check_video(tmp_path / "a.avi")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("size", [(1, 1), (1, 40), (40, 1)])
def test_a_video_of_less_than_two_pixels_is_refused(tmp_path, size):
    with pytest.raises(InvalidInputError, match="at least 2 x 2"):
        film(tmp_path / "a.mp4", [(grey(9, *size), 0.0)])
    assert not list(tmp_path.iterdir())
