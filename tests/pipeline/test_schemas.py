"""calibration.json and verdict.json against their JSON Schemas: all of them, and nothing else."""

import copy
import json

import jsonschema
import pytest

from calib.io.config import load_schema, validate_and_complete
from calib.io.status import InputError

OUTPUTS = ("calibration", "verdict")


def objects(schema, path=""):
    """(path, schema) of everything in a JSON Schema that describes an object."""
    if isinstance(schema, list):
        for i, part in enumerate(schema):
            yield from objects(part, f"{path}/{i}")
    elif isinstance(schema, dict):
        if schema.get("type") in ("object", ["object", "null"]):
            yield path, schema
        for key, part in schema.items():
            yield from objects(part, f"{path}/{key}")


def holders(content, path=()):
    """Paths of every dict in a content that its schema describes key by key or by name."""
    if isinstance(content, dict):
        yield path
        for key, value in content.items():
            yield from holders(value, (*path, key))
    elif isinstance(content, list):
        for i, value in enumerate(content):
            yield from holders(value, (*path, i))


def at(content, path):
    for key in path:
        content = content[key]
    return content


@pytest.fixture(scope="module")
def written(finished_run):
    """The two files of a finished run."""
    home = finished_run / "results/sim"
    return {kind: json.loads((home / f"{kind}.json").read_text()) for kind in OUTPUTS}


@pytest.mark.parametrize("kind", OUTPUTS)
def test_a_schema_is_one_by_the_rules_of_json_schema(kind):
    jsonschema.Draft202012Validator.check_schema(load_schema(kind))


@pytest.mark.parametrize("kind", OUTPUTS)
def test_every_object_lists_its_keys_or_says_what_its_values_are(kind):
    found = list(objects(load_schema(kind)))
    assert len(found) > 2
    for path, schema in found:
        if schema.get("additionalProperties") is False:
            assert sorted(schema["required"]) == sorted(schema["properties"]), path
        else:
            assert isinstance(schema["additionalProperties"], dict), path


@pytest.mark.parametrize("kind", OUTPUTS)
def test_what_a_run_writes_is_what_the_schema_promises(written, kind):
    jsonschema.validate(written[kind], load_schema(kind))


@pytest.mark.parametrize("kind", OUTPUTS)
def test_a_key_or_value_that_the_schema_does_not_know_is_refused_wherever_it_stands(written, kind):
    places = list(holders(written[kind]))
    assert len(places) > 3
    for path in places:
        content = copy.deepcopy(written[kind])
        at(content, path)["surprise"] = [{}]
        with pytest.raises(InputError):
            validate_and_complete(kind, content, kind)


def test_not_estimated_is_null_and_never_left_out(written):
    for name in written["calibration"]["sensors"]:
        for key in ("T_robot_sensor", "covariance", "time_offset_s", "intrinsics"):
            content = copy.deepcopy(written["calibration"])
            content["sensors"][name][key] = None
            validate_and_complete("calibration", content, "calibration")
            del content["sensors"][name][key]
            with pytest.raises(InputError, match=f"sensors.{name}: missing key {key}"):
                validate_and_complete("calibration", content, "calibration")
