"""ROS 2 static transforms as YAML: geometry_msgs/msg/TransformStamped, one for every frame."""

import yaml

from calib.export.calibrated_scene import format_hash_comment
from calib.geometry.se3 import pose_to_quat

TITLE = "static transforms as ROS 2 messages write them (TransformStamped)"
CONVENTION = (
    "each maps points of child_frame_id into frame_id, p_parent = R(rotation) p_child + "
    "translation; metres, quaternions x y z w"
)


def render_files(scene):
    """static_transforms.yaml."""
    head = format_hash_comment([f"Static transforms of rig {scene.rig} for ROS 2: {CONVENTION}."])
    body = yaml.safe_dump(
        {"transforms": [_transform_json(e) for e in scene.static_transforms()]}, sort_keys=False
    )
    return {
        "static_transforms.yaml": head + format_hash_comment(scene.describe_worked_points()) + body
    }


def _transform_json(edge):
    xyz, quat = edge.T_parent_child[:3, 3].tolist(), pose_to_quat(edge.T_parent_child).tolist()
    return {
        "header": {"frame_id": edge.parent},
        "child_frame_id": edge.child,
        "transform": {
            "translation": dict(zip("xyz", xyz, strict=True)),
            "rotation": dict(zip("xyzw", quat, strict=True)),
        },
    }
