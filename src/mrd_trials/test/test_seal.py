"""Answers stay what they were, and elsewhere; what is kept of a trial survives being cut off."""

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mrd_base import InputError
from mrd_trials.records import Answer, Bin, Insight, Named, Submission, add_record, from_json, read_records, to_json
from mrd_trials.seal import commitment, salt, unseal

ANSWER = Answer(
    "p0001",
    "single",
    "bouc_wen",
    "bouc_wen",
    False,
    {"viscous": 800.0},
    {"coil_lag": {"lag": 0.02}},
    ("coil_lag",),
    {"coil_lag.lag": 0.02},
    5.0,
    "3-10",
    "rich",
    500.0,
    1,
    "00" * 16,
)

numbers = st.floats(allow_nan=False)
ends = st.tuples(numbers, numbers, numbers)
names = st.text(min_size=1, max_size=8)
named = st.builds(Named, st.tuples(names), numbers, ends, st.dictionaries(names, ends), st.tuples(names))
bins = st.builds(Bin, names, numbers, numbers, numbers)
submissions = st.builds(
    Submission,
    names,
    names,
    names,
    st.tuples(named),
    st.tuples(named, named),
    st.tuples(names),
    st.tuples(names),
    numbers,
    numbers,
    numbers,
    ends,
    st.tuples(bins),
    names,
    st.dictionaries(names, numbers),
    st.tuples(names),
    numbers,
)
insights = st.builds(
    Insight,
    names,
    numbers,
    st.tuples(bins),
    numbers,
    st.dictionaries(names, st.tuples(names)),
    st.dictionaries(names, st.tuples(names, names)),
    st.booleans(),
    st.none(),
)


@given(st.one_of(submissions, insights, st.just(ANSWER)))
def test_records_come_back_as_they_were(record):
    line = to_json(record)
    assert "\n" not in line
    assert from_json(type(record), line, "here") == record


@pytest.mark.parametrize("line", ["", "[1]", "{}", '{"plant": 1, "ghost": 2}', "nonsense"])
def test_a_line_that_is_no_record_is_refused(line):
    with pytest.raises(InputError, match="here: is no answer"):
        from_json(Answer, line, "here")


def test_a_line_that_was_cut_off_gives_way(tmp_path):
    path = tmp_path / "answers.jsonl"
    for name in ("p0001", "p0002"):
        add_record(replace(ANSWER, plant=name), path)
    path.write_text(path.read_text()[:-20])
    assert list(read_records(Answer, path)) == ["p0001"]
    add_record(replace(ANSWER, plant="p0003"), path)
    assert list(read_records(Answer, path)) == ["p0001", "p0003"]


def test_no_file_is_no_records(tmp_path):
    assert read_records(Answer, tmp_path / "none.jsonl") == {}


def test_an_answer_that_was_changed_shows(tmp_path):
    path = tmp_path / "answers.jsonl"
    add_record(ANSWER, path)
    assert unseal(path, {"p0001": commitment(ANSWER)}) == {"p0001": ANSWER}
    add_record(replace(ANSWER, causes=("backlash",)), path)
    with pytest.raises(InputError, match="p0001 is not the one committed to"):
        unseal(path, {"p0001": commitment(ANSWER)})


def test_a_missing_answer_shows(tmp_path):
    path = tmp_path / "answers.jsonl"
    with pytest.raises(InputError, match="holds no answers"):
        unseal(path, {"p0001": commitment(ANSWER)})
    add_record(ANSWER, path)
    with pytest.raises(InputError, match="no answer for p0002"):
        unseal(path, {"p0002": commitment(ANSWER)})


def test_commitments_say_nothing_without_the_salt():
    salts = {salt() for _ in range(20)}
    assert len(salts) == 20
    assert len({commitment(replace(ANSWER, salt=each)) for each in salts}) == 20
    assert all(len(each) == 32 for each in salts)
