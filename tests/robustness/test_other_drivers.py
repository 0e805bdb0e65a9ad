"""Logs of other drivers, from the log to the extrinsics, and what of a log is not read."""

import json
from types import SimpleNamespace

import numpy as np
import pytest

from calib.decoding.decoded_log import DecodedLog, build_frame_columns, infer_stream_clocks
from calib.decoding.sensor_audit import audit_sensor
from calib.estimation.problem_assembly import SessionKeypoints, reject_lens_mismatches
from calib.io.logs.ros_messages import CLOUD_TYPE, IMAGE_TYPE
from calib.io.parquet_tables import read_table
from calib.io.status import OK
from calib.io.table_schemas import CAMERA_VIEWS_SCHEMA, LIDAR_VIEWS_SCHEMA
from calib.sensors.lens_from_log import with_lens_from_log
from helpers.small_run import SMALL_ARGUMENTS, run_to_completion, simulate_into
from simulate import draw_sessions, parse_simulation_arguments
from simulation.config_and_truth import write_simulated_config, write_truth
from simulation.ros_log import write_simulated_mcap
from simulation.session_recording import generate_messages

pytestmark = [pytest.mark.pipeline, pytest.mark.slow]

RESULTS = "results/sim"


def errors(folder):
    """{sensor: (m, rad)} by which the poses found are off."""
    found = json.loads((folder / RESULTS / "calibration.json").read_text())["sensors"]
    true = json.loads((folder / "truth.json").read_text())["sensors"]
    out = {}
    for name, sensor in found.items():
        T = np.array(true[name]["T_robot_sensor"]["matrix"])
        off = np.linalg.inv(T) @ np.array(sensor["T_robot_sensor"]["matrix"])
        out[name] = np.linalg.norm(off[:3, 3]), np.linalg.norm(off[:3, :3] - np.eye(3)) / np.sqrt(2)
    return out


def audit(folder):
    return json.loads((folder / RESULTS / "sim/log.json").read_text())["sensors"]


def offset(folder, sensor):
    found = json.loads((folder / RESULTS / "calibration.json").read_text())["sensors"]
    return found[sensor]["time_offset_s"]


def calibrated(folder, arguments):
    simulate_into(folder, f"{SMALL_ARGUMENTS} {arguments}")
    run_to_completion(folder, f"{RESULTS}/calibration.json")
    return folder


def test_organised_clouds_on_a_clock_and_mosaics_with_camera_info_give_the_poses(tmp_path):
    """0.1 µm for the lidar; for the camera 0.02 mm, which the colours of a mosaic leave."""
    calibrated(tmp_path, "--lidar robosense --encoding bayer_grbg8 --camera-info")
    found, told = errors(tmp_path), audit(tmp_path)
    assert found["velodyne"][0] < 1e-7 and found["velodyne"][1] < 1e-7
    assert found["camera"][0] < 2e-5 and found["camera"][1] < 1e-5
    assert told["camera"]["inferred"]["lens"] == "K and D of CameraInfo (plumb_bob)"
    guess = json.loads((tmp_path / RESULTS / "sim/camera/guess.json").read_text())
    assert guess["camera"] == told["camera"]["camera"]
    assert guess["camera"]["size_px"] == [900, 700]
    assert "on the clock of the stamps" in told["velodyne"]["inferred"]["time"]
    assert offset(tmp_path, "velodyne")["value"] == pytest.approx(0, abs=1e-4)


def test_clouds_without_time_and_ring_give_the_pose_but_no_clock(tmp_path):
    calibrated(tmp_path, "--lidar plain --encoding yuv422")
    found, told = errors(tmp_path), audit(tmp_path)["velodyne"]
    assert found["velodyne"][0] < 1e-7 and found["velodyne"][1] < 1e-7
    assert found["camera"][0] < 1e-5
    assert told["layout"]["point_time"] is None
    assert len(told["layout"]["beams"]["elevation_deg"]) == 16
    assert "the time offset of the sensor cannot be estimated" in told["inferred"]["time"]
    views, _, _ = read_table(
        tmp_path / RESULTS / "sim/velodyne/moving_views.parquet", LIDAR_VIEWS_SCHEMA
    )
    assert len(views["view"]) == 0
    assert offset(tmp_path, "velodyne") is None


def test_custom_messages_of_a_livox_and_grey_of_sixteen_bits_give_the_poses(tmp_path):
    """Without outlines, the views in motion count as much as those at rest: their poses, between
    samples of the MCS, are off by 0.01 mm."""
    calibrated(tmp_path, "--lidar livox_custom --encoding mono16 --camera-info")
    found, told = errors(tmp_path), audit(tmp_path)
    assert found["velodyne"][0] < 1e-4 and found["camera"][0] < 1e-5
    assert told["velodyne"]["layout"]["beams"] is None
    assert told["camera"]["inferred"]["image"] == "mono16, 900 x 700 px"


def damaged(messages):
    """Every fourth cloud and image claims to be larger than it is."""
    seen = {}
    for t, topic, kind, message in messages:
        seen[kind] = seen.get(kind, 0) + 1
        if kind in (CLOUD_TYPE, IMAGE_TYPE) and seen[kind] % 4 == 0:
            message.width *= 1000
        yield t, topic, kind, message


def test_damaged_messages_are_counted_by_their_reason_and_the_others_serve(tmp_path):
    args = parse_simulation_arguments([str(tmp_path), *SMALL_ARGUMENTS.split()])
    sessions, guesses = draw_sessions(args)
    write_simulated_config(tmp_path / "config", args.rig, sessions, guesses)
    write_truth(tmp_path / "truth.json", sessions, guesses)
    (tmp_path / "logs").mkdir()
    write_simulated_mcap(tmp_path / "logs/sim.mcap", damaged(generate_messages(sessions[0])))
    run_to_completion(tmp_path, f"{RESULTS}/calibration.json")
    found = errors(tmp_path)
    assert found["velodyne"][0] < 1e-7 and found["camera"][0] < 1e-5
    for sensor, schema in (
        ("velodyne", LIDAR_VIEWS_SCHEMA),
        ("camera", CAMERA_VIEWS_SCHEMA),
    ):
        views, _, _ = read_table(tmp_path / RESULTS / f"sim/{sensor}/views.parquet", schema)
        reasons = [r for r in np.asarray(views["reason"], str) if r.startswith("cannot be read: ")]
        assert reasons and all("the message is damaged" in r for r in reasons)
        assert not np.asarray(views["kept"])[np.asarray(views["reason"], str) != ""].any()


# --- what is not read


def status(kind, message_type):
    """Of the audit of a sensor whose topic carries that type."""
    sensor = {"kind": kind, "topic": "/it"}
    recording = DecodedLog(options(sensor))
    topics, columns = {"/it": (message_type, 5)}, {"stamp_ns": [], "sensor": []}
    return audit_sensor("it", recording, topics, columns, {})["status"]


def options(sensor):
    """Of decode, with that sensor alone."""
    return {"sensors": {"it": sensor}, "mocap": {"topics": [], "map": "map"}, "bodies": []}


@pytest.mark.parametrize(
    "kind, message_type, words",
    [
        ("lidar", "velodyne_msgs/msg/VelodyneScan", "the lidar's packets. Replay the log through"),
        (
            "lidar",
            "ouster_sensor_msgs/msg/PacketMsg",
            "the lidar's packets. Replay the log through",
        ),
        ("lidar", "ouster_ros/msg/PacketMsg", "the lidar's packets. Replay the log through"),
        ("lidar", "hesai_ros_driver/msg/UdpFrame", "the lidar's packets. Replay the log through"),
        ("lidar", "pandar_msgs/msg/PandarScan", "the lidar's packets. Replay the log through"),
        ("lidar", "nebula_msgs/msg/NebulaPackets", "the lidar's packets. Replay the log through"),
        ("lidar", "rslidar_msg/msg/RslidarPacket", "the lidar's packets. Replay the log through"),
        (
            "lidar",
            "point_cloud_interfaces/msg/CompressedPointCloud2",
            "Decompress it with `ros2 run point_cloud_transport republish`",
        ),
        ("lidar", "sensor_msgs/msg/MultiEchoLaserScan", "Choose one echo with laser_proc"),
        ("lidar", "sensor_msgs/msg/PointCloud", "Convert it with point_cloud_converter"),
        (
            "lidar",
            "foxglove.PointCloud",
            "Write it as foxglove_msgs/msg/PointCloud in ROS encoding",
        ),
        ("camera", "ffmpeg_image_transport_msgs/msg/FFMPEGPacket", "A video's frames cannot be"),
        ("camera", "foxglove_msgs/msg/CompressedVideo", "A video's frames cannot be read alone"),
        ("camera", "foxglove.CompressedVideo", "A video's frames cannot be read alone"),
        ("camera", "foxglove.CompressedImage", "Write it as foxglove_msgs/msg/CompressedImage in"),
        ("camera", "theora_image_transport/msg/Packet", "A video's frames cannot be read alone"),
        (
            "camera",
            "stereo_msgs/msg/DisparityImage",
            "Name the topic of an image, not of dispariti",
        ),
        (
            "camera",
            "std_msgs/msg/String",
            "Set `topic` to a topic of the camera, or record it in one of these types.",
        ),
        (
            "lidar",
            "sensor_msgs/msg/Image",
            "Set `topic` to a topic of the lidar, or record it in one of these types.",
        ),
    ],
)
def test_a_type_that_is_not_read_is_refused_with_what_to_do(kind, message_type, words):
    found = status(kind, message_type)
    assert not found["ok"] and found["reason"] == "topic /it carries another type"
    assert found["found"] == message_type and words in found["remedy"]
    assert ("PointCloud2" if kind == "lidar" else "CompressedImage") in found["expected"]


def test_a_sensor_whose_every_message_is_damaged_fails_in_words():
    stamp = SimpleNamespace(sec=1, nanosec=0)
    header = SimpleNamespace(stamp=stamp, frame_id="it")
    message = SimpleNamespace(
        __msgtype__=CLOUD_TYPE, header=header, fields=[],
        height=1, width=1, point_step=12, row_step=12, is_bigendian=False, data=np.zeros(12, "u1"),
    )  # fmt: skip
    recording = DecodedLog(options({"kind": "lidar", "topic": "/it"}))
    for i in range(3):
        place = {"log_time_ns": i, "data": b"", "file_index": 0, "index_at_log_time": 0}
        told = {"content": message, "header": header}
        recording.add_message(SimpleNamespace(topic="/it", type=CLOUD_TYPE, **told, **place))
    columns = build_frame_columns(recording.frame_rows, infer_stream_clocks(recording))
    topics = {"/it": (CLOUD_TYPE, 3)}
    found = audit_sensor("it", recording, topics, columns, {})["status"]
    assert found["reason"] == "clouds that cannot be read"
    assert found["found"] == "a cloud without x, y, z: its fields are "
    assert found["expected"] == "1 or more readable among the first 3"


# --- one lens in all sessions

LENS = {"model": "radtan", "size_px": [900, 700], "params": [800.0, 800, 450, 350, 0, 0, 0, 0]}
OTHER = LENS | {"params": [801.0, *LENS["params"][1:]]}


def session(name, camera=None):
    """A session of a camera, left, with that lens and a lidar without."""
    guesses = {"lidar": {"camera": None}} | dict.fromkeys(
        ["left"] if camera else [], {"camera": camera}
    )
    return SessionKeypoints(
        session=name,
        keypoints={"sensor": np.array(["left", "lidar", "left"])},
        placements={},
        T_robot_sensor={},
        guesses=guesses,
        statuses=dict.fromkeys(guesses, OK),
    )


def test_a_camera_with_another_lens_in_another_session_fails_and_leaves_the_lidar():
    found = reject_lens_mismatches([session("one", LENS), session("two", OTHER), session("three")])
    for made in found[:2]:
        assert made.keypoints["sensor"].tolist() == ["lidar"] and made.statuses["lidar"].ok
        status = made.statuses["left"]
        assert status.reason == "CameraInfo of left differs between sessions"
        assert status.found.startswith("radtan 800 800 450 350 0 0 0 0 in one and radtan 801 800")
        assert "write params" in status.remedy


def test_one_lens_in_all_sessions_is_that_of_the_camera():
    given = [session("one", LENS), session("two", LENS), session("three")]
    assert all(a is b for a, b in zip(reject_lens_mismatches(given), given, strict=True))
    guesses = [("left", {"camera": None}), ("left", {"camera": LENS}), ("lidar", {"camera": None})]
    blocks = {"left": {"kind": "camera", "topic": "/it"}, "lidar": {"kind": "lidar"}}
    found = with_lens_from_log(blocks, guesses)
    assert found["left"]["params"] == LENS["params"] and found["lidar"] == {"kind": "lidar"}
