"""The examples of targets in docs/targets.md are valid configs."""

import re
from pathlib import Path

import yaml

from calib.io.config import validate_and_complete
from calib.targets.target_shapes import target_from_config

PAGE = Path(__file__).parents[3] / "docs" / "targets.md"
EXAMPLES = re.findall(r"```yaml\n(.*?)```", PAGE.read_text(), re.DOTALL)


def test_every_example_of_a_target_is_valid_and_one_is_a_charuco_board_of_unknown_mount():
    blocks = [validate_and_complete("target", yaml.safe_load(text), "example") for text in EXAMPLES]
    targets = [target_from_config(block) for block in blocks]
    assert [block.get("mount") for block in blocks] == ["unknown"]
    assert targets[0].pattern.name == "ChArUco board" and len(targets[0].pattern.corners()) == 24
    assert not targets[0].has_config_outline
