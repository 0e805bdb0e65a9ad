"""Reads the payloads of single views."""

import pyarrow as pa
import pyarrow.parquet as pq

ROWS_PER_BATCH = 16


def read_view_payloads(path, views):
    """{view: row} of some rows of a views.parquet, read a few at a time."""
    views, rows, at = sorted(views), {}, 0
    if not views:
        return rows
    for batch in pq.ParquetFile(path).iter_batches(ROWS_PER_BATCH):
        for view in (v for v in views if at <= v < at + len(batch)):
            rows[view] = {n: _arrow_to_python(batch[n][view - at]) for n in batch.schema.names}
        at += len(batch)
    return rows


def _arrow_to_python(scalar):
    return scalar.values.to_numpy() if isinstance(scalar, pa.ListScalar) else scalar.as_py()
