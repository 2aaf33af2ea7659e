"""Buttons "?" that explain verdicts, warnings, numbers and parameters in a dialog."""

from collections.abc import Sequence

from abfm import explanations
from abfm.wording import capital
from abfm_viewer.dialogs.dialogs import Line
from abfm_viewer.panels.context import Context
from abfm_viewer.widgets.toolkit import TextTone

OUTCOME = "Explain outcome"  # name of the button next to a verdict


def draw_help(context: Context, *topics: str, name: str = "", after_heading: bool = False) -> None:
    """Draw a small button after the previous widget; it explains topics of `abfm.explanations`.

    Its name for scripts is by default ``Explain`` and the first topic.
    """
    ui = context.ui
    if not after_heading:
        ui.same_line_if_fits("", width=ui.help_width)
    if ui.help_button(name or f"Explain {topics[0]}", f"Explain {', '.join(topics)}."):
        explain(context, *topics)


def note_with_help(
    context: Context, text: str, tone: TextTone, topics: Sequence[str], name: str = OUTCOME
) -> None:
    """Write text that wraps at the panel's edge, and then a button that explains topics."""
    context.ui.note(text, tone, context.ui.room_before_help)
    draw_help(context, *topics, name=name)


def explain(context: Context, *topics: str) -> None:
    """Show the sections about topics, and offer the page of the site with the first one."""
    lines: list[Line] = []
    for topic in topics:
        lines += [(capital(explanations.title(topic)), ""), *explanations.paragraphs(topic)]
    context.dialogs.show("Explanation", lines, link=explanations.site_page(topics[0]) or "")
