import re
from pathlib import Path

import pytest

from abfm import ParameterError, explanations
from abfm.matching import Cause
from abfm.outcome import Facts, Outcome, WarningTopic

GUIDES = Path(__file__).parents[2] / "docs" / "howto"


def titles_of(page):
    text = (GUIDES / page).read_text(encoding="utf-8")
    return [title.lower() for title in re.findall(r"^### (.*)$", text, re.MULTILINE)]


def test_each_outcome_cause_and_warning_has_one_section():
    titles, numbers = titles_of("troubleshooting.md"), titles_of("numbers.md")
    assert sorted(titles) == sorted([*Outcome, *Cause, *WarningTopic])
    assert explanations.names() == [*titles, *numbers]
    assert len({*explanations.names()}) == len(titles) + len(numbers)
    groups = explanations.groups().values()
    assert [name for each in groups for name in each] == explanations.names()


def test_parameters_of_the_window_have_a_section():
    assert {"alpha", "sigma", "beta", "tau", "reach"} <= {*explanations.names()}


def test_page_of_the_site_is_offered_only_if_it_exists(tmp_path, monkeypatch):
    monkeypatch.setattr(explanations, "_root", lambda: tmp_path)
    assert explanations.site_page("residual") is None
    page = tmp_path / "docs" / "_build" / "html" / "howto" / "numbers.html"
    page.parent.mkdir(parents=True)
    page.touch()
    assert explanations.site_page("Flow-line residual") == f"{page.as_uri()}#flow-line-residual"
    assert explanations.site_page("nearly") is None


def test_references_to_other_pages_are_left_out():
    assert "More:" not in "".join(map(explanations.section, explanations.names()))


@pytest.mark.parametrize("topic", explanations.names())
def test_sections_have_content_and_a_short_summary(topic):
    text = explanations.section(topic)
    assert len(text) > 80
    assert "](" not in text
    summary = explanations.summary(topic)
    assert summary.endswith(".")
    assert len(summary) <= 100
    plain = " ".join(explanations.paragraphs(topic))
    assert not {"`", "*", "\n"} & set(plain)


@pytest.mark.parametrize("name", ["values differ", "Values-Differ", " values_differ "])
def test_names_have_any_case_and_hyphens(name):
    assert explanations.section(name) == explanations.section(Cause.VALUES_DIFFER)


def test_unknown_name_is_refused_with_the_nearest():
    with pytest.raises(ParameterError, match="did you mean 'values-differ'"):
        explanations.section("value-differ")


def test_facts_name_the_section_of_their_outcome():
    matched = Facts(Outcome.MATCHED, "matched")
    assert matched.topics == ("matched",)
    assert not matched.needs_help
    assert Facts(Outcome.MATCHED, "matched", warnings=("a warning",)).needs_help
    assert Facts(Outcome.NEARLY, "nearly").needs_help
    assert Facts(Outcome.REGISTERED, "", is_complete=False).needs_help
    several = Facts(Outcome.NEARLY, "nearly", topics=(Cause.INITIAL_MAP, Cause.INITIAL_MAP))
    assert several.topics == ("initial map",)
