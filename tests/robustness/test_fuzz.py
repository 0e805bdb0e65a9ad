"""Damaged and hostile input ends with a result or a clear line, whatever it is."""

from collections import Counter
from pathlib import Path

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarking.fuzzing import case_runner
from benchmarking.fuzzing.case_runner import limit_time, run_fuzz_batch, run_fuzz_campaign
from benchmarking.fuzzing.random_configs import (
    ALIAS_BOMB,
    MERGE_BOMB,
    PYTHON_OBJECT_YAML,
    VALID_FILES,
)
from calib.io.config import load_config, validate_and_complete
from calib.io.safe_yaml import load_yaml
from calib.io.status import InputError

CASES = 167 * len(case_runner.CASE_KINDS)


@pytest.fixture(scope="module")
def outcomes():
    return run_fuzz_campaign(CASES, seed=0, n_cores=1)


@pytest.mark.slow
def test_no_case_breaks(outcomes):
    broken = [o for o in outcomes if o.end == "broken"]
    assert len(outcomes) == CASES and not broken, broken[0].message


@pytest.mark.slow
def test_cases_of_every_kind_end_in_every_way_so_that_they_reach_what_they_are_to_test(outcomes):
    ends = Counter((o.kind, o.end) for o in outcomes)
    for kind in ("damaged log", "hostile log"):
        assert ends[kind, "result"] >= 5 and ends[kind, "warning"] >= 20
    assert ends["damaged log", "refused"] >= 20
    for kind in ("chunks and index", "SQLite schema", "template header", "history"):
        assert ends[kind, "refused"] >= 20
    for kind in ("SQLite schema", "template header", "history"):
        assert ends[kind, "result"] >= 3
    assert ends["definition", "warning"] >= 50
    assert ends["config", "result"] >= 3 and ends["config", "refused"] >= 50


@pytest.mark.slow
def test_no_case_takes_more_memory_than_a_good_log(outcomes):
    assert max(o.peak_memory_mb for o in outcomes) < 500


def test_a_case_is_the_same_for_the_same_seed_and_another_for_another():
    first, again, other = (run_fuzz_batch([0, 2], seed)[1] for seed in (3, 3, 4))
    assert (first.end, first.message) == (again.end, again.message)
    assert first.message != other.message


def test_a_case_that_changes_a_file_beside_its_folder_is_called_broken(monkeypatch):
    def reach_out(folder, rng):
        (folder.parent / "outside" / "deep" / "kept.txt").write_text("changed")
        return ""

    monkeypatch.setitem(case_runner.CASE_KINDS, next(iter(case_runner.CASE_KINDS)), reach_out)
    outcome = case_runner.run_fuzz_case(0, seed=0)
    assert outcome.end == "broken" and "changed files outside of its folder" in outcome.message


def test_a_case_that_breaks_or_hangs_is_called_broken(tmp_path, monkeypatch):
    def hang(folder, rng):
        while True:
            pass

    def leave(folder, rng):
        raise KeyError("x")

    monkeypatch.setattr(case_runner, "MAX_CASE_SECONDS", 1)
    for case, words in ((hang, "not done after 1 s"), (leave, "KeyError")):
        end, said = case_runner._run_until_end(case, tmp_path, None)
        assert end == "broken" and words in said


# --- configs

FLAT = st.none() | st.booleans() | st.integers() | st.floats() | st.text() | st.dates()
VALUES = st.recursive(
    FLAT, lambda v: st.lists(v, max_size=4) | st.dictionaries(FLAT, v, max_size=4), max_leaves=8
)
PLACES = {
    kind: [(name, key) for name in names for key in VALID_FILES[name]]
    for kind, names in {
        "config": ["config.yaml"],
        "rig": ["rigs/cart.yaml"],
        "target": ["targets/board.yaml", "targets/charuco.yaml", "targets/cylinder.yaml"],
    }.items()
}


@pytest.mark.parametrize("kind", PLACES)
@settings(max_examples=60, deadline=None)
@given(data=st.data())
def test_any_value_in_a_config_is_taken_or_refused_in_a_line_that_names_the_file(kind, data):
    name, key = data.draw(st.sampled_from(PLACES[kind]))
    content = yaml.safe_load(yaml.safe_dump(VALID_FILES[name]))
    content[key] = data.draw(VALUES)
    try:
        assert validate_and_complete(kind, content, name)[key] is content[key]
    except InputError as error:
        assert str(error).startswith(f"{name}: ") and len(str(error)) < 600


NAMES = [
    "",
    ".",
    "..",
    "../../x",
    "/etc/x",
    "a/b",
    "a\n",
    "a\0",
    "ä",
    "A",
    "x" * 65,
    "-a",
    "export",
]


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("where", ["session", "rig", "sensor"])
def test_a_name_that_would_leave_its_folder_is_refused(where, name, tmp_path):
    good = yaml.safe_load(yaml.safe_dump(VALID_FILES))
    settings, rig = good["config.yaml"], good["rigs/cart.yaml"]
    if where == "session":
        settings["sessions"] = {name: settings["sessions"]["morning"]}
    elif where == "rig":
        settings["sessions"]["morning"]["rig"] = name
    else:
        rig["sensors"][name] = rig["sensors"]["left"]
    for path, content in good.items():
        (tmp_path / path).parent.mkdir(exist_ok=True)
        (tmp_path / path).write_text(yaml.safe_dump(content))
    words = "is not a valid name|is a reserved name|holds a line break or another control character"
    with pytest.raises(InputError, match=words):
        load_config(settings, tmp_path)


def written(folder, text):
    path = Path(folder) / "x.yaml"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


UNREAD = {
    ALIAS_BOMB: "expands to more than 100000 values",
    MERGE_BOMB: "expands to more than 100000 values",
    "a: &a [*a]": "line 1: an alias refers to itself",
    PYTHON_OBJECT_YAML: "could not determine a constructor",
    "[" * 3000: "nested too deeply",
    "b: 1\na: 2\nb: 3": "key 'b' appears in line 1 and again in line 3. Keep one of them",
    "{a: 1, a: 2}": "key 'a' appears in line 1 and again in line 1",
    "day: 2026-13-45": "month must be in 1..12",
    "n: " + "9" * 5000: "4300 digits",
    b"\xff\xfe\x00": "not valid YAML",
    "a: [1": "not valid YAML: expected ',' or ']', but got '<stream end>', line 1",
    "#" * (1 << 20) + "\na: 1": "larger than 1048576 bytes",
}


@pytest.mark.parametrize("text", UNREAD, ids=range(len(UNREAD)))
def test_yaml_that_is_no_config_is_refused_in_a_line(text, tmp_path):
    with pytest.raises(InputError) as caught, limit_time(10):
        load_yaml(written(tmp_path, text))
    assert UNREAD[text] in str(caught.value) and "\n" not in str(caught.value)


def test_yaml_keeps_anchors_that_people_use(tmp_path):
    text = "a: &a {x: 1, y: [2, 3]}\nb: *a\nc: {<<: *a, x: 4}"
    found = load_yaml(written(tmp_path, text))
    assert found["b"] == {"x": 1, "y": [2, 3]} and found["c"] == {"x": 4, "y": [2, 3]}


@pytest.mark.parametrize("value", [".nan", ".inf", "1.0e+40", "1" * 400])
def test_a_number_that_nothing_has_is_refused_with_its_key(value, tmp_path):
    content = load_yaml(written(tmp_path, f"gate: {{window_s: {value}}}"))
    with pytest.raises(InputError, match="x.yaml: gate.window_s: .* is not a finite number"):
        validate_and_complete("config", content, "x.yaml")
