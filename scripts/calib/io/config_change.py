"""A change of the config that a finding advises, as data that a program can carry out."""

from typing import Any, TypedDict

PIPELINE_FILE = "config/config.yaml"
RIG_FILE = "config/rigs/{rig}.yaml"  # where the rig is not known yet, in braces


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
    return fill_rig(any_rig_change(key, value), rig)


def any_rig_change(key: str, value: Any) -> ConfigChange:
    """Return the change of a key in the file of a rig whose name is not known yet."""
    return ConfigChange(file=RIG_FILE, key=key, value=value)


def fill_rig(change: ConfigChange, rig: str) -> ConfigChange:
    """Return the change with the name of the rig, where it lacks it."""
    return ConfigChange(
        file=change["file"].replace("{rig}", rig), key=change["key"], value=change["value"]
    )


def target_change(target: str, key: str, value: Any) -> ConfigChange:
    """Return the change of a key in the file of a target."""
    return ConfigChange(file=f"config/targets/{target}.yaml", key=key, value=value)
