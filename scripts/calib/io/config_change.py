"""A change of the config that a finding advises, as data that a program can carry out."""

from typing import Any, TypedDict

PIPELINE_FILE = "config/config.yaml"


class ConfigChange(TypedDict):
    """The value that a key of a config file should have.

    file: relative to the working directory; key: its path, with dots.
    """

    file: str
    key: str
    value: Any


def pipeline_change(key: str, value: Any) -> ConfigChange:
    """Return the change of a key of config.yaml."""
    return ConfigChange(file=PIPELINE_FILE, key=key, value=value)


def rig_change(rig: str, key: str, value: Any) -> ConfigChange:
    """Return the change of a key in the file of a rig."""
    return ConfigChange(file=f"config/rigs/{rig}.yaml", key=key, value=value)


def target_change(target: str, key: str, value: Any) -> ConfigChange:
    """Return the change of a key in the file of a target."""
    return ConfigChange(file=f"config/targets/{target}.yaml", key=key, value=value)
