"""Records survive a round trip and an interruption; a changed answer does not fit its commitment."""

from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mrd_base import InputError
from mrd_trials.commitments import commitment, new_salt, open_answers
from mrd_trials.records import (
    Evaluation,
    Explanation,
    GapBin,
    GroundTruth,
    Submission,
    append_record,
    from_json,
    read_records,
    to_json,
)

ANSWER = GroundTruth(
    "p0001",
    "single",
    "bouc_wen",
    "bouc_wen",
    False,
    (),
    {"viscous": 800.0},
    {"coil_lag": {"lag": 0.02}},
    {"coil_lag": "diffusion"},
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
explanations = st.builds(Explanation, st.tuples(names), numbers, ends, st.dictionaries(names, ends), st.tuples(names))
bins = st.builds(GapBin, names, numbers, numbers, numbers)
submissions = st.builds(
    Submission,
    names,
    names,
    names,
    st.tuples(explanations),
    st.tuples(explanations, explanations),
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
evaluations = st.builds(
    Evaluation,
    names,
    names,
    numbers,
    numbers,
    st.tuples(bins),
    numbers,
    st.dictionaries(names, st.tuples(names, names)),
    st.booleans(),
    st.none(),
)


@settings(max_examples=30)
@given(st.one_of(submissions, evaluations, st.just(ANSWER)))
def test_a_record_survives_a_round_trip(record):
    line = to_json(record)
    assert "\n" not in line
    assert from_json(type(record), line, "here") == record


@pytest.mark.parametrize("line", ["", "[1]", "{}", '{"plant": 1, "ghost": 2}', "nonsense"])
def test_a_line_that_is_not_a_record_is_refused(line):
    with pytest.raises(InputError, match="here: is not an answer"):
        from_json(GroundTruth, line, "here")


def test_a_line_of_another_format_is_refused():
    line = to_json(Submission("p0001", "no_gap")).replace('"format":4', '"format":1')
    with pytest.raises(InputError, match=r"here: is not a submission \(format 1, expected 4\)"):
        from_json(Submission, line, "here")
    with pytest.raises(InputError, match="format 3, expected None"):
        from_json(GroundTruth, to_json(Evaluation("p0001")), "here")


def test_a_line_that_was_cut_off_is_replaced(tmp_path):
    path = tmp_path / "answers.jsonl"
    for name in ("p0001", "p0002"):
        append_record(replace(ANSWER, plant=name), path)
    path.write_text(path.read_text()[:-20])
    assert list(read_records(GroundTruth, path)) == ["p0001"]
    append_record(replace(ANSWER, plant="p0003"), path)
    assert list(read_records(GroundTruth, path)) == ["p0001", "p0003"]


def test_a_missing_file_holds_no_records(tmp_path):
    assert read_records(GroundTruth, tmp_path / "none.jsonl") == {}


def test_a_changed_answer_is_refused(tmp_path):
    path = tmp_path / "answers.jsonl"
    append_record(ANSWER, path)
    assert open_answers(path, {"p0001": commitment(ANSWER)}) == {"p0001": ANSWER}
    append_record(replace(ANSWER, causes=("backlash",)), path)
    with pytest.raises(InputError, match="p0001 is not the one committed to"):
        open_answers(path, {"p0001": commitment(ANSWER)})


def test_a_missing_answer_is_refused(tmp_path):
    path = tmp_path / "answers.jsonl"
    with pytest.raises(InputError, match="holds no answers"):
        open_answers(path, {"p0001": commitment(ANSWER)})
    append_record(ANSWER, path)
    with pytest.raises(InputError, match="no answer for p0002"):
        open_answers(path, {"p0002": commitment(ANSWER)})


def test_every_salt_gives_another_commitment():
    salts = {new_salt() for _ in range(20)}
    assert len(salts) == 20
    assert len({commitment(replace(ANSWER, salt=salt)) for salt in salts}) == 20
    assert all(len(salt) == 32 for salt in salts)
