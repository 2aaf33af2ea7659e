"""What came of the trials of one part."""

from __future__ import annotations

from dataclasses import dataclass, field

from tests.attack.trial import Trial

_KEPT = 20  # faults that are told; of more there is only the number


@dataclass
class Tally:
    """Counts of one part, its worst time and memory, and its faults with the commands that
    repeat them.
    """

    part: str
    ok: int = 0
    refused: int = 0
    fault_count: int = 0
    seconds: float = 0.0
    megabytes: float = 0.0
    faults: list[tuple[str, str]] = field(default_factory=list)

    @property
    def trials(self) -> int:
        return self.ok + self.refused + self.fault_count

    def add(self, trial: Trial) -> None:
        """Count one more."""
        self.ok += trial.outcome == "ok"
        self.refused += trial.outcome == "refused"
        self.fault_count += trial.outcome == "fault"
        self.seconds, self.megabytes = (
            max(self.seconds, trial.seconds),
            max(self.megabytes, trial.megabytes),
        )
        if trial.outcome == "fault" and len(self.faults) < _KEPT:
            self.faults.append(
                (f"./run attack --repeat {self.part}:{trial.seed}", f"{trial.kind}: {trial.detail}")
            )
