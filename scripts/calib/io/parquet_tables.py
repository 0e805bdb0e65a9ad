"""Parquet files as columns of NumPy arrays, with a status and notes."""

import json
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from calib.io.atomic_files import atomic_write
from calib.io.status import OK, InputError, Status

# An array (n,) or (n, k); a list of n arrays or bytes where rows differ in length.
ColumnValues: TypeAlias = Any
Columns: TypeAlias = dict[str, ColumnValues]


def _to_arrow_array(field: pa.Field, values: ColumnValues) -> pa.Array:
    if pa.types.is_fixed_size_list(field.type):
        flat = np.ascontiguousarray(np.asarray(values, float).reshape(-1))
        return pa.FixedSizeListArray.from_arrays(pa.array(flat), field.type.list_size)
    if pa.types.is_dictionary(field.type):
        return pa.array(values, pa.string()).dictionary_encode()
    return pa.array(values if isinstance(values, list) else np.asarray(values), field.type)


def write_table(
    path: str | Path,
    schema: pa.Schema,
    columns: Columns,
    status: Status = OK,
    notes: dict[str, Any] | None = None,
) -> None:
    """Write columns with their status and notes (JSON).

    Raises ValueError unless the columns are exactly those of the schema.
    """
    if set(columns) != set(schema.names):
        raise ValueError(f"{path}: columns {sorted(columns)}, expected {schema.names}")
    metadata = {
        **schema.metadata,
        b"status": json.dumps(status.to_dict(), sort_keys=True).encode(),
        b"notes": json.dumps(notes if notes is not None else {}, sort_keys=True).encode(),
    }
    arrays = [_to_arrow_array(field, columns[field.name]) for field in schema]
    table = pa.Table.from_arrays(arrays, schema=schema.with_metadata(metadata))
    with atomic_write(path) as part:
        pq.write_table(table, part, compression="zstd", compression_level=1)


def empty_columns(schema: pa.Schema) -> Columns:
    """Return columns without rows, of the types that read_table returns."""
    return {field.name: _to_numpy(pa.array([], field.type)) for field in schema}


def read_table(
    path: str | Path, schema: pa.Schema, names: Iterable[str] | None = None
) -> tuple[Columns, Status, dict[str, Any]]:
    """Return the columns, status and notes of a table written by write_table.

    names: columns to read; None reads all. Raises InputError if the file holds another table or
    version.
    """
    file_schema = pq.read_schema(path)
    metadata = file_schema.metadata or {}
    expected = {k: schema.metadata[k] for k in (b"table", b"version")}
    if any(metadata.get(k) != v for k, v in expected.items()) or not file_schema.equals(schema):
        raise InputError(
            f"{path}: holds table {metadata.get(b'table', b'?').decode()}, version "
            f"{metadata.get(b'version', b'?').decode()}; expected {expected[b'table'].decode()}, "
            f"version {expected[b'version'].decode()}. Run again the stage that writes it."
        )
    names = list(names or schema.names)
    table = pq.read_table(path, columns=names)
    columns = {name: _to_numpy(table[name].combine_chunks()) for name in names}
    status = Status.from_dict(json.loads(metadata[b"status"]))
    return columns, status, json.loads(metadata[b"notes"])


def _to_numpy(array: pa.Array | pa.ChunkedArray) -> ColumnValues:
    if isinstance(array, pa.ChunkedArray):
        array = pa.concat_arrays(array.chunks) if array.num_chunks else pa.array([], array.type)
    if pa.types.is_fixed_size_list(array.type):
        return array.flatten().to_numpy(zero_copy_only=False).reshape(-1, array.type.list_size)
    if pa.types.is_dictionary(array.type):
        return np.asarray(array.dictionary.to_pylist(), str)[array.indices.to_numpy()]
    if pa.types.is_list(array.type):
        return [row.values.to_numpy() for row in array]
    if pa.types.is_binary(array.type):
        return array.to_pylist()
    return array.to_numpy(zero_copy_only=False)


def select_rows(columns: Columns, mask: np.ndarray) -> Columns:
    """Return the rows where a bool mask (n,) is true, or the rows of an index array."""
    rows = np.flatnonzero(mask) if np.asarray(mask).dtype == bool else np.asarray(mask, int)
    return {k: [v[i] for i in rows] if isinstance(v, list) else v[rows] for k, v in columns.items()}


def concatenate_columns(parts: Sequence[Columns], schema: pa.Schema) -> Columns:
    """Join tables of the same columns, in order."""
    if not parts:
        return empty_columns(schema)
    return {
        field.name: _concatenate_arrays(field.type, [p[field.name] for p in parts])
        for field in schema
    }


def _concatenate_arrays(type_: pa.DataType, parts: list[ColumnValues]) -> ColumnValues:
    if pa.types.is_list(type_) or pa.types.is_binary(type_):
        return [row for part in parts for row in part]
    return np.concatenate([np.asarray(part) for part in parts])
