"""One unit for all positions of a motion capture, told by the distances between wanted bodies."""

import numpy as np
import pytest

from calib.mocap.pose_faults import flag_single_poses
from calib.mocap.position_unit import find_position_unit
from helpers.log_containers import (
    BOARD_BODY,
    MAP_FRAME,
    NS_PER_MS,
    ROBOT_BODY,
    container_decode_options,
    decode_tables,
    make_container_rows,
    write_test_mcap,
)

TIMES_NS = np.arange(300) * 10 * NS_PER_MS
UTM_M = np.array([448123.4, 5410987.6, 231.0])
WANTED = {"robot", "board"}


def track(xyz_m, factor=1.0, times_ns=TIMES_NS):
    """Columns of a body that wanders by 1 cm about a place, in m times a factor."""
    xyz = xyz_m + 0.01 * np.random.default_rng(0).normal(size=(len(times_ns), 3))
    return {"log_time_ns": times_ns, "xyz": factor * xyz}


def unit_of(*tracks, wanted=WANTED):
    """The unit of bodies, each of a topic of its own: (name, columns)."""
    topics = {f"/{name}/pose": {("world", name): columns} for name, columns in tracks}
    return find_position_unit(topics, "world", wanted)


@pytest.mark.parametrize(("factor", "unit"), [(1, "m"), (1000, "mm")])
@pytest.mark.parametrize("origin", [[0, 0, 0], [0.03, 0.01, 0], [12, -9, 1], UTM_M])
def test_the_distance_of_two_bodies_tells_the_unit_wherever_the_origin_is(factor, unit, origin):
    robot, board = track(np.array(origin), factor), track(origin + np.array([2, 1, 0.5]), factor)
    assert unit_of(("robot", robot), ("board", board)).name == unit


def test_a_body_is_compared_where_it_is_at_the_same_time():
    """Both circle one place, opposite to each other: on average they are at the same place."""
    turn = np.linspace(0, 4 * np.pi, 300)
    round_it = 1500 * np.column_stack([np.cos(turn), np.sin(turn), 0 * turn])
    robot, board = ({"log_time_ns": TIMES_NS, "xyz": s * round_it} for s in (1, -1))
    found = unit_of(("robot", robot), ("board", board))
    assert found.name == "mm" and found.basis == "bodies are 3000 apart"


def test_frames_that_nobody_wants_say_nothing_of_the_unit():
    bodies = ("robot", track([0, 0, 0.3])), ("board", track([2, 0, 0.8]))
    assert unit_of(*bodies, ("utm", track(-UTM_M)), ("far", track([3000, 0, 0]))).name == "m"


def test_a_body_that_is_lost_at_zero_for_most_of_the_log_is_not_far_away():
    robot, board = track(UTM_M), track(UTM_M + [1, 2, 0])
    board["xyz"][:250] = 0
    assert unit_of(("robot", robot), ("board", board)).name == "m"


def test_a_robot_that_defines_the_map_stays_at_zero():
    robot = {"log_time_ns": TIMES_NS, "xyz": np.zeros((300, 3))}
    assert unit_of(("robot", robot), ("board", track([2, 1, 0], 1000))).name == "mm"


def test_damaged_positions_say_nothing_of_the_unit():
    robot, board = track([0, 0, 0.3]), track([2, 0, 0.8])
    board["xyz"][5:100:7] = np.nan
    board["xyz"][6:100:7] = 1e30
    assert unit_of(("robot", robot), ("board", board)).name == "m"


@pytest.mark.parametrize(("factor", "unit"), [(1, "m"), (1000, "mm")])
def test_one_body_alone_is_judged_by_the_transforms_that_lead_to_it(factor, unit):
    topics = {"/tf": {("world", "base"): track([3, 0, 0], factor)}}
    topics["/arm"] = {("base", "robot"): track([0.4, 0, 0.2], factor)}
    assert find_position_unit(topics, "world", {"robot", "base"}).name == unit


def test_places_on_earth_are_positions_and_1e30_m_is_not():
    quat = np.tile([0, 0, 0, 1.0], (2, 1))
    assert flag_single_poses(np.array([UTM_M, [0, 0, 1e30]]), quat).tolist() == ["", "out of range"]


def decoded_distance(tmp_path, factor, **mocap):
    """Median distance of board and robot, m, in a log of positions times a factor."""
    rows = make_container_rows("TFMessage", 60)
    for _, topic, _, message in rows:
        for transform in message.transforms if topic == "/tf" else ():
            place = transform.transform.translation
            place.x, place.y, place.z = factor * place.x, factor * place.y, factor * place.z
    options = container_decode_options("TFMessage")
    options["mocap"] |= mocap
    poses, _, audit = decode_tables(str(write_test_mcap(tmp_path / "a.mcap", rows)), options)
    robot, board = (poses["xyz"][poses["body"] == b] for b in (ROBOT_BODY, BOARD_BODY))
    assert options["mocap"]["map"] == MAP_FRAME
    return float(np.median(np.linalg.norm(board - robot, axis=1))), audit["mocap"]["/tf"]["found"]


def test_the_key_mocap_unit_goes_before_what_the_distances_tell(tmp_path):
    true, _ = decoded_distance(tmp_path, 1)
    inferred, notes = decoded_distance(tmp_path, 1000)
    assert inferred == pytest.approx(true)
    assert notes == [f"positions read as millimetres: bodies are {1000 * true:.0f} apart"]
    as_metres, notes = decoded_distance(tmp_path, 1000, unit="m")
    assert as_metres == pytest.approx(1000 * true) and notes == []
