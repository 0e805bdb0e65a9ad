"""Reads the payloads of single views."""

import pyarrow as pa
import pyarrow.parquet as pq

BATCH = 16


def payloads(path, wanted):
    """{view: row} of some rows of a views.parquet, read a few at a time."""
    wanted, rows, at = sorted(wanted), {}, 0
    if not wanted:
        return rows
    for batch in pq.ParquetFile(path).iter_batches(BATCH):
        for view in (v for v in wanted if at <= v < at + len(batch)):
            rows[view] = {n: _value(batch[n][view - at]) for n in batch.schema.names}
        at += len(batch)
    return rows


def _value(scalar):
    return scalar.values.to_numpy() if isinstance(scalar, pa.ListScalar) else scalar.as_py()
