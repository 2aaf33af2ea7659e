"""Movies, checked by decoding them."""

import sys
import tempfile
from unittest.mock import MagicMock, Mock

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
    """Yield frames of a colour wave in a disc; the length of a white bar is the number."""
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
    """Return the frames (n, H, W, 3) of a movie and its length in seconds."""
    with av.open(str(path)) as file:
        stream = file.streams.video[0]
        pictures = list(file.decode(stream))
        assert stream.duration is not None
        seconds = float(stream.duration * stream.time_base)
    return np.stack([picture.to_ndarray(format="rgb24") for picture in pictures]), seconds


@pytest.mark.parametrize(
    ("suffix", "count", "fps", "size"),
    [
        (".mp4", 31, 23.976, (120, 160)),
        (".mp4", 1, 4, (121, 161)),  # odd sizes lose the last row and column
        (".gif", 31, 0.5, (120, 160)),
        (".gif", 9, 50, (121, 161)),
        (".gif", 1, 4, (120, 160)),
    ],
)
def test_movie_has_all_frames_and_the_duration(suffix, count, fps, size, tmp_path):
    original, told = np.stack(list(frames(count, *size))), []
    write_movie(tmp_path / f"wave{suffix}", original, fps, count, told.append)
    pictures, seconds = decoded(tmp_path / f"wave{suffix}")
    height, width = (120, 160) if suffix == ".mp4" else size
    assert pictures.shape == (count, height, width, 3)
    assert np.abs(pictures.astype(int) - original[:, :height, :width]).mean() < 3
    bars = 4 * np.arange(1, count + 1)
    assert (pictures[:, 3, :, 1] > 140).sum(axis=1) == pytest.approx(bars, abs=1)
    assert seconds == pytest.approx(count / fps, abs=0.0051 if suffix == ".gif" else 1e-3)
    assert told == list(range(1, count + 1))


@pytest.mark.parametrize(("suffix", "inside", "background"), [(".mp4", 4.5, 2), (".gif", 2.5, 0)])
def test_movie_preserves_colors(suffix, inside, background, tmp_path):
    original = np.stack(list(frames(31)))
    write_movie(tmp_path / f"wave{suffix}", original, 25, 31)
    difference = np.abs(decoded(tmp_path / f"wave{suffix}")[0].astype(int) - original)
    disc = (original[0, :, :, 0] != 24) & (np.arange(120) > 8)[:, None]
    assert difference[:, disc].mean() < inside
    assert difference[:, -20:, :20].max() <= background


def test_movie_declares_its_color_space(tmp_path):
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


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_cancelled_movie_leaves_the_older_file(suffix, tmp_path):
    path = tmp_path / f"old{suffix}"
    path.write_bytes(b"old")

    def broken():
        yield from frames(5)
        raise RuntimeError

    with pytest.raises(KeyboardInterrupt):
        write_movie(path, frames(9), 25, 9, Mock(side_effect=[*range(5), KeyboardInterrupt]))
    with pytest.raises(RuntimeError):
        write_movie(path, broken(), 25, 9)
    assert [file.read_bytes() for file in tmp_path.iterdir()] == [b"old"]


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize(
    "case",
    [
        ("add_stream", UnknownCodecError("libx264"), "libx264"),
        ("mux", av.error.OSError(28, "No space left on device"), "No space left on device"),
        ("close", av.error.OSError(5, "Input/output error"), "Input/output error"),
    ],
)
def test_failed_encoder_leaves_the_older_file(suffix, case, tmp_path, monkeypatch):
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
def test_full_disk_leaves_the_older_movie(suffix, tmp_path, monkeypatch):
    import resource

    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    path = tmp_path / f"old{suffix}"
    path.write_bytes(b"old")
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (2000, limits[1]))
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
def test_bad_movies_are_refused(case, tmp_path):
    given, fps, count, named, name = (*case, "bad.mp4")[:5]
    with raises(ResultError, *named) as raised:
        write_movie(tmp_path / name, given, fps, count)
    assert "\n" not in str(raised.value)
    assert list(tmp_path.iterdir()) == []
