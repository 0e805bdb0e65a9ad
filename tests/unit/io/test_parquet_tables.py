"""The exchanged tables: what goes in comes out, as the same bytes, and nothing else gets in."""

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from calib.io import table_schemas
from calib.io.parquet_tables import (
    concatenate_columns,
    empty_columns,
    read_table,
    select_rows,
    write_table,
)
from calib.io.status import OK, InputError, failure_status
from calib.io.table_schemas import FRAMES_SCHEMA, MOCAP_SCHEMA

SCHEMAS = {
    value.metadata[b"table"].decode(): value
    for value in vars(table_schemas).values()
    if isinstance(value, pa.Schema)
}
every_schema = pytest.mark.parametrize("schema", SCHEMAS.values(), ids=SCHEMAS.keys())


def values(type_, n, rng):
    """n values of a column's type, the awkward ones among them."""
    if pa.types.is_dictionary(type_):
        return np.array(["", "left", "right lidar", "ρ µ"] * n)[:n]
    if pa.types.is_fixed_size_list(type_):
        out = rng.normal(size=(n, type_.list_size))
        out[0], out[1, 0] = np.nan, -0.0
        return out
    if pa.types.is_list(type_):
        dtype = type_.value_type.to_pandas_dtype()
        return [(1000 * rng.normal(size=i)).astype(dtype) for i in range(n)]
    if pa.types.is_binary(type_):
        return [b"", b"\x00\xff", *(bytes(rng.integers(0, 256, 9).tolist()) for _ in range(n - 2))]
    if pa.types.is_boolean(type_):
        return rng.random(n) > 0.5
    if pa.types.is_floating(type_):
        return np.append(rng.normal(size=n - 2), [np.nan, 1e-300])
    top = np.iinfo(type_.to_pandas_dtype())
    return np.append(rng.integers(-9, 9, n - 2), [top.min, top.max]).astype(type_.to_pandas_dtype())


def example(schema, n=5, seed=0):
    rng = np.random.default_rng(seed)
    return {field.name: values(field.type, n, rng) for field in schema}


def assert_same(found, expected):
    assert list(found) == list(expected)
    for name, column in expected.items():
        if isinstance(column, list):
            assert isinstance(found[name], list) and len(found[name]) == len(column)
            for a, b in zip(found[name], column, strict=True):
                np.testing.assert_array_equal(a, b)
        else:
            assert found[name].dtype.kind == column.dtype.kind
            np.testing.assert_array_equal(found[name], column)


def test_there_is_a_table_for_every_exchange():
    expected = (
        "frames iterations keypoints mocap pairs placements residuals views-camera views-lidar"
    )
    assert set(expected.split()) <= set(SCHEMAS)


@every_schema
def test_a_table_comes_back_exactly(schema, tmp_path):
    columns = example(schema)
    write_table(tmp_path / "t.parquet", schema, columns)
    found, status, notes = read_table(tmp_path / "t.parquet", schema)
    assert_same(found, columns)
    assert status == OK and notes == {}


@every_schema
def test_the_same_rows_are_the_same_bytes_also_after_reading_them(schema, tmp_path):
    a, b, c = (tmp_path / name for name in "abc")
    write_table(a, schema, example(schema), notes={"y": 1, "x": 2})
    write_table(b, schema, example(schema), notes={"x": 2, "y": 1})
    found, status, notes = read_table(a, schema)
    write_table(c, schema, dict(reversed(found.items())), status, notes)
    assert a.read_bytes() == b.read_bytes() == c.read_bytes()


@every_schema
def test_a_table_of_no_row_comes_back_with_its_types(schema, tmp_path):
    write_table(tmp_path / "t.parquet", schema, empty_columns(schema))
    found, _, _ = read_table(tmp_path / "t.parquet", schema)
    assert_same(found, empty_columns(schema))
    some = example(schema)
    for name, column in found.items():
        assert len(column) == 0
        if not isinstance(column, list):
            assert column.dtype.kind == some[name].dtype.kind
            assert column.shape[1:] == some[name].shape[1:]


@every_schema
def test_columns_of_python_lists_of_no_row_are_accepted(schema, tmp_path):
    write_table(tmp_path / "t.parquet", schema, {name: [] for name in schema.names})
    assert_same(read_table(tmp_path / "t.parquet", schema)[0], empty_columns(schema))


@every_schema
def test_every_column_is_required_and_states_what_it_is(schema):
    assert not any(field.nullable for field in schema)
    units = {field.name: field.metadata for field in schema}
    for name in {"stamp_ns", "log_time_ns", "start_ns", "end_ns", "point_time_ns"} & set(units):
        assert units[name][b"unit"] == b"ns"


def test_status_and_notes_survive(tmp_path):
    status = failure_status("no board found", 0, "1 or more", "Turn the light on.")
    notes = {"left": {"found": 3, "words": "ä"}, "list": [1, 2.5, None]}
    write_table(
        tmp_path / "t",
        FRAMES_SCHEMA,
        empty_columns(FRAMES_SCHEMA),
        status,
        notes,
    )
    _, found, read = read_table(tmp_path / "t", FRAMES_SCHEMA)
    assert found == status and not found.ok
    assert str(found) == "no board found; found 0; expected 1 or more. Turn the light on."
    assert read == notes


def test_a_missing_column_is_refused_with_the_file_and_what_is_expected(tmp_path):
    columns = example(FRAMES_SCHEMA)
    del columns["size"]
    with pytest.raises(ValueError, match=r"t\.parquet: columns .*expected .*'size'"):
        write_table(tmp_path / "t.parquet", FRAMES_SCHEMA, columns)
    assert not (tmp_path / "t.parquet").exists()


def test_an_extra_column_is_refused(tmp_path):
    with pytest.raises(ValueError, match="'colour'"):
        write_table(
            tmp_path / "t",
            FRAMES_SCHEMA,
            example(FRAMES_SCHEMA) | {"colour": [1] * 5},
        )


def test_columns_of_different_length_are_refused(tmp_path):
    columns = example(FRAMES_SCHEMA)
    columns["stamp_ns"] = columns["stamp_ns"][:-1]
    with pytest.raises(ValueError, match="length"):
        write_table(tmp_path / "t", FRAMES_SCHEMA, columns)


def test_a_fraction_does_not_get_into_a_column_of_whole_numbers(tmp_path):
    columns = example(FRAMES_SCHEMA) | {"stamp_ns": np.full(5, 0.5)}
    with pytest.raises(ValueError):
        write_table(tmp_path / "t", FRAMES_SCHEMA, columns)


def test_another_table_is_refused_with_both_names_and_the_remedy(tmp_path):
    write_table(tmp_path / "t", FRAMES_SCHEMA, example(FRAMES_SCHEMA))
    with pytest.raises(InputError) as caught:
        read_table(tmp_path / "t", MOCAP_SCHEMA)
    assert "t: holds table frames, version 1; expected mocap, version" in str(caught.value)
    assert "Run again the stage that writes it" in str(caught.value)


def test_another_version_is_refused_with_both_versions(tmp_path):
    newer = FRAMES_SCHEMA.with_metadata({"table": "frames", "version": "99"})
    write_table(tmp_path / "t", newer, example(FRAMES_SCHEMA))
    with pytest.raises(
        InputError, match="holds table frames, version 99; expected frames, version"
    ):
        read_table(tmp_path / "t", FRAMES_SCHEMA)


def test_other_columns_under_the_same_name_and_version_are_refused(tmp_path):
    altered = FRAMES_SCHEMA.set(1, pa.field("stamp_ns", pa.float64(), nullable=False))
    write_table(tmp_path / "t", altered, empty_columns(altered))
    with pytest.raises(InputError, match="Run again the stage that writes it"):
        read_table(tmp_path / "t", FRAMES_SCHEMA)


def test_a_parquet_file_of_someone_else_is_refused(tmp_path):
    pq.write_table(pa.table({"a": [1]}), tmp_path / "t")
    with pytest.raises(InputError, match=r"holds table \?, version \?; expected frames"):
        read_table(tmp_path / "t", FRAMES_SCHEMA)


# --- rows


@every_schema
def test_rows_are_selected_by_mask_and_by_index(schema):
    columns = example(schema)
    by_mask = select_rows(columns, np.array([False, True, False, True, False]))
    assert_same(by_mask, select_rows(columns, [1, 3]))
    for name, column in columns.items():
        np.testing.assert_array_equal(by_mask[name][1], column[3])
    turned = select_rows(columns, np.array([4, 0]))
    for name, column in columns.items():
        np.testing.assert_array_equal(turned[name][0], column[4])


@every_schema
@pytest.mark.parametrize(
    "rows", [np.zeros(5, bool), np.zeros(0, int), []], ids=["mask", "index", "list"]
)
def test_no_row_may_be_selected(schema, rows):
    assert_same(select_rows(example(schema), rows), empty_columns(schema))


@every_schema
def test_parts_are_concatenated_in_order(schema, tmp_path):
    a, b = example(schema, 5, 1), example(schema, 7, 2)
    both = concatenate_columns([b, a], schema)
    assert_same(select_rows(both, np.arange(7)), b)
    assert_same(select_rows(both, np.arange(7, 12)), a)
    write_table(tmp_path / "t", schema, both)
    assert_same(read_table(tmp_path / "t", schema)[0], both)


@every_schema
def test_parts_without_a_row_add_nothing(schema):
    a, none = example(schema), empty_columns(schema)
    assert_same(concatenate_columns([none, a, none], schema), a)


@every_schema
def test_no_part_gives_no_row_of_the_right_types(schema):
    assert_same(concatenate_columns([], schema), empty_columns(schema))
    assert_same(
        concatenate_columns([empty_columns(schema)], schema),
        empty_columns(schema),
    )
