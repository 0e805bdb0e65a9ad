"""Read the payloads of single views."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

ROWS_PER_BATCH = 16


def read_view_payloads(path: Path, views: Iterable[int]) -> dict[int, dict[str, Any]]:
    """Return the rows of some views of a views.parquet by their number.

    The file is read a few rows at a time, so that it need not fit into memory.
    """
    views, rows, first = sorted(views), {}, 0
    if not views:
        return {}
    for batch in pq.ParquetFile(path).iter_batches(ROWS_PER_BATCH):
        for view in (v for v in views if first <= v < first + len(batch)):
            rows[view] = {
                name: _arrow_to_python(batch[name][view - first]) for name in batch.schema.names
            }
        first += len(batch)
    return rows


def _arrow_to_python(scalar: pa.Scalar) -> Any:
    return scalar.values.to_numpy() if isinstance(scalar, pa.ListScalar) else scalar.as_py()
