"""Why a match has its outcome: the causes, and the one table of their sentences."""

from __future__ import annotations

from enum import StrEnum


class Cause(StrEnum):
    """Why a match, or an interval of a sequence, has its outcome."""

    NONE = "none"
    GIVEN = "given"
    BOTH_CONSTANT = "both constant"
    SOURCE_CONSTANT = "source constant"
    TARGET_CONSTANT = "target constant"
    VALUES_DIFFER = "values differ"
    EXTREMA_DIFFER = "extrema differ"
    LANDMARKS_FAR = "landmarks far"
    LIMIT_OF_DATA = "limit of data"
    LITTLE_GAINED = "little gained"
    NOT_HELD_OUT = "not held out"
    INITIAL_MAP = "initial map"
    COMPLETE_MAP = "complete map"
    CHECKS_DISAGREE = "checks disagree"
    LESS_CONFIRMED = "less confirmed"
    FOLDED = "folded"
    SQUEEZED = "squeezed"
    STOOD_STILL = "stood still"
    CANCELLED = "cancelled"
    OUT_OF_MEMORY = "out of memory"
    STILL_FALLING = "still falling"
    LINE_SEARCH_FAILED = "line search failed"
    NEEDS_ROUGHER_FIELD = "needs rougher field"
    STEP_OF_PATH = "step of path"
    BOUNDED = "bounded"
    INCONSISTENT = "inconsistent"
    NO_MOTION = "no motion"
    NOISE = "noise"
    WITHIN_NOISE = "within noise"
    ONLY_DISCRETE_FLOW = "only discrete flow"
    ONLY_FLOW_LINES = "only flow lines"
    NO_MOTION_ON_MESH = "no motion on mesh"
    NOT_SOLVED = "not solved"
    UNDETERMINED = "undetermined"


SENTENCES: dict[Cause, str] = {
    Cause.NONE: "",
    Cause.GIVEN: "the field is given, not sought",
    Cause.BOTH_CONSTANT: "source and target are constant, so no motion can be determined",
    Cause.SOURCE_CONSTANT: "the source is constant, and no flow changes that",
    Cause.TARGET_CONSTANT: (
        "the target is constant and the source is not, and a flow keeps every value of the source"
    ),
    Cause.VALUES_DIFFER: (
        "{channel}the source has values from {source}, the target from {target}, and no flow "
        "changes values: the residual of the values that one of them lacks is {bound}"
    ),
    Cause.EXTREMA_DIFFER: (
        "{channel}the source has {here}, the target {there}; no flow changes that"
    ),
    Cause.LANDMARKS_FAR: "{far} of {count} landmarks end farther than {limit} from their targets",
    Cause.LIMIT_OF_DATA: "a closer match would not hold where it was not fitted",
    Cause.LITTLE_GAINED: (
        "the residual is not clearly below that without motion, so nothing is registered"
    ),
    Cause.NOT_HELD_OUT: "held-out patches gain nothing, so the field fits noise",
    Cause.INITIAL_MAP: "{warning}",
    Cause.COMPLETE_MAP: (
        "the complete map from A to B has a residual of {residual}, more than the flow on B"
    ),
    Cause.CHECKS_DISAGREE: (
        "by flow lines the residual is {verified:.2g}, so the discrete flow is not one here"
    ),
    Cause.LESS_CONFIRMED: "the flow lines confirm less than the discrete flow shows",
    Cause.FOLDED: "{folded} of the faces are folded, which no flow does",
    Cause.SQUEEZED: "the flow squeezed the source {to_nothing}instead of moving it{why}",
    Cause.STOOD_STILL: "the source hardly moved, as moving costs more smoothness than it gains",
    Cause.CANCELLED: "it was cancelled",
    Cause.OUT_OF_MEMORY: "memory ran out, and the best field so far was kept",
    Cause.STILL_FALLING: (
        "it stopped after the {iterations} iterations it was given, still falling"
    ),
    Cause.LINE_SEARCH_FAILED: "no step lowers the energy any more, which is often rounding",
    Cause.NEEDS_ROUGHER_FIELD: "the residual cannot be reduced further without a rougher field",
    Cause.NO_MOTION: "most of what changes is no motion",
    Cause.NO_MOTION_ON_MESH: (
        "most of what changes is no motion that the mesh can carry, as it spans {edges:.2g} edges"
    ),
    Cause.NOISE: "nothing but {noise} is there, and no motion can be told",
    Cause.WITHIN_NOISE: "no more is left than {noise} leaves",
    Cause.ONLY_DISCRETE_FLOW: (
        "flow lines leave most of what changes, so the discrete flow is not one here"
    ),
    Cause.ONLY_FLOW_LINES: (
        "the discrete flow leaves most of what changes, though flow lines do not"
    ),
    Cause.NOT_SOLVED: "it was not solved: cancelled before",
    Cause.UNDETERMINED: (
        "the frames determine no motion: left-out frames are not where the field leads, as in a "
        "standing wave or in a field that follows noise"
    ),
    Cause.STEP_OF_PATH: "a step of the path, with sigma {sigma:.3g}",
    Cause.BOUNDED: (
        "the distortion is limited to {most:g}: {share:.2f}% of the faces are within it, and "
        "{percent:g}% within {largest:.2g}"
    ),
}
"""What is written of each cause; the names in braces are details of the decision."""

ADVICE: dict[Cause, str] = {
    Cause.BOTH_CONSTANT: "take functions that vary",
    Cause.NOT_SOLVED: "solve it again",
    Cause.SOURCE_CONSTANT: "take a source that has the target's values",
    Cause.TARGET_CONSTANT: "take a target that has the source's values in other places",
    Cause.VALUES_DIFFER: "scale or clip one of the functions",
    Cause.EXTREMA_DIFFER: "smooth the functions, refine the mesh, or expect a match in part",
    Cause.LITTLE_GAINED: "check that the functions and the initial map belong together",
    Cause.NOT_HELD_OUT: "smooth the functions, or take a larger sigma",
    Cause.INITIAL_MAP: "look at the initial map, give landmarks, or give the right map",
    Cause.COMPLETE_MAP: "smooth A's functions, or refine its mesh",
    Cause.SQUEEZED: (
        "wider functions that overlap, or targets in between, each match from the last one's field"
    ),
}
"""What to try, if no change of parameters helps."""


def sentence_of(cause: Cause, **details: object) -> str:
    """Return the sentence of a cause."""
    return SENTENCES[cause].format(**details)
