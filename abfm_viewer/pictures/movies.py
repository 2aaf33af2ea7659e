"""Movies as MP4 or GIF files, written with bounded memory."""

import math
from collections.abc import Callable, Iterable, Iterator
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
from av.codec.codec import UnknownCodecError
from av.container import OutputContainer
from av.filter import Graph
from av.video.reformatter import ColorRange, Colorspace
from av.video.stream import VideoStream
from numpy.typing import NDArray

from abfm import ResultError
from abfm.io import temporary_folder, write_atomically
from abfm_viewer.files.outputs import FPS_MAX, FPS_MIN

Frame = NDArray[np.uint8]

_BT709 = dict.fromkeys(("colorspace", "color_primaries", "color_trc"), "bt709")
_H264 = {"crf": "16"} | _BT709 | {"color_range": "tv"}


def write_movie(
    path: Path,
    frames: Iterable[Frame],
    fps: float,
    count: int,
    on_frame: Callable[[int], None] | None = None,
) -> None:
    """Write an MP4 (H.264, 4:2:0, BT.709) or an endless GIF with one palette.

    A movie is written completely or not at all. The format MP4 needs even sizes, so the last row or
    column of a picture of odd size is dropped. A GIF counts time in hundredths of a second, so the
    durations of its frames may differ by 0.01 s.

    ``frames`` are sRGB pictures of one size, (H, W, 3) of uint8, which are read one by one. ``fps``
    is 0.1 to 120, or at most 50 for a GIF. ``on_frame`` is called with the number of written
    frames; an exception that it raises ends the movie. Raises `ResultError` if the frames, ``fps``
    or the suffix are invalid, or the file cannot be written.
    """
    if path.suffix not in FPS_MAX:
        raise ResultError(f"cannot write {path}: its name must end in {', '.join(FPS_MAX)}")
    fps_max = FPS_MAX[path.suffix]
    if not FPS_MIN <= fps <= fps_max:
        raise ResultError(
            f"cannot write {path} with {fps:g} frames per second; expected {FPS_MIN} to {fps_max:g}"
        )
    if count < 1:
        raise ResultError(f"cannot write {path} with {count} frames; a movie needs at least one")
    write = _write_mp4 if path.suffix == ".mp4" else _write_gif
    with write_atomically(path) as temporary:
        try:
            rate = Fraction(fps).limit_denominator(1001)
            write(temporary, _checked(frames, count, on_frame), rate, count)
        except av.FFmpegError as error:
            reason = f"{error.strerror or error}; choose another folder or a smaller size"
            raise ResultError(f"cannot write {path}: {reason}") from error
        except UnknownCodecError as error:
            reason = f"the installed FFmpeg has no {error}; run: pip install av"
            raise ResultError(f"cannot write {path}: {reason}") from error


def _checked(
    frames: Iterable[Frame], count: int, on_frame: Callable[[int], None] | None
) -> Iterator[Frame]:
    number, shape = 0, None
    for number, frame in enumerate(frames, 1):
        shape = shape or frame.shape
        if frame.dtype != np.uint8 or frame.shape != shape or shape[2:] != (3,) or min(shape) < 2:
            raise ResultError(
                f"frame {number} of the movie has shape {frame.shape} and type {frame.dtype}; "
                "expected uint8 of one shape (height, width, 3), at least 2 x 2 pixels"
            )
        yield frame
        if on_frame is not None:
            on_frame(number)
    if number != count:
        raise ResultError(f"the movie has {number} frames; expected {count}")


def _write_mp4(path: Path, frames: Iterator[Frame], rate: Fraction, count: int) -> None:
    pictures = (
        _picture(frame[: len(frame) // 2 * 2, : frame.shape[1] // 2 * 2]).reformat(
            format="yuv420p", dst_colorspace=Colorspace.ITU709, dst_color_range=ColorRange.MPEG
        )
        for frame in frames
    )
    with av.open(str(path), "w", "mp4", options={"movflags": "faststart"}) as file:
        _encode(file, file.add_stream("libx264", rate, options=_H264), rate, "yuv420p", pictures)


def _write_gif(path: Path, frames: Iterator[Frame], rate: Fraction, count: int) -> None:
    """Write a GIF with one palette, computed from a temporary lossless file of all frames."""
    ticks, ticks_before = (
        math.floor(100 * number / rate + Fraction(1, 2)) for number in (count, count - 1)
    )
    with temporary_folder() as folder:
        lossless = folder / "frames.mkv"
        with av.open(str(lossless), "w", "matroska") as file:
            _encode(file, file.add_stream("ffv1", rate), rate, "bgr0", map(_picture, frames))
        pictures = _in_palette(lossless, _palette(lossless))
        delay = {"final_delay": str(ticks - ticks_before)}
        with av.open(str(path), "w", "gif", options=delay) as file:
            _encode(file, file.add_stream("gif", rate, options={}), rate, "pal8", pictures)


def _picture(frame: Frame) -> av.VideoFrame:
    return av.VideoFrame.from_ndarray(np.ascontiguousarray(frame), "rgb24")


def _encode(
    file: OutputContainer,
    stream: VideoStream,
    rate: Fraction,
    pixels: str,
    pictures: Iterable[av.VideoFrame],
) -> None:
    stream.pix_fmt = pixels
    for number, picture in enumerate(pictures):
        if number == 0:
            stream.width, stream.height = picture.width, picture.height
        picture.pts, picture.time_base = number, 1 / rate
        file.mux(stream.encode(picture))
    file.mux(stream.encode())


def _palette(movie: Path) -> av.VideoFrame:
    """Return the palette of 256 colours that fits the colours of a movie best."""
    with av.open(str(movie)) as file:
        graph = Graph()
        source = graph.add_buffer(template=file.streams.video[0])
        graph.link_nodes(
            source, graph.add("palettegen", "reserve_transparent=0"), graph.add("buffersink")
        ).configure()
        for picture in file.decode(video=0):
            source.push(picture)
        source.push(None)
        return graph.vpull()


def _in_palette(movie: Path, palette: av.VideoFrame) -> Iterator[av.VideoFrame]:
    """Yield frames in the nearest colours of a palette; dithered frames would flicker."""
    with av.open(str(movie)) as file:
        graph = Graph()
        source = graph.add_buffer(template=file.streams.video[0])
        colors = graph.add_buffer(
            width=palette.width, height=palette.height, format=palette.format, time_base=Fraction(1)
        )
        mapped = graph.add("paletteuse", "dither=none")
        colors.link_to(mapped, input_idx=1)
        graph.link_nodes(source, mapped, graph.add("buffersink")).configure()
        palette.pts = 0
        colors.push(palette)
        colors.push(None)
        for picture in file.decode(video=0):
            source.push(picture)
            yield graph.vpull()
