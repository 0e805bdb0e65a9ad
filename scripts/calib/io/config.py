"""What users write, loaded, validated and completed once, at the workflow's edge.

Defaults live in the schemas alone. An unknown key is refused with its path and the nearest name.
"""

import hashlib
from functools import cache
from pathlib import Path

import jsonschema
import yaml

from calib.io.safe_yaml import load_yaml
from calib.io.status import InputError, did_you_mean

SCHEMA_FOLDER = Path(__file__).parents[3] / "workflow" / "schemas"
MAX_MESSAGE_CHARS = 500  # characters of what is said of a wrong value, which may be long itself
MAX_ABS_NUMBER = 1e18
UNKNOWN_MOUNT_SIGMA_M, UNKNOWN_MOUNT_SIGMA_DEG = (
    0.1,
    20,
)  # alignment_sigma of a target from which its mount counts as unknown

RENAMED_KEYS = {  # of config.yaml: former name -> name today
    "crop.max_moving": "crop.max_moving_views",
    "guess.enough_images": "guess.max_pattern_images",
    "guess.found_sigma": "guess.min_sigma_from_data",
    "judge.fail_beyond": "judge.fail_tail_share",
    "judge.fail_correction_sigma": "judge.fail_guess_deviation_sigma",
    "judge.fail_heldout": "judge.fail_leave_one_out",
    "judge.fail_offset_s": "judge.fail_time_offset_s",
    "judge.fail_whiteness": "judge.fail_systematic",
    "judge.warn_beyond": "judge.warn_tail_share",
    "judge.warn_clock_s": "judge.warn_fixed_time_offset_s",
    "judge.warn_correction_sigma": "judge.warn_guess_deviation_sigma",
    "judge.warn_explained": "judge.warn_error_explains",
    "judge.warn_heldout": "judge.warn_leave_one_out",
    "judge.warn_offset_s": "judge.warn_time_offset_s",
    "judge.warn_shift_m": "judge.warn_error_moves_pose_m",
    "judge.warn_shift_sigma": "judge.warn_error_moves_pose_sigma",
    "judge.warn_suspicion_chance": "judge.warn_error_p_value",
    "judge.warn_whiteness": "judge.warn_systematic",
    "judge.warn_widened": "judge.warn_noise_factor_explained",
    "solve.estimate.beams": "solve.estimate.lidar_corrections",
}


@cache
def load_schema(kind):
    """The JSON Schema of config, rig, target, calibration or verdict."""
    return yaml.safe_load((SCHEMA_FOLDER / f"{kind}.schema.yaml").read_text())


def _fill_and_check(validator, properties, instance, parent_schema):
    """Set the defaults of absent properties, then check them as jsonschema does."""
    if isinstance(instance, dict):
        for name, sub in properties.items():
            if "default" in sub and name not in instance:
                instance[name] = yaml.safe_load(yaml.safe_dump(sub["default"]))
    yield from jsonschema.Draft202012Validator.VALIDATORS["properties"](
        validator, properties, instance, parent_schema
    )


DefaultsValidator = jsonschema.validators.extend(
    jsonschema.Draft202012Validator, {"properties": _fill_and_check}
)


def validate_and_complete(kind, instance, file_name):
    """`instance` with every default in place; `where` names the file in messages.

    Raises InputError with the path of the first wrong key, what is wrong, and the remedy.
    """
    if not isinstance(instance, dict):
        raise InputError(f"{file_name}: holds {type(instance).__name__}, expected keys and values")
    if kind == "config":
        _refuse_renamed_keys(instance, file_name)
    _require_finite(instance, file_name)
    found = DefaultsValidator(load_schema(kind)).iter_errors(instance)
    errors = sorted(found, key=lambda e: list(map(str, e.path)))
    # A wrong kind or shape comes before what its own schema would have said.
    errors = [e for e in errors if not {"then", "else"} & set(e.schema_path)] or errors
    if errors:
        raise InputError(
            f"{file_name}: {_explain_error(jsonschema.exceptions.best_match(errors))[:MAX_MESSAGE_CHARS]}"
        )
    return instance


def _refuse_renamed_keys(config, file_name):
    """Raise InputError that lists the former keys of a config.yaml with their names today."""
    renamed = []
    for old, new in RENAMED_KEYS.items():
        block, (*parents, key) = config, old.split(".")
        for name in parents:
            block = block.get(name) if isinstance(block, dict) else None
        if isinstance(block, dict) and key in block:
            renamed.append(f"{old} is now {new}")
    if renamed:
        raise InputError(f"{file_name}: renamed keys: {'; '.join(renamed)}. Use the new names.")


def _require_finite(value, file_name, key_path=()):
    """Raise InputError for a number that is none, or that no float can hold."""
    inside = value.items() if isinstance(value, dict) else ()
    inside = enumerate(value) if isinstance(value, list) else inside
    for key, part in inside:
        _require_finite(part, file_name, (*key_path, str(key)))
    if isinstance(value, int | float) and not abs(value) < MAX_ABS_NUMBER:
        raise InputError(
            f"{file_name}: {'.'.join(key_path)}: {str(value)[:20]} is no number that any has"
        )


def default_config_blocks():
    """The blocks of config.yaml by name as they are where nothing is stated."""
    least = {"sessions": {"any": {"rig": "any", "log": "any"}}}
    found = validate_and_complete("config", least, "defaults")
    return {k: v for k, v in found.items() if k != "sessions"}


def _explain_error(error):
    path = ".".join(str(p) for p in error.absolute_path) or "top level"
    if error.validator == "additionalProperties":
        allowed = sorted(error.schema.get("properties", {}))
        # YAML reads 007, on and 2026-03-01 as keys that are no text.
        unknown = sorted(str(k) for k in error.instance if k not in allowed)[0]
        return f"{path}: unknown key {unknown}. {_suggest_name(unknown, allowed)}"
    if error.validator == "required":
        missing = sorted(set(error.validator_value) - set(error.instance))
        return f"{path}: missing key {missing[0]}"
    if error.validator == "oneOf":
        expected = error.schema.get("description", error.message)
        return f"{path}: {error.instance}; expected {expected}"
    if error.validator == "not" and "description" in error.validator_value:
        return f"{path}: {error.validator_value['description']}"
    if error.validator == "not":
        return f"{path}: {error.instance} is a reserved name; choose another"
    if error.validator == "pattern":
        remedy = "use a-z, 0-9, _ and -, first a letter or digit, 64 at most"
        return f"{path}: {error.instance!r} is no name; {remedy}"
    return f"{path}: {error.message}"


def load_config(config, folder="config"):
    """(config, rigs, targets) by name, complete, of a loaded config.yaml and its folder."""
    config = validate_and_complete("config", config, f"{folder}/config.yaml")
    names = sorted({s["rig"] for s in config["sessions"].values()})
    rigs = {n: _load_rig(f"{folder}/rigs/{n}.yaml") for n in names}
    files = sorted(Path(folder, "targets").glob("*.yaml"))
    for file in files:
        _require_valid_name(file)
    targets = {f.stem: _load_target(f"{folder}/targets/{f.name}") for f in files}
    for name, session in config["sessions"].items():
        session["targets"] = _select_names(session.get("targets"), targets, name, "targets", folder)
        sensors = rigs[session["rig"]]["sensors"]
        session["sensors"] = _select_names(session.get("sensors"), sensors, name, "sensors", folder)
    return config, rigs, targets


def _load_and_validate(kind, path):
    return validate_and_complete(kind, load_yaml(path), path)


def _load_rig(path):
    """A rig whose files are there and whose exports name sensors that it has."""
    rig = _load_and_validate("rig", path)
    export, sensors = rig["export"], rig["sensors"]
    for key, file in (("guess_from", rig.get("guess_from")), ("export.urdf", export.get("urdf"))):
        if file and not Path(file).is_file():
            raise InputError(f"{path}: {key}: no file {file} in {Path.cwd()}")
    named = {"export.body_frames": export["body_frames"], "export.parent": {}}
    if "sensor" in export.get("parent", {}):
        named["export.parent"] = [export["parent"]["sensor"]]
    for key, names in named.items():
        for name in sorted(set(names) - set(sensors)):
            raise InputError(f"{path}: {key}: no sensor {name}. {_suggest_name(name, sensors)}")
    return rig


def _load_target(path):
    """A target; a template that it names is known by its content, so that a change re-runs. One
    whose place in its body is stated so loosely that nothing can be found by it has none."""
    target = _load_and_validate("target", path)
    loose = target["alignment_sigma"]
    if target.get("pattern") and (
        loose["xyz_m"] > UNKNOWN_MOUNT_SIGMA_M or loose["rpy_deg"] > UNKNOWN_MOUNT_SIGMA_DEG
    ):
        target["mount"] = "unknown"
    template = target["points"].get("template_file")
    if template:
        if not Path(template).is_file():
            raise InputError(f"{path}: points.template_file: no file {template} in {Path.cwd()}")
        target["points"]["sha256"] = hashlib.sha256(Path(template).read_bytes()).hexdigest()
    return target


def _require_valid_name(file):
    """Raise InputError unless the stem of a file can name what the file holds."""
    for error in DefaultsValidator(load_schema("config")["$defs"]["name"]).iter_errors(file.stem):
        raise InputError(_explain_error(error).replace("top level", str(file), 1))


def _select_names(wanted, available, session, key, folder):
    if not available:
        raise InputError(f"{folder}/{key}: no file there; a calibration needs at least one")
    for name in wanted or ():
        if name not in available:
            raise InputError(
                f"{folder}/config.yaml: sessions.{session}.{key}: no {name} there. "
                + _suggest_name(name, available)
            )
    return sorted(wanted or available)


def _suggest_name(name, available):
    """What to say of a name that is not among those known."""
    return did_you_mean(name, available) or f"Known: {', '.join(sorted(available))}"
