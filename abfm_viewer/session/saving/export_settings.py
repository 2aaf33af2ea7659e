"""Settings of exported pictures and movies, which preferences store."""

from dataclasses import dataclass
from typing import Annotated, Literal, get_args

from abfm.display import VIEWS, ViewName
from abfm_viewer.document.document import Document, Range

Background = Literal["theme", "white", "transparent"]
ShownView = Literal["as shown", ViewName]
MovieSuffix = Literal[".mp4", ".gif"]
SHOWN_VIEWS: tuple[ShownView, ...] = ("as shown", *VIEWS)
MOVIE_SUFFIXES: tuple[MovieSuffix, ...] = get_args(MovieSuffix)
BACKGROUNDS: tuple[Background, ...] = get_args(Background)
_CM_PER_INCH = 2.54


@dataclass(frozen=True)
class ExportSettings:
    width: Annotated[int, Range(320, 8192)] = 1920
    height: Annotated[int, Range(240, 8192)] = 1080
    dpi: Annotated[int, Range(36, 2400)] = 300
    background: Background = "theme"
    view: ShownView = "as shown"
    color_bar: bool = True
    movie_suffix: MovieSuffix = ".mp4"
    seconds: Annotated[float, Range(0.1, 600)] = 4.0
    fps: Annotated[float, Range(1, 120)] = 30.0
    start: Annotated[float, Range(0, 2)] = 0.0  # times of start and end, in durations of the flow
    end: Annotated[float, Range(0, 2)] = 1.0
    turns: Annotated[float, Range(-100, 100)] = 0.0  # of the surfaces during a movie

    @property
    def frames(self) -> int:
        """The number of frames of a movie."""
        return max(round(self.seconds * self.fps), 1)

    @property
    def picture_text(self) -> str:
        width, height = (_CM_PER_INCH * n / self.dpi for n in (self.width, self.height))
        return f"{self._size}, printed {width:.1f} x {height:.1f} cm at {self.dpi} dpi"

    @property
    def movie_text(self) -> str:
        return f"{self.frames} frames of {self._size}, {self.seconds:g} s"

    @property
    def _size(self) -> str:
        return f"{self.width} x {self.height} pixels"

    def picture_options(self) -> list[str]:
        """Return the options of `abfm render` for a picture."""
        return [*self._options(self.background), f"--dpi={self.dpi}"]

    def movie_options(self, document: Document) -> list[str]:
        """Return the options of `abfm render` for a movie, which has no transparency."""
        first, last = document.start, document.end
        duration = document.last_target_time - first
        # a sequence ends at its last frame
        start, end = (min(first + share * duration, last) for share in (self.start, self.end))
        ground = "theme" if self.background == "transparent" else self.background
        return [
            *(*self._options(ground), f"--seconds={self.seconds}", f"--fps={self.fps}"),
            *(f"--from={start}", f"--to={end}", f"--turntable={360 * self.turns}"),
        ]

    def _options(self, background: Background) -> list[str]:
        given = [f"--size={self.width}x{self.height}", f"--background={background}"]
        given += [] if self.view == "as shown" else [f"--view={self.view}"]
        return given if self.color_bar else [*given, "--no-color-bar"]
