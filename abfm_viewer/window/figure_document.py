"""The paper's figures as documents that are ready to match, for the menu Samples."""

from typing import Any

from abfm import experiments
from abfm.types import FloatArray
from abfm_viewer.document.document import Channel, Document, Surface, View

_KEPT = (
    *("theme", "ui_scale", "layout", "colormap", "isolines", "isoline_count", "color_bar"),
    *("wireframe", "flat", "arrow_length", "arrow_density", "flow_after_match", "previous_runs"),
)
"""What a figure leaves as the user's view has it."""
_SHOWN: dict[int, dict[str, Any]] = {
    1: {"blend": True},
    2: {"streaks": True},
    5: {"streaks": True, "part": "commuting"},
    # it is nothing but noise where it is almost 0
    6: {"streaks": True, "fade": True, "part": "carried gradient"},
    8: {"error": True},
}
"""What a figure shows besides the functions."""


def figure_document(figure: int, view: View) -> tuple[Document, dict[str, FloatArray]]:
    """Return a figure of the paper, drawn in a view's theme and layout, and the values of functions
    that no text describes.

    It is set up in a process of its own, in seconds; an `AbfmError` says why it cannot be.
    """
    example, given = experiments.stated_apart(figure)
    parameters = example.problem.parameters
    document = Document(
        (Surface(example.problem.mesh, example.name),),
        tuple(Channel(source, target) for source, target in example.specs),
        parameters=parameters,
        result=given,
        time=parameters.tau if given else 0.0,
        view=View(**{name: getattr(view, name) for name in _KEPT}, **_SHOWN.get(figure, {})),
    )
    return document, example.values
