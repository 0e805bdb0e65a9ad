"""Parquet files as columns of NumPy arrays, with a status."""

import json

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from calib.io.atomic_files import atomic_write
from calib.io.status import OK, InputError, Status


def _to_arrow_array(field, values):
    if pa.types.is_fixed_size_list(field.type):
        flat = np.ascontiguousarray(np.asarray(values, float).reshape(-1))
        return pa.FixedSizeListArray.from_arrays(pa.array(flat), field.type.list_size)
    if pa.types.is_dictionary(field.type):
        return pa.array(values, pa.string()).dictionary_encode()
    return pa.array(values if isinstance(values, list) else np.asarray(values), field.type)


def write_table(path, schema, columns, status=OK, notes=None):
    """Write columns (name -> array) with their status; none may be missing or extra."""
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


def empty_columns(schema):
    """Columns of no row, of the types that `read` gives."""
    return {field.name: _to_numpy(pa.array([], field.type)) for field in schema}


def read_table(path, schema, names=None):
    """A table written by `write`: columns (name -> array), all or those named; status; notes.

    Raises InputError for a file of another table or version.
    """
    found = pq.read_schema(path)
    have = found.metadata or {}
    want = {k: schema.metadata[k] for k in (b"table", b"version")}
    if any(have.get(k) != v for k, v in want.items()) or not found.equals(schema):
        raise InputError(
            f"{path} holds {have.get(b'table', b'?').decode()} version "
            f"{have.get(b'version', b'?').decode()}, this stage reads {want[b'table'].decode()} "
            f"version {want[b'version'].decode()}: re-run the stage that wrote it"
        )
    names = list(names or schema.names)
    table = pq.read_table(path, columns=names)
    columns = {name: _to_numpy(table[name].combine_chunks()) for name in names}
    status = Status.from_dict(json.loads(have[b"status"]))
    return columns, status, json.loads(have[b"notes"])


def _to_numpy(array):
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


def select_rows(columns, mask):
    """The rows of columns where mask (n,) holds, or the rows of an index array."""
    rows = np.flatnonzero(mask) if np.asarray(mask).dtype == bool else np.asarray(mask, int)
    return {k: [v[i] for i in rows] if isinstance(v, list) else v[rows] for k, v in columns.items()}


def concatenate_columns(parts, schema):
    """One set of columns from several, in order."""
    if not parts:
        return empty_columns(schema)
    return {
        field.name: _concatenate_arrays(field.type, [p[field.name] for p in parts])
        for field in schema
    }


def _concatenate_arrays(type_, parts):
    if pa.types.is_list(type_) or pa.types.is_binary(type_):
        return [row for part in parts for row in part]
    return np.concatenate([np.asarray(part) for part in parts])
