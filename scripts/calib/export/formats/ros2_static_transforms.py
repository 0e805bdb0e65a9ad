"""ROS 2 static transforms as YAML: one geometry_msgs/msg/TransformStamped for every frame."""

from typing import Any

import yaml

from calib.export.calibrated_scene import ExportScene, format_hash_comment
from calib.geometry.se3 import pose_to_quat
from calib.io.logs.ros_messages import FrameTransform
from calib.io.status import Status

TITLE = "static transforms as ROS 2 messages write them (TransformStamped)"
FILE_PATTERNS: tuple[str, ...] = ("static_transforms.yaml",)
CONVENTION = (
    "each maps points of child_frame_id into frame_id, p_parent = R(rotation) p_child + "
    "translation; metres, quaternions x y z w"
)


def render_files(scene: ExportScene) -> dict[str, str | bytes | Status]:
    """Render static_transforms.yaml."""
    head = [f"Static transforms of rig {scene.rig} for ROS 2: {CONVENTION}."]
    head += [*scene.describe_verdict(), *scene.describe_worked_points()]
    content = {"transforms": [_transform_json(t) for t in scene.static_transforms()]}
    text = yaml.safe_dump(content, sort_keys=False)
    return {"static_transforms.yaml": format_hash_comment(head) + text}


def _transform_json(transform: FrameTransform) -> dict[str, Any]:
    xyz = transform.T_parent_child[:3, 3].tolist()
    quat = pose_to_quat(transform.T_parent_child).tolist()
    return {
        "header": {"frame_id": transform.parent},
        "child_frame_id": transform.child,
        "transform": {
            "translation": dict(zip("xyz", xyz, strict=True)),
            "rotation": dict(zip("xyzw", quat, strict=True)),
        },
    }
