import re
from pathlib import Path

import pytest

from abfm import ParameterError, troubleshooting
from abfm.matching import Cause
from abfm.outcome import Facts, Outcome, WarningTopic

PAGE = Path(__file__).parents[2] / "docs" / "howto" / "troubleshooting.md"
TOPICS = [*Outcome, *Cause, *WarningTopic]


def test_each_outcome_cause_and_warning_has_one_section():
    titles = re.findall(r"^### (.*)$", PAGE.read_text(encoding="utf-8"), re.MULTILINE)
    assert sorted(map(str.lower, titles)) == sorted(TOPICS)
    assert troubleshooting.names() == [title.lower() for title in titles]
    assert [name for each in troubleshooting.groups().values() for name in each] == [
        title.lower() for title in titles
    ]


@pytest.mark.parametrize("topic", TOPICS)
def test_sections_have_content_and_a_short_summary(topic):
    text = troubleshooting.section(topic)
    assert len(text) > 80
    assert "](" not in text
    summary = troubleshooting.summary(topic)
    assert summary.endswith(".")
    assert len(summary) <= 100
    plain = " ".join(troubleshooting.paragraphs(topic))
    assert not {"`", "*", "\n"} & set(plain)


@pytest.mark.parametrize("name", ["values differ", "Values-Differ", " values_differ "])
def test_names_have_any_case_and_hyphens(name):
    assert troubleshooting.section(name) == troubleshooting.section(Cause.VALUES_DIFFER)


def test_unknown_name_is_refused_with_the_nearest():
    with pytest.raises(ParameterError, match="did you mean 'values-differ'"):
        troubleshooting.section("value-differ")


def test_facts_name_the_section_of_their_outcome():
    matched = Facts(Outcome.MATCHED, "matched")
    assert matched.topics == ("matched",)
    assert not matched.needs_help
    assert Facts(Outcome.MATCHED, "matched", warnings=("a warning",)).needs_help
    assert Facts(Outcome.NEARLY, "nearly").needs_help
    assert Facts(Outcome.REGISTERED, "", is_complete=False).needs_help
    several = Facts(Outcome.NEARLY, "nearly", topics=(Cause.INITIAL_MAP, Cause.INITIAL_MAP))
    assert several.topics == ("initial map",)
