"""Causes of the outcome of a match, with their sentences and advice."""

from __future__ import annotations

from enum import StrEnum

from abfm.wording import counted


class Cause(StrEnum):
    """The reason why a match, or an interval of a sequence of frames, has its outcome."""

    NONE = "none"
    FIELD_GIVEN = "field given"
    BOTH_CONSTANT = "both constant"
    SOURCE_CONSTANT = "source constant"
    TARGET_CONSTANT = "target constant"
    VALUES_DIFFER = "values differ"
    EXTREMA_DIFFER = "extrema differ"
    LANDMARKS_NOT_REACHED = "landmarks not reached"
    LIMIT_OF_DATA = "limit of data"
    LITTLE_IMPROVEMENT = "little improvement"
    NO_HELD_OUT_IMPROVEMENT = "no held-out improvement"
    INITIAL_MAP = "initial map"
    COMPLETE_MAP = "complete map"
    CHECKS_DISAGREE = "checks disagree"
    PARTLY_CONFIRMED = "partly confirmed"
    FOLDED = "folded"
    SOURCE_SQUEEZED = "source squeezed"
    SOURCE_UNMOVED = "source unmoved"
    CANCELLED = "cancelled"
    OUT_OF_MEMORY = "out of memory"
    ITERATION_LIMIT = "iteration limit"
    LINE_SEARCH_FAILED = "line search failed"
    NEEDS_ROUGHER_FIELD = "needs rougher field"
    SELECTED_STEP = "selected step"
    DISTORTION_LIMITED = "distortion limited"
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
    Cause.FIELD_GIVEN: "the field was given, not computed",
    Cause.BOTH_CONSTANT: "source and target are constant, so they determine no motion",
    Cause.SOURCE_CONSTANT: "the source is constant, and every flow leaves it constant",
    Cause.TARGET_CONSTANT: (
        "{where}the target is constant but the source is not, and a flow preserves all source "
        "values"
    ),
    Cause.VALUES_DIFFER: (
        "{channel}the source has values from {source}, the target from {target}; a flow preserves "
        "values, so {consequence}"
    ),
    Cause.EXTREMA_DIFFER: (
        "{channel}the source has {here} but the target has {there}, and no flow changes that"
    ),
    Cause.LANDMARKS_NOT_REACHED: (
        "{missed} of {count} landmarks end more than {limit} of sqrt(area) from their targets"
    ),
    Cause.LIMIT_OF_DATA: (
        "a closer match would fit noise, as patches of the surface that the fit excludes would "
        "not match better"
    ),
    Cause.LITTLE_IMPROVEMENT: (
        "the residual is not clearly smaller than before the flow, so the functions are not "
        "registered"
    ),
    Cause.NO_HELD_OUT_IMPROVEMENT: (
        "patches of the surface that the fit excludes do not match better, so the field fits noise"
    ),
    Cause.INITIAL_MAP: "{warning}",
    Cause.COMPLETE_MAP: (
        "the complete map from A to B has a residual of {residual}, more than the flow on B"
    ),
    Cause.CHECKS_DISAGREE: (
        "flow lines do not confirm the match, so the discrete flow is inaccurate here"
    ),
    Cause.PARTLY_CONFIRMED: (
        "the residual along flow lines is larger than that of the discrete flow"
    ),
    Cause.FOLDED: "{folded} of the faces are folded, which is impossible for an exact flow",
    Cause.SOURCE_SQUEEZED: "the flow squeezed the source {to_nothing}instead of moving it{why}",
    Cause.SOURCE_UNMOVED: (
        "the source hardly moved, as smoothness outweighs the match at this sigma"
    ),
    Cause.CANCELLED: "the run was cancelled",
    Cause.OUT_OF_MEMORY: "memory ran out; this is the best field so far",
    Cause.ITERATION_LIMIT: "{limit} while the energy still fell",
    Cause.LINE_SEARCH_FAILED: "no step lowers the energy further, often because of rounding errors",
    Cause.NEEDS_ROUGHER_FIELD: "the residual cannot be reduced further without a rougher field",
    Cause.NO_MOTION: "most of the change is not explained by motion",
    Cause.NO_MOTION_ON_MESH: (
        "most of the change is not explained by motion, as the features span only {edges:.2g} edges"
    ),
    Cause.NOISE: "the frames contain only {noise} and determine no motion",
    Cause.WITHIN_NOISE: "the residual is not larger than {noise} would cause",
    Cause.ONLY_DISCRETE_FLOW: (
        "flow lines do not explain most of the change, so the discrete flow is inaccurate here"
    ),
    Cause.ONLY_FLOW_LINES: (
        "the discrete flow does not explain most of the change, although flow lines do"
    ),
    Cause.NOT_SOLVED: "the interval was not solved, as the run was cancelled earlier",
    Cause.UNDETERMINED: (
        "the frames determine no motion: the field does not predict frames that the fit "
        "excludes, as in a standing wave or in noise"
    ),
    Cause.SELECTED_STEP: "this is the step of the continuation with sigma {sigma:.3g}",
    Cause.DISTORTION_LIMITED: (
        "the distortion is limited to {most:g}; {share:.2f}% of the faces are within the limit "
        "and {percent:g}% within {largest:.2g}"
    ),
}
"""The sentence of each cause; names in braces are details of the decision."""

ADVICE: dict[Cause, str] = {
    Cause.BOTH_CONSTANT: "use functions that vary",
    Cause.NOT_SOLVED: "solve the interval again",
    Cause.SOURCE_CONSTANT: "use a source with the values of the target",
    Cause.TARGET_CONSTANT: "use a target with the values of the source at other places",
    Cause.VALUES_DIFFER: "scale or clip one of the functions",
    Cause.EXTREMA_DIFFER: "smooth the functions, refine the mesh, or expect a partial match",
    Cause.LITTLE_IMPROVEMENT: (
        "check that the functions correspond and that the initial map is correct"
    ),
    Cause.NO_HELD_OUT_IMPROVEMENT: "smooth the functions, or use a larger sigma",
    Cause.INITIAL_MAP: "inspect the initial map, and give landmarks or another map",
    Cause.COMPLETE_MAP: "smooth the functions of A, or refine its mesh",
    Cause.SOURCE_UNMOVED: "check that the functions correspond",
    Cause.SOURCE_SQUEEZED: (
        "use wider functions that overlap, or match intermediate targets, each starting from the "
        "last field"
    ),
}
"""Advice for causes that no change of parameters removes."""


def limit_sentence(iterations: int) -> str:
    """Return the sentence that a run stopped at its limit of iterations."""
    return f"the run stopped at the limit of {counted(iterations, 'iteration')}"


def sentence_of(cause: Cause, **details: object) -> str:
    """Return the sentence of a cause; ``details`` are the values of its placeholders."""
    return SENTENCES[cause].format(**details)
