"""ROS 2 static transforms as YAML: geometry_msgs/msg/TransformStamped, one for every frame."""

import yaml

from calib.export.calibrated_scene import comment
from calib.geometry import se3

TITLE = "static transforms as ROS 2 messages write them (TransformStamped)"
CONVENTION = (
    "each maps points of child_frame_id into frame_id, p_parent = R(rotation) p_child + "
    "translation; metres, quaternions x y z w"
)


def render(scene):
    """static_transforms.yaml."""
    head = comment([f"Static transforms of rig {scene.rig} for ROS 2: {CONVENTION}."])
    body = yaml.safe_dump({"transforms": [_transform(e) for e in scene.edges()]}, sort_keys=False)
    return {"static_transforms.yaml": head + comment(scene.worked()) + body}


def _transform(edge):
    xyz, quat = edge.T[:3, 3].tolist(), se3.to_quat(edge.T).tolist()
    return {
        "header": {"frame_id": edge.parent},
        "child_frame_id": edge.child,
        "transform": {
            "translation": dict(zip("xyz", xyz, strict=True)),
            "rotation": dict(zip("xyzw", quat, strict=True)),
        },
    }
