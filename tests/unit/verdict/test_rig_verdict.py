"""The verdict: which limits hold, what is said, what is advised, and in which order."""

import copy
import re

import numpy as np
import pytest

from calib.diagnosis.solution_json import solution_json
from calib.diagnosis.suspected_errors import find_suspected_errors
from calib.estimation.corrections.correction_catalog import list_corrections_and_shifts
from calib.geometry.se3 import make_pose
from calib.io.config import validate_and_complete
from calib.io.status import OK
from calib.verdict.findings import level_by_limits
from calib.verdict.rig_verdict import rig_findings
from helpers.synthetic_setup import (
    SyntheticWorld,
    make_synthetic_setup,
    scale_focal_length,
    scale_outline,
    scale_pattern,
    solve_synthetic_setup,
)

LIMITS = validate_and_complete("config", {"sessions": {"s": {"rig": "r", "log": "x"}}}, "x")[
    "judge"
]
NO_OFFSET = {"time_offset_s": {"value": 0.0, "sigma": 0.05}}
GUESS = {"frame": "f", "T_robot_sensor": None, "sigma": [1] * 6, "source": "config"} | NO_OFFSET
KINDS = {"camera": {"kind": "camera"}, "lidar": {"kind": "lidar"}}
OFF = make_pose(None, [0.01, 0.0, 0.0])
MIXED = [("board", None)] * 7 + [("cylinder", None)] * 3
SPLIT_HALVES = {
    "adopted": [[], []],
    "sensors": {
        "lidar": {
            "shift": [0.003, 0.0, 0.004, 0.0, 0.0, 0.01],
            "sigma": [0.002] * 6,
            "nees": 6.0,
            "n_directions": 6,
            "placements": [5, 5],
        }
    },
}
DIVERSE = ([0, 0, 1], [0, 1, 0], [0, 1, 1], [0.3, 1, -1], [0.3, -0.2, 1])


def content(made, added_sigma_m=0.0):
    """solution.json of a Setup; added_sigma_m: of every pose, beyond the model."""
    sensors = {n: KINDS[n] for n in made.models}
    options = {"rig": "r", "sensors": sensors, "targets": {}, "sessions": ["s"]}
    known = {name: (OK, GUESS) for name in sensors}
    result = solve_synthetic_setup(made)
    suspected = find_suspected_errors(made, result, list_corrections_and_shifts(made))
    added = added_sigma_m**2 * np.eye(6)
    result = result.with_added_covariance(np.kron(np.eye(len(sensors)), added))
    told = solution_json(made, result, suspected, known, options)
    for sensor in told["sensors"].values():
        sensor["next_view"] = None
    return told | {"repeatability": [], "split_halves": SPLIT_HALVES}


def judged(made):
    return rig_findings(content(made), LIMITS)


@pytest.fixture(scope="module")
def clean():
    return content(make_synthetic_setup(0, MIXED))


def told(clean, change):
    """Findings on a clean solution after a change of it."""
    changed = copy.deepcopy(clean)
    change(changed)
    return rig_findings(changed, LIMITS)


def test_a_clean_log_passes_with_nothing_to_say(clean):
    assert rig_findings(clean, LIMITS) == ("pass", [], {"camera": "pass", "lidar": "pass"})


WRONG = {
    "squares 2 % larger": (SyntheticWorld(targets=scale_pattern(1.02)), "squares of board"),
    "squares 5 % larger": (SyntheticWorld(targets=scale_pattern(1.05)), "squares of board"),
    "focal length 1 % longer": (
        SyntheticWorld(camera=scale_focal_length(1.01)),
        "focal length of camera",
    ),
    "frame off by 1 cm": (SyntheticWorld(T_body_target={"board": OFF}), "T_body_target of board"),
}


@pytest.mark.parametrize("case", WRONG)
def test_a_wrong_size_lens_or_mount_does_not_pass_and_is_named_first(case):
    world, words = WRONG[case]
    level, found, _ = judged(make_synthetic_setup(0, MIXED, world))
    assert level in ("warn", "fail")
    assert found[0]["check"] == "suspected_error" and words in found[0]["text"]
    assert all("more placements" not in f["remedy"] for f in found)


@pytest.mark.parametrize(("added_sigma_m", "is_told"), [(0.0, True), (0.05, False)])
def test_an_error_that_moves_a_pose_within_its_reported_sigma_is_not_said_to_move_it(
    added_sigma_m, is_told
):
    """Squares 2 % too large move the camera by some 40 mm."""
    made = make_synthetic_setup(0, MIXED, SyntheticWorld(targets=scale_pattern(1.02)))
    _, found, _ = rig_findings(content(made, added_sigma_m), LIMITS)
    assert any("moves camera by" in f["text"] for f in found) == is_told


def test_an_outline_100_mm_too_long_does_not_pass_and_is_named():
    """Crossings of two edges lie 50 mm inside the outline; told to better than 1 mm."""
    _, found, levels = judged(
        make_synthetic_setup(0, MIXED, SyntheticWorld(targets=scale_outline(0.9, 1.0)))
    )
    assert levels == {"camera": "pass", "lidar": "warn"}
    assert found[0]["text"].startswith("likely error: the outline of board differs from outline_m")
    said = re.findall(r"edge (\d) ([\d.]+) ± ([\d.]+) mm inside", found[0]["text"])
    assert {edge for edge, _, _ in said} == {"2", "4"}
    for _, off, sigma in said:
        assert float(off) == pytest.approx(50, abs=3 * float(sigma)) and float(sigma) < 1
    assert "Measure the sides of board" in found[0]["remedy"]


def test_cylinders_with_parallel_axes_fail_however_many_there_are():
    level, found, _ = judged(make_synthetic_setup(0, [("cylinder", [0, 0, 1])] * 30))
    assert level == "fail"
    assert "the cylinders' common axis" in found[0]["text"]
    assert "tilted by 30° or more" in found[0]["remedy"]


def test_cylinders_that_are_parallel_to_2_degrees_fail_too():
    """The slight tilt fixes the pose on paper, by what no model of the cylinder is true to."""
    rng = np.random.default_rng(1)
    axes = [[*rng.normal(0, np.radians(1), 2), 1.0] for _ in range(12)]
    level, found, _ = judged(
        make_synthetic_setup(0, [("cylinder", a) for a in axes], measurement_noise_factor=0.1)
    )
    assert level == "fail"
    assert any(f["check"] == "tilt_deg" and "tilted by 30°" in f["remedy"] for f in found)


def test_five_diverse_cylinders_pass():
    assert judged(make_synthetic_setup(0, [("cylinder", axis) for axis in DIVERSE]))[0] == "pass"


def test_a_large_sigma_with_a_good_fit_asks_for_views_and_says_how_many(clean):
    def widen(s):
        s["sensors"]["camera"]["covariance"] = np.diag([1e-4] * 3 + [1e-8] * 3).tolist()

    level, found, levels = told(clean, widen)
    assert (level, levels["camera"], levels["lidar"]) == ("warn", "warn", "pass")
    (only,) = found
    assert only["check"] == "sigma_m" and only["value"] == pytest.approx(0.01)
    assert only["limit"] == LIMITS["warn_sigma_m"]
    assert only["text"] == "camera: position σ 10 mm, warn above 5 mm"
    assert "About 28 placements like the 7 so far would reach the limit." in only["remedy"]


def test_a_large_sigma_with_a_bad_fit_does_not_ask_for_views(clean):
    def spoil(s):
        s["sensors"]["camera"]["covariance"] = np.diag([1e-4] * 3 + [1e-8] * 3).tolist()
        s["sensors"]["camera"]["fit_by_kind"]["pattern_corner"]["systematic_ratio"] = 5.0

    _, found, _ = told(clean, spoil)
    assert [f["check"] for f in found] == ["systematic", "sigma_m"]
    assert found[1]["remedy"] == "Correct the other findings first: they increase σ."


NEXT_VIEW = {"target": "board", "description": "2 m away", "direction": "x", "unit": "m"}


@pytest.mark.parametrize(("four_mm", "helps"), [(9.8, False), (5.0, True)])
def test_more_views_are_said_not_to_help_only_where_four_more_leave_sigma_as_it_is(
    clean, four_mm, helps
):
    def widen(s):
        camera = s["sensors"]["camera"]
        camera["covariance"] = np.diag([1e-4] * 3 + [1e-8] * 3).tolist()
        camera["next_view"] = NEXT_VIEW | {
            "sigma": 0.010,
            "sigma_one": 0.0099,
            "sigma_four": four_mm / 1e3,
        }

    _, (only,), _ = told(clean, widen)
    assert ("More views would not help" in only["remedy"]) is not helps
    assert ("About 28 placements" in only["remedy"]) is helps


@pytest.mark.parametrize(
    ("sensor", "kind", "noise", "level"),
    [
        ("camera", "pattern_corner", 0.43, "pass"),  # px, as real images have
        ("camera", "pattern_corner", 1.5, "warn"),
        ("camera", "pattern_corner", 6.0, "fail"),
        ("camera", "cylinder_limb", 1.5, "pass"),
        ("camera", "cylinder_limb", 3.0, "warn"),
        ("lidar", "target_surface", 0.03, "pass"),  # m, as real lidars have
        ("lidar", "target_surface", 0.06, "warn"),
        ("lidar", "target_surface", 0.25, "fail"),
        ("lidar", "board_outline", np.radians(0.8), "pass"),
        ("lidar", "board_outline", np.radians(1.5), "warn"),
    ],
)
def test_noise_has_limits_in_px_m_and_degrees_whatever_an_ideal_sensor_would_have(
    clean, sensor, kind, noise, level
):
    def spoil(s):
        fits = s["sensors"][sensor]["fit_by_kind"]
        like = fits.get(kind, fits.get("pattern_corner"))
        fits[kind] = like | {"sigma": noise, "ideal_sigma": 1e-6, "repeated": None}

    assert told(clean, spoil)[0] == level


REPEATED = {"image": 0.0, "target": 0.0, "views": 0.0}
CAUSES = {
    "image": "62 % repeats at the same place of the image in all placements (lens)",
    "target": "62 % repeats at the same corners (board not flat, or its print)",
    "views": "it differs between placements (blur, motion or distance)",
    "": "nothing of it repeats (blur, focus or compression)",
}


@pytest.mark.parametrize("cause", CAUSES)
def test_corners_that_scatter_are_told_against_an_ideal_image_with_their_cause(clean, cause):
    def spoil(s):
        fit = s["sensors"]["camera"]["fit_by_kind"]["pattern_corner"]
        shares = {k: 0.62 if k == cause else 0.0 for k in REPEATED}
        fit.update(sigma=1.43, ideal_sigma=0.013, repeated=shares)

    found = told(clean, spoil)[1]
    (noise,) = (f for f in found if f["check"] == "corner_noise_px")
    assert noise["text"] == (
        "camera: corners scatter by 1.43 px, warn above 1 px; pattern corner measurements scatter "
        f"by 1.4 px where these images would allow 0.013 px: {CAUSES[cause]}"
    )


def test_a_lens_that_repeats_in_all_images_comes_before_the_mocap_noise_that_it_looks_like(clean):
    def spoil(s):
        s["noise"]["mocap_factor"] = 7.5
        fit = s["sensors"]["camera"]["fit_by_kind"]["pattern_corner"]
        fit.update(sigma=0.49, ideal_sigma=0.013, repeated=REPEATED | {"image": 0.45})

    _, (lens, mocap), _ = told(clean, spoil)
    assert (lens["check"], mocap["check"]) == ("scatter_cause", "mocap_factor")
    assert lens["remedy"].startswith("Set solve.estimate.intrinsics: true")
    assert lens["change"] == {
        "file": "config/config.yaml",
        "key": "solve.estimate.intrinsics",
        "value": True,
    }
    assert mocap["remedy"].startswith("Correct the findings above first") and not mocap["change"]


def test_errors_of_the_motion_capture_are_told_in_mm_and_degrees(clean):
    scatter = {
        "configured": {"m": 1.5e-4, "rad": np.radians(0.02)},
        "estimated": {"m": 1.4e-3, "rad": np.radians(0.14)},
    }

    def spoil(s):
        s["noise"].update(mocap_factor=9.0, mocap_scatter=scatter)

    level, (only,), _ = told(clean, spoil)
    assert level == "warn"
    assert "; they scatter by 1.4 mm, 0.14°, and the config states 0.15 mm, 0.02°" in only["text"]
    assert "mocap.pose_bias_sigma: {xyz_m: 0.0014, rpy_deg: 0.14}" in only["remedy"]
    scatter["estimated"]["m"] = 0.06
    assert told(clean, spoil)[0] == "fail"


SPOILED = {
    "mocap_factor": (lambda s: s["noise"].update(mocap_factor=31.0), "warn", 31.0),
    "rejected": (lambda s: s["sensors"]["lidar"].update(rejected_share=0.3), "warn", 0.3),
    "placements": (lambda s: s["sensors"]["lidar"].update(placements=2), "fail", 2),
    "guess_deviation_sigma": (
        lambda s: s["sensors"]["lidar"].update(guess_deviation_in_sigma=4.0),
        "warn",
        4.0,
    ),
    "leave_one_out": (
        lambda s: s["sensors"]["lidar"]["leave_one_out"].update(error_over_sigma=5.0),
        "fail",
        5.0,
    ),
    "split_half": (
        lambda s: s["split_halves"]["sensors"]["lidar"].update(nees=54.0),
        "warn",
        9.0,
    ),
    "tail_share": (
        lambda s: s["sensors"]["lidar"]["fit_by_kind"]["target_surface"].update(tail_share=0.05),
        "warn",
        0.05,
    ),
    "systematic": (
        lambda s: s["sensors"]["lidar"]["fit_by_kind"]["target_surface"].update(
            systematic_ratio=20.0
        ),
        "fail",
        20.0,
    ),
    "convergence": (lambda s: s.update(has_converged=False), "warn", None),
}


@pytest.mark.parametrize("check", SPOILED)
def test_every_limit_is_told_with_its_value_and_a_remedy(clean, check):
    change, level, value = SPOILED[check]
    overall, found, _ = told(clean, change)
    assert overall == level
    (only,) = found
    assert (only["check"], only["level"], only["value"]) == (check, level, value)
    assert only["remedy"]
    if value is not None:
        assert only["limit"] == LIMITS[f"{level}_{check}"]
        above = value / only["limit"]
        assert only["ratio"] == pytest.approx(1 / above if check == "placements" else above)
        assert f"{level} {'below' if check == 'placements' else 'above'}" in only["text"]


def test_what_fails_comes_first_and_causes_before_effects(clean):
    def spoil(s):
        s["has_converged"] = False
        s["noise"]["mocap_factor"] = 3.0
        s["sensors"]["camera"]["covariance"] = np.diag([1e-2] * 3 + [1e-8] * 3).tolist()

    _, found, _ = told(clean, spoil)
    assert [f["check"] for f in found] == ["sigma_m", "mocap_factor", "convergence"]


def test_a_suspicion_that_moves_nothing_is_not_told(clean):
    shift = {n: {"m": 1e-5, "rad": 1e-6, "sigmas": 0.5} for n in ("camera", "lidar")}
    suspected = {"name": "square_size", "subject": "board", "description": "so", "remedy": "do"}
    change = {"file": "config/targets/board.yaml", "key": "pattern.square_m", "value": 0.0808}
    suspected |= {
        "p_value": 1e-20,
        "log_likelihood_gain": 50.0,
        "explained_share": {"camera/pattern_corner": 0.5},
        "alternatives": [],
        "change": change,
    }
    assert (
        told(clean, lambda s: s["suspected_errors"].append(suspected | {"pose_shift": shift}))[1]
        == []
    )
    far = shift | {"camera": {"m": 0.03, "rad": 0.0, "sigmas": 40.0}}
    level, found, levels = told(
        clean, lambda s: s["suspected_errors"].append(suspected | {"pose_shift": far})
    )
    assert level == "fail" and levels == {"camera": "fail", "lidar": "pass"}
    assert found[0]["text"] == "likely error: so; correcting it moves camera by 30 mm and 0°"
    assert found[0]["change"] == change
    rival = {"description": "or not so", "remedy": "look"}
    far = suspected | {"pose_shift": far, "alternatives": [rival]}
    _, found, _ = told(clean, lambda s: s["suspected_errors"].append(far))
    assert found[0]["text"].endswith("; or else or not so (only one of them is true)")
    assert (found[0]["remedy"], found[0]["change"]) == ("Do. If that is right: look", None)
    change.update(file="config/config.yaml", key="solve.estimate.intrinsics", value=True)
    _, found, _ = told(clean, lambda s: s["suspected_errors"].append(far))
    assert found[0]["change"] == change


def test_a_suspicion_that_moves_nothing_is_told_if_it_explains_a_noise_above_its_limit(clean):
    def spoil(s):
        still = {n: {"m": 0.0, "rad": 0.0, "sigmas": 0.0} for n in ("camera", "lidar")}
        s["suspected_errors"].append(
            {
                "name": "distortion",
                "subject": "camera",
                "description": "bent",
                "remedy": "set it",
                "p_value": 1e-20,
                "explained_share": {"mocap_noise": 0.9},
                "pose_shift": still,
                "alternatives": [],
                "change": None,
            }
        )

    assert told(clean, spoil)[1] == []

    def spoil_both(s):
        spoil(s)
        s["noise"]["mocap_factor"] = 3.0

    _, (cause, effect), _ = told(clean, spoil_both)
    assert cause["text"].endswith("correcting it explains 90 % of the errors of the MCS poses")
    assert (cause["check"], effect["check"]) == ("suspected_error", "mocap_factor")


def test_a_cause_comes_before_a_failed_effect_of_it(clean):
    def spoil(s):
        camera = s["sensors"]["camera"]
        camera["covariance"] = np.diag([1e-2] * 3 + [1e-8] * 3).tolist()
        fit = camera["fit_by_kind"]["pattern_corner"]
        fit.update(systematic_ratio=5.0, repeated=REPEATED | {"image": 0.5})

    level, found, _ = told(clean, spoil)
    assert level == "fail"
    assert [f["check"] for f in found] == ["scatter_cause", "sigma_m", "systematic"]


@pytest.mark.parametrize(("ms", "chance", "warned"), [(25, 1e-9, 1), (3, 1e-9, 0), (25, 1e-3, 0)])
def test_a_clock_that_is_off_and_not_to_be_estimated_is_warned_of(clean, ms, chance, warned):
    still = {n: {"m": 0.0, "rad": 0.0, "sigmas": 0.0} for n in ("camera", "lidar")}
    about = {
        "name": "time_offset",
        "subject": "camera",
        "description": "the stamps of camera are early",
    }
    about |= {"remedy": "write it", "estimate": [ms / 1e3], "p_value": chance, "pose_shift": still}
    about["change"] = {"file": "config/config.yaml", "key": "solve.estimate.time_offset"}
    _, found, levels = told(clean, lambda s: s["suspected_errors"].append(about))
    assert levels["camera"] == ("warn" if warned else "pass")
    if warned:
        ((check, value, text),) = [(f["check"], f["value"], f["text"]) for f in found]
        assert (check, value) == ("time_offset_s", 0.025)
        assert found[0]["change"] == about["change"]
        assert "the stamps of camera are early, and solve.estimate.time_offset is false" in text


@pytest.mark.parametrize(
    ("share", "sigma", "level"),
    [(0.004, 2e-4, "warn"), (-0.03, 2e-4, "fail"), (5e-4, 1e-5, "pass"), (0.004, 0.002, "pass")],
)
def test_an_estimated_error_of_the_scale_is_warned_of_above_its_limit_if_it_is_clear(
    clean, share, sigma, level
):
    """Limits 0.1 % and 2 %; 0.4 ± 0.2 % is not clear."""
    scales = {"s": {"value": share, "sigma": sigma}}
    found_level, found, _ = told(clean, lambda s: s.update(mocap_scales=scales))
    assert found_level == level and len(found) == (level != "pass")
    if level == "warn":
        assert found[0]["text"] == (
            "distances of the motion capture in session s err by 0.4 % (± 0.02 %), and the poses "
            "are corrected for it, warn above 0.1 %"
        )


def test_a_sensor_without_a_pose_fails_with_its_own_remedy(clean):
    status = {"ok": False, "reason": "no view", "found": "", "expected": "", "remedy": "look"}
    status["change"] = {"file": "config/rigs/{rig}.yaml", "key": "mocap.map", "value": "world"}
    level, found, _ = told(
        clean, lambda s: s["sensors"]["lidar"].update(status=status, covariance=None)
    )
    assert level == "fail"
    assert (found[0]["text"], found[0]["remedy"]) == ("lidar: no view", "look")
    rig = clean["rig"]
    assert found[0]["change"] == status["change"] | {"file": f"config/rigs/{rig}.yaml"}


def test_a_value_that_is_no_number_fails():
    assert level_by_limits(float("nan"), LIMITS, "sigma_m") == "fail"


def moved(shift, prior=0.002, held=()):
    """Findings of a rig whose board was estimated elsewhere than stated, by (6,), m and rad."""
    made = make_synthetic_setup(0, MIXED)
    told = content(made)
    told["targets"] = {"board": {"shift": shift, "prior_sigma": [prior] * 3 + [0.005] * 3}}
    told["targets"]["board"]["undetermined"] = list(held)
    told["targets"]["board"]["T_body_target"] = {"xyz_m": shift[:3], "quat_xyzw": [0, 0, 0, 1]}
    return [f for f in rig_findings(told, LIMITS)[1] if f["check"] == "target_mount"]


def test_a_board_estimated_6_mm_from_where_it_was_stated_to_2_mm_passes():
    assert moved([0.0059, 0, 0, 0, 0, 0]) == []


def test_what_nothing_tells_of_a_mount_is_named_with_what_to_record():
    (found,) = moved([0.0] * 6, held=["translation along y"])
    assert found["level"] == "warn"
    assert "T_body_target of board is undetermined in translation along y" in found["text"]
    assert found["remedy"].startswith("Tilt board by 30° or more about two other axes")


@pytest.mark.parametrize(("mm", "level"), [(10, "warn"), (25, "fail")])
def test_a_board_estimated_farther_off_is_named_with_its_shift_and_what_to_write(mm, level):
    (found,) = moved([0, mm / 1e3, 0, 0, 0, 0.003])
    assert found["level"] == level
    assert f"T_body_target of board differs from the config by {mm} mm and 0.17°" in found["text"]
    assert "Set T_body_target of board" in found["remedy"]
    assert found["change"] == {
        "file": "config/targets/board.yaml",
        "key": "T_body_target",
        "value": {"xyz_m": [0, mm / 1e3, 0], "quat_xyzw": [0, 0, 0, 1]},
    }


@pytest.mark.parametrize(("offset", "level"), [(0.05, []), (0.2, ["warn"]), (-0.6, ["fail"])])
def test_a_clock_far_from_its_first_guess_is_told_with_what_to_write(clean, offset, level):
    late = copy.deepcopy(clean)
    late["sensors"]["lidar"]["time_offset_s"] = {"value": offset, "sigma": 1e-4}
    found = [f for f in rig_findings(late, LIMITS)[1] if f["check"] == "time_offset_s"]
    assert [f["level"] for f in found] == level
    assert all(f"Set sensors.lidar.time_offset_s: {offset:.4f}" in f["remedy"] for f in found)
    key = {"file": "config/rigs/r.yaml", "key": "sensors.lidar.time_offset_s", "value": offset}
    assert all(f["change"] == key for f in found)


@pytest.mark.parametrize(("mm", "level"), [(0.1, []), (3.0, ["warn"]), (30.0, ["fail"])])
def test_a_sensor_that_moved_between_sessions_is_called_by_name(clean, mm, level):
    told = copy.deepcopy(clean)
    row = {"sensor": "camera", "sigma": [1e-5] * 6, "n_other_sessions": 1, "p_value": 1e-30}
    row["markers"] = {"shift": [mm / 2e3, 0, 0, 0, 0, 0], "explained_share": 0.5}
    told["repeatability"] = [
        row | {"session": s, "shift": [sign * mm / 1e3, 0, 0, 0, 0, 0]}
        for s, sign in (("evening", 1), ("morning", -1))
    ]
    found = [f for f in rig_findings(told, LIMITS)[1] if f["check"] == "sensor_moved"]
    assert [f["level"] for f in found] == level
    assert all(f"differs by {mm:.2g} mm and 0° from the other" in f["text"] for f in found)
    assert all(f["sensors"] == ["camera"] for f in found)


@pytest.mark.parametrize(("share", "markers_moved"), [(0.99, True), (0.6, False)])
def test_sensors_that_all_shift_alike_between_sessions_are_one_finding_on_the_markers(
    clean, share, markers_moved
):
    told = copy.deepcopy(clean)
    row = {"sigma": [1e-5] * 6, "n_other_sessions": 1, "p_value": 1e-30}
    told["repeatability"] = [
        row
        | {
            "session": session,
            "sensor": sensor,
            "shift": [sign * 0.005, 0, 0, 0, 0, 0],
            "markers": {"shift": [0, sign * 0.004, 0, 0, 0, 0], "explained_share": share},
        }
        for session, sign in (("morning", -1), ("evening", 1))
        for sensor in ("camera", "lidar")
    ]
    found = [f for f in rig_findings(told, LIMITS)[1] if f["check"] == "sensor_moved"]
    assert len(found) == (1 if markers_moved else 2)
    if markers_moved:
        assert found[0]["text"] == (
            "the robot's markers sit elsewhere in session evening than in the other sessions, "
            "by 4 mm and 0° in the robot frame: all sensors shift alike"
        )
        key = {"file": "config/config.yaml", "key": "sessions.evening.remounted", "value": True}
        assert (found[0]["change"], found[0]["sensors"]) == (key, ["camera", "lidar"])


def test_sessions_that_differ_by_chance_are_none_of_the_verdict(clean):
    told = copy.deepcopy(clean)
    row = {"sensor": "camera", "session": "evening", "sigma": [1e-3] * 6, "n_other_sessions": 1}
    row["markers"] = None
    told["repeatability"] = [row | {"p_value": 0.01, "shift": [0.003, 0, 0, 0, 0, 0]}]
    assert not [f for f in rig_findings(told, LIMITS)[1] if f["check"] == "sensor_moved"]


def test_halves_that_chose_other_corrections_are_told_with_both_choices_and_the_key(clean):
    told = copy.deepcopy(clean)
    told["split_halves"]["adopted"] = [[{"name": "beam_offsets", "subject": "lidar"}], []]
    told["split_halves"]["sensors"]["lidar"]["nees"] = 54.0
    (found,) = rig_findings(told, LIMITS)[1]
    assert "differ by 5 mm and 0.57°, their squared difference is 9 times" in found["text"]
    assert "beam offsets of lidar, and none" in found["remedy"]
    assert "solve.estimate.lidar_corrections to false" in found["remedy"]
    assert "multiply σ by 3.0" in found["remedy"]


def test_too_few_placements_for_halves_are_none_of_the_verdict(clean):
    told = copy.deepcopy(clean) | {"split_halves": None}
    assert rig_findings(told, LIMITS)[0] == "pass"


def test_a_clock_that_was_set_while_recording_is_a_reason_with_its_advice(clean):
    step = {"at_s": 7.0, "size_s": 0.4, "text": "/tf: jumped by +400 ms at 7.0 s"}
    audit = {"clock_steps": [step | {"remedy": "Make two sessions of this log."}]}
    level, (found,), levels = rig_findings(clean, LIMITS, {"s": audit, "t": {"clock_steps": []}})
    assert (level, set(levels.values())) == ("warn", {"pass"})
    assert (found["check"], found["remedy"]) == ("clock_step", "Make two sessions of this log.")
    assert found["text"] == "s: /tf: jumped by +400 ms at 7.0 s"
