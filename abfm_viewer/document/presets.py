"""The paper's figures as documents that are ready to match."""

from typing import Any

import abfm
from abfm.types import FloatArray
from abfm_viewer.document.document import Channel, Document, View

_KEPT = (
    *("theme", "ui_scale", "layout", "colormap", "isolines", "isoline_count", "color_bar"),
    *("wireframe", "flat", "arrow_length", "arrow_density", "flow_after_match", "previous_runs"),
)
"""What a figure leaves as the user's view has it."""
_SHOWN: dict[int, dict[str, Any]] = {
    1: {"blend": True},
    2: {"streaks": True},
    5: {"streaks": True, "part": "commuting"},
    6: {"streaks": True, "fade": True, "part": "carried gradient"},  # it is nothing but noise where it is almost 0
    8: {"error": True},
}
"""What a figure shows besides the functions."""


def figure_document(figure: int, view: View) -> tuple[Document, dict[str, FloatArray]]:
    """A figure of the paper, drawn in a view's theme and layout, and the values of functions that no text describes.

    It is set up in a process of its own, in seconds; an `AbfmError` says why it cannot be.
    """
    setup, given = abfm.experiments.set_up_apart(figure)
    document = Document(
        setup.mesh,
        setup.name,
        tuple(Channel(source, target) for source, target in zip(setup.sources, setup.targets, strict=True)),
        parameters=setup.parameters,
        result=given,
        time=setup.parameters.tau if given else 0.0,
        view=View(**{name: getattr(view, name) for name in _KEPT}, **_SHOWN.get(figure, {})),
    )
    return document, dict(setup.values)
