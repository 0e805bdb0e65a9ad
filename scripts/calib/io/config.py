"""Config files: loaded, checked against their schemas and completed with defaults.

Defaults are defined in the schemas alone (workflow/schemas). Unknown keys are refused with their
path and the nearest known name.
"""

import copy
import hashlib
import re
from collections.abc import Collection, Iterable, Iterator
from functools import cache
from pathlib import Path
from typing import Any, TypeAlias

import jsonschema
import yaml

from calib.io.safe_names import plain_path, plain_text, replace_rig_names, safe_name
from calib.io.safe_yaml import load_yaml
from calib.io.session_parts import cut_sessions
from calib.io.status import InputError, did_you_mean
from calib.io.yaml_scalars import quoting_advice, read_number_text

SCHEMA_FOLDER = Path(__file__).parents[3] / "workflow" / "schemas"
MAX_MESSAGE_CHARS = 500  # a message may quote a wrong value, which may be long
MAX_ABS_NUMBER = 1e18
USER_FILE_KINDS = ("config", "rig", "target")
LINE_BREAKING_PATTERN = re.compile(r"[\x00-\x1f\x7f-\x9f\u2028\u2029]")
# A target with a larger alignment_sigma is treated as one whose mount is unknown.
UNKNOWN_MOUNT_SIGMA_M, UNKNOWN_MOUNT_SIGMA_DEG = 0.1, 20

# Keys of config.yaml: former name -> name today.
RENAMED_KEYS = {
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
    "solve.estimate.beams": "solve.estimate.lidar_corrections",
}

Config: TypeAlias = dict[str, Any]


@cache
def load_schema(kind: str) -> Config:
    """Return the JSON Schema of "config", "rig", "target", "calibration" or "verdict"."""
    return yaml.safe_load((SCHEMA_FOLDER / f"{kind}.schema.yaml").read_text())


def _fill_and_check(
    validator: Any, properties: Config, instance: Any, parent_schema: Config
) -> Iterator[jsonschema.ValidationError]:
    """Set the defaults of missing keys, then check the keys as jsonschema does."""
    if isinstance(instance, dict):
        for name, sub in properties.items():
            if name in instance:
                instance[name] = read_number_text(instance[name], sub)
            elif "default" in sub:
                instance[name] = yaml.safe_load(yaml.safe_dump(sub["default"]))
    yield from jsonschema.Draft202012Validator.VALIDATORS["properties"](
        validator, properties, instance, parent_schema
    )


def _read_numbers_and_check(
    validator: Any, items: Config, instance: Any, parent_schema: Config
) -> Iterator[jsonschema.ValidationError]:
    """Read the items of a list that are numbers as text, then check them as jsonschema does."""
    if isinstance(instance, list):
        instance[:] = [read_number_text(item, items) for item in instance]
    yield from jsonschema.Draft202012Validator.VALIDATORS["items"](
        validator, items, instance, parent_schema
    )


DefaultsValidator = jsonschema.validators.extend(
    jsonschema.Draft202012Validator,
    {"properties": _fill_and_check, "items": _read_numbers_and_check},
)


def validate_and_complete(kind: str, instance: Any, file_name: str | Path) -> Config:
    """Fill the defaults of a schema into `instance` and return it.

    kind: name of the schema; file_name: named in messages. Raises InputError with the path of
    the first wrong key, what is wrong with it and what to do.
    """
    if not isinstance(instance, dict):
        raise InputError(f"{file_name}: holds {type(instance).__name__}, expected keys and values")
    if kind == "config":
        _refuse_renamed_keys(instance, file_name)
    if kind in USER_FILE_KINDS:
        _require_one_line(instance, file_name)
    _require_finite(instance, file_name)
    found = DefaultsValidator(load_schema(kind)).iter_errors(instance)
    errors = sorted(found, key=lambda e: list(map(str, e.path)))
    # A wrong kind or shape is reported before the errors by the schema of that kind.
    errors = [e for e in errors if not {"then", "else"} & set(e.schema_path)] or errors
    if errors:
        message = _explain_error(jsonschema.exceptions.best_match(errors))
        raise InputError(f"{file_name}: {message[:MAX_MESSAGE_CHARS]}")
    _require_finite(instance, file_name)  # again, with the numbers that were text
    return instance


def _refuse_renamed_keys(config: Config, file_name: str | Path) -> None:
    """Raise InputError that lists the former keys of a config.yaml with their names today."""
    renamed = []
    for old, new in RENAMED_KEYS.items():
        *parents, key = old.split(".")
        block: Any = config
        for name in parents:
            block = block.get(name) if isinstance(block, dict) else None
        if isinstance(block, dict) and key in block:
            renamed.append(f"{old} is now {new}")
    if renamed:
        raise InputError(f"{file_name}: renamed keys: {'; '.join(renamed)}. Use the new names.")


def _require_finite(value: Any, file_name: str | Path, key_path: tuple[str, ...] = ()) -> None:
    """Raise InputError for a number that is infinite, not a number, or too large."""
    items: Iterable[tuple[Any, Any]] = ()
    if isinstance(value, dict):
        items = value.items()
    elif isinstance(value, list):
        items = enumerate(value)
    for key, part in items:
        _require_finite(part, file_name, (*key_path, str(key)))
    if isinstance(value, int | float) and not abs(value) < MAX_ABS_NUMBER:
        raise InputError(
            f"{file_name}: {'.'.join(key_path)}: {str(value)[:20]} is not a finite number below "
            f"{MAX_ABS_NUMBER:g}"
        )


def _require_one_line(value: Any, file_name: str | Path, key_path: str = "") -> None:
    """Raise InputError for a key or text with line breaks or other control characters."""
    items: Iterable[tuple[Any, Any]] = ()
    if isinstance(value, dict):
        items = value.items()
    elif isinstance(value, list):
        items = enumerate(value)
    for key, part in items:
        _require_one_line(str(key), file_name, key_path)
        _require_one_line(part, file_name, f"{key_path}.{key}".lstrip("."))
    if isinstance(value, str) and LINE_BREAKING_PATTERN.search(value):
        raise InputError(
            f'{file_name}: {key_path or "top level"}: "{plain_text(value)}" holds a line break or '
            "another control character. Remove it."
        )


def default_config_blocks() -> Config:
    """Return the blocks of config.yaml by name, with their defaults."""
    minimal_config = {"sessions": {"any": {"rig": "any", "log": "any"}}}
    complete = validate_and_complete("config", minimal_config, "defaults")
    return {k: v for k, v in complete.items() if k != "sessions"}


def _explain_error(error: jsonschema.ValidationError) -> str:
    """Return the path of a wrong key, what is wrong with it and what to do."""
    path = ".".join(str(p) for p in error.absolute_path) or "top level"
    if error.validator == "additionalProperties":
        allowed = sorted(error.schema.get("properties", {}))
        # YAML reads 007, on and 2026-03-01 as keys that are not text.
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
        return f"{path}: {error.instance} is a reserved name. Choose another name."
    if error.validator == "pattern":
        remedy = "Use at most 64 of a-z, 0-9, _ and -, and begin with a letter or digit."
        return f"{path}: {error.instance!r} is not a valid name. {remedy}"
    if error.validator == "type" and "string" in error.validator_value:
        return f"{path}: {error.message}. {quoting_advice(error.instance)}".rstrip(" .") + "."
    return f"{path}: {error.message}"


def load_config(
    config: Config, folder: str | Path = "config"
) -> tuple[Config, dict[str, Config], dict[str, Config]]:
    """Return the complete config, its rigs by name and its targets by name.

    config: content of config.yaml; folder: where rigs/ and targets/ are.
    """
    config = validate_and_complete("config", config, f"{folder}/config.yaml")
    config["sessions"] = cut_sessions(config["sessions"], f"{folder}/config.yaml")
    names = sorted({s["rig"] for s in config["sessions"].values()})
    rigs = {n: _load_rig(f"{folder}/rigs/{n}.yaml") for n in names}
    files = sorted(Path(folder, "targets").glob("*.yaml"))
    for file in files:
        _require_valid_name(file)
    targets = {f.stem: _load_target(f"{folder}/targets/{f.name}") for f in files}
    for name, session in config["sessions"].items():
        for key, available in (("targets", targets), ("sensors", rigs[session["rig"]]["sensors"])):
            session[key] = _select_names(
                session.get(key), available, session=name, key=key, folder=folder
            )
    return config, rigs, targets


def _load_and_validate(kind: str, path: str) -> Config:
    return validate_and_complete(kind, load_yaml(path), path)


def _load_rig(path: str) -> Config:
    """Load a rig and check that its files exist and its exports name its own sensors."""
    stated = load_yaml(path)
    rig = validate_and_complete("rig", copy.deepcopy(stated), path)
    replace_rig_names(rig)
    states_bias = "pose_bias_sigma" in stated.get("mocap", {})
    rig["mocap"].setdefault("use_measured_noise", not states_bias)
    export, sensors = rig["export"], rig["sensors"]
    for key, file in (("guess_from", rig.get("guess_from")), ("export.urdf", export.get("urdf"))):
        if file and not Path(file).is_file():
            raise InputError(f"{path}: {key}: no file {file} in {Path.cwd()}")
    names_by_key = {"export.body_frames": list(export["body_frames"]), "export.parent": []}
    if "sensor" in export.get("parent", {}):
        names_by_key["export.parent"] = [export["parent"]["sensor"]]
    for key, names in names_by_key.items():
        for name in sorted(set(names) - set(sensors)):
            raise InputError(f"{path}: {key}: no sensor {name}. {_suggest_name(name, sensors)}")
    return rig


def _load_target(path: str) -> Config:
    """Load a target, with the hash of its template file, so that a changed template re-runs.

    A target whose mount is stated too loosely to find anything by it gets `mount: unknown`.
    """
    target = _load_and_validate("target", path)
    target["body"] = safe_name(target["body"])
    sigma = target["alignment_sigma"]
    if target.get("pattern") and (
        sigma["xyz_m"] > UNKNOWN_MOUNT_SIGMA_M or sigma["rpy_deg"] > UNKNOWN_MOUNT_SIGMA_DEG
    ):
        target["mount"] = "unknown"
    template = target["points"].get("template_file")
    if template:
        if not Path(template).is_file():
            raise InputError(f"{path}: points.template_file: no file {template} in {Path.cwd()}")
        with Path(template).open("rb") as stream:
            target["points"]["sha256"] = hashlib.file_digest(stream, "sha256").hexdigest()
    return target


def _require_valid_name(file: Path) -> None:
    """Raise InputError unless the stem of a file is a valid name."""
    for error in DefaultsValidator(load_schema("config")["$defs"]["name"]).iter_errors(file.stem):
        raise InputError(_explain_error(error).replace("top level", plain_path(file), 1))


def _select_names(
    wanted: list[str] | None,
    available: Collection[str],
    *,
    session: str,
    key: str,
    folder: str | Path,
) -> list[str]:
    """Return the sorted names that a session wants, all if it names none."""
    if not available:
        raise InputError(f"{folder}/{key}: no file found; expected at least one YAML file")
    for name in wanted or ():
        if name not in available:
            raise InputError(
                f"{folder}/config.yaml: sessions.{session}.{key}: {name} does not exist. "
                + _suggest_name(name, available)
            )
    return sorted(wanted or available)


def _suggest_name(name: str, available: Collection[str]) -> str:
    """Return the nearest known name as a question, or all known names."""
    return did_you_mean(name, available) or f"Known: {', '.join(sorted(available))}"
