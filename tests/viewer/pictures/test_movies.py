"""Movies, decoded again."""

import sys
import tempfile
from unittest.mock import MagicMock

import av
import numpy as np
import pytest
from av.codec.codec import UnknownCodecError

from abfm import ResultError
from abfm.pages.colormaps import table
from abfm_viewer.pictures.movies import write_movie
from tests.messages import raises

SUFFIXES = [".mp4", ".gif"]


def frames(count, height=120, width=160):
    """A wave of colours in a disc on a dark ground; the length of a white bar is the number."""
    y, x = np.mgrid[:height, :width]
    disc = (x - width / 2) ** 2 + (y - height / 2) ** 2 < (0.4 * height) ** 2
    colors = np.round(255 * table("abfm diverging")).astype(np.uint8)
    for number in range(count):
        frame = np.full((height, width, 3), (24, 26, 30), dtype=np.uint8)
        wave = 0.5 + 0.5 * np.sin(4 * np.pi * x / width + 2 * np.pi * number / count)
        frame[disc] = colors[np.round(255 * wave[disc]).astype(int)]
        frame[:8, : 4 * (number + 1)] = 255
        yield frame


def black(*shape):
    return np.zeros(shape, np.uint8)


def decoded(path):
    """The frames (n, H, W, 3) of a movie and its length in seconds."""
    with av.open(str(path)) as file:
        stream = file.streams.video[0]
        pictures = list(file.decode(stream))
        assert stream.duration is not None
        seconds = float(stream.duration * stream.time_base)
    return np.stack([picture.to_ndarray(format="rgb24") for picture in pictures]), seconds


@pytest.mark.parametrize("fps", [0.5, 23.976, 50])
@pytest.mark.parametrize("suffix", SUFFIXES)
def test_every_frame_comes_back_in_its_place_and_the_movie_takes_its_time(suffix, fps, tmp_path):
    path, told = tmp_path / f"wave{suffix}", []
    write_movie(path, frames(31), fps, 31, told.append)
    pictures, seconds = decoded(path)
    assert pictures.shape == (31, 120, 160, 3)
    assert (pictures[:, 3, :, 1] > 140).sum(axis=1) == pytest.approx(4 * np.arange(1, 32), abs=1)
    assert seconds == pytest.approx(31 / fps, abs=0.0051 if suffix == ".gif" else 1e-3)
    assert told == list(range(1, 32))


@pytest.mark.parametrize(("suffix", "inside", "background"), [(".mp4", 4.5, 2), (".gif", 2.5, 0)])
def test_colours_survive(suffix, inside, background, tmp_path):
    original = np.stack(list(frames(31)))
    write_movie(tmp_path / f"wave{suffix}", original, 25, 31)
    difference = np.abs(decoded(tmp_path / f"wave{suffix}")[0].astype(int) - original)
    disc = (original[0, :, :, 0] != 24) & (np.arange(120) > 8)[:, None]
    assert difference[:, disc].mean() < inside
    assert difference[:, -20:, :20].max() <= background


def test_an_mp4_and_a_gif_say_which_colours_they_have(tmp_path):
    write_movie(tmp_path / "wave.mp4", frames(3), 25, 3)
    with av.open(str(tmp_path / "wave.mp4")) as file:
        codec = file.streams.video[0].codec_context
        assert codec.pix_fmt == "yuv420p"
        bt709, limited = 1, 1
        assert (codec.colorspace, codec.color_primaries, codec.color_trc) == 3 * (bt709,)
        assert codec.color_range == limited
    data = (tmp_path / "wave.mp4").read_bytes()
    assert data.index(b"moov") < data.index(b"mdat")
    write_movie(tmp_path / "wave.gif", frames(9), 25, 9)
    data = (tmp_path / "wave.gif").read_bytes()
    assert b"NETSCAPE2.0\x03\x01\x00\x00\x00" in data
    pictures, _ = decoded(tmp_path / "wave.gif")
    assert len(set(map(tuple, pictures.reshape(-1, 3).tolist()))) <= 256


@pytest.mark.parametrize(("suffix", "size"), [(".mp4", (120, 160)), (".gif", (121, 161))])
def test_only_an_mp4_of_odd_size_loses_its_last_row_and_column(suffix, size, tmp_path):
    original = np.stack(list(frames(3, 121, 161)))
    write_movie(tmp_path / f"odd{suffix}", original, 25, 3)
    pictures, _ = decoded(tmp_path / f"odd{suffix}")
    assert pictures.shape == (3, *size, 3)
    assert np.abs(pictures.astype(int) - original[:, : size[0], : size[1]]).mean() < 3


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_one_frame_is_a_movie(suffix, tmp_path):
    write_movie(tmp_path / f"one{suffix}", frames(1), 4, 1)
    pictures, seconds = decoded(tmp_path / f"one{suffix}")
    assert (len(pictures), seconds) == (1, 0.25)


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("error", [KeyboardInterrupt, RuntimeError])
def test_what_is_raised_on_the_way_leaves_the_older_file(suffix, error, tmp_path):
    path = tmp_path / f"old{suffix}"
    path.write_bytes(b"old")

    def cancel(number):
        if number == 5:
            raise error

    def broken():
        yield from frames(5)
        raise error

    with pytest.raises(error):
        write_movie(path, frames(9), 25, 9, cancel)
    with pytest.raises(error):
        write_movie(path, broken(), 25, 9)
    assert [file.read_bytes() for file in tmp_path.iterdir()] == [b"old"]


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize(
    "case",
    [
        ("add_stream", UnknownCodecError("libx264"), "libx264"),
        ("mux", av.error.ExternalError(1, "Generic error in a library"), ""),
        ("mux", av.error.OSError(28, "No space left on device"), "No space left on device"),
        ("close", av.error.OSError(5, "Input/output error"), "Input/output error"),
    ],
)
def test_an_encoder_that_fails_leaves_the_older_file(suffix, case, tmp_path, monkeypatch):
    what, error, named = case

    def failing_open(*words, **options):
        container = open_container(*words, **options)
        if "w" not in words:
            return container
        failing = MagicMock(wraps=container)
        failing.__enter__.return_value = failing
        failing.__exit__.side_effect = lambda *_: failing.close()
        setattr(failing, what, MagicMock(side_effect=error))
        return failing

    open_container = av.open
    monkeypatch.setattr(av, "open", failing_open)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    path = tmp_path / f"old{suffix}"
    path.write_bytes(b"old")
    with raises(ResultError, named) as raised:
        write_movie(path, frames(3), 25, 3)
    assert "\n" not in str(raised.value)
    assert [file.read_bytes() for file in tmp_path.iterdir()] == [b"old"]


@pytest.mark.skipif(sys.platform == "win32", reason="limits of a process")
@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("size", [10, 2000])
def test_a_full_disk_leaves_the_older_movie(suffix, size, tmp_path, monkeypatch):
    import resource

    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    path = tmp_path / f"old{suffix}"
    path.write_bytes(b"old")
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, limits[1]))
    try:
        with raises(ResultError):
            write_movie(path, frames(9), 25, 9)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert [file.read_bytes() for file in tmp_path.iterdir()] == [b"old"]


@pytest.mark.parametrize(
    "case",
    [
        ([], 25, 0, (0,)),
        ([], 25, 3, (0, 3)),
        ([*frames(2)], 25, 3, (2, 3)),
        ([*frames(4)], 25, 3, (4, 3)),
        ([black(8, 8, 3), black(8, 9, 3)], 25, 2, (2, "(8, 9, 3)")),
        ([black(8, 8, 4)], 25, 1, ("(8, 8, 4)",)),
        ([black(8, 8)], 25, 1, ("(8, 8)",)),
        ([black(1, 8, 3)], 25, 1, (2,)),
        ([np.zeros((8, 8, 3))], 25, 1, ("float64",)),
        ([], 0, 3, (0, "0.1")),
        ([], -1, 3, (-1,)),
        ([], 121, 3, (121,)),
        ([], np.nan, 3, ("nan",)),
        ([*frames(3)], 60, 3, (60, "0.1", 50), "fast.gif"),
        ([*frames(3)], 25, 3, (".mp4", ".gif"), "wave.avi"),
        ([*frames(3)], 25, 3, ("wave.mp4",), "missing/wave.mp4"),
    ],
)
def test_what_is_no_movie_is_refused_in_one_line(case, tmp_path):
    given, fps, count, named, name = (*case, "bad.mp4")[:5]
    with raises(ResultError, *named) as raised:
        write_movie(tmp_path / name, given, fps, count)
    assert "\n" not in str(raised.value)
    assert list(tmp_path.iterdir()) == []
