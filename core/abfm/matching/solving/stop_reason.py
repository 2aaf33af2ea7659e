"""Why a match stopped."""

from enum import StrEnum


class StopReason(StrEnum):
    """Why a match stopped; what it came to is its verdict.

    As text it reads like its value: ``match.stop_reason == "cancelled"``.
    """

    CONVERGED = "converged"
    """The gradient is as small as the tolerance asks, or as rounding allows."""
    GOAL_REACHED = "goal reached"
    """The mismatch is so small that flow lines seldom confirm less."""
    NO_PROGRESS = "no progress"
    """The energy fell too little to go on."""
    ITERATION_LIMIT = "iteration limit"
    LINE_SEARCH_FAILED = "line search failed"
    """No step lowers the energy any more, which is often rounding."""
    CANCELLED = "cancelled"
    OUT_OF_MEMORY = "out of memory"
    """Memory ran out, and the best field that had been found is kept."""
    GIVEN = "given"
    """The field was not sought."""
    UNKNOWN = "unknown"
    """Of files of before, which had the verdict in its place."""

    @property
    def is_early(self) -> bool:
        """Tell whether it was broken off, so that going on may find more."""
        return self in (StopReason.CANCELLED, StopReason.OUT_OF_MEMORY)

    @classmethod
    def of_file(cls, text: str) -> "StopReason":
        """Return what a file says; ValueError if that is no reason."""
        return cls.UNKNOWN if text in ("impossible", "not reached") else cls(text)
