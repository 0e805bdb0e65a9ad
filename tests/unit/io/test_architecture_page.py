"""docs/architecture.md lists the columns of the Arrow schemas and the packages of the library."""

import re

import pyarrow as pa
import pytest

from calib.io import table_schemas
from helpers.small_run import ROOT

PAGE = (ROOT / "docs" / "architecture.md").read_text()
SCHEMAS = {
    schema.metadata[b"table"].decode(): schema
    for schema in vars(table_schemas).values()
    if isinstance(schema, pa.Schema)
}


def format_type(type_):
    """Return an Arrow type as the page writes it: text, int64, float64 × 3, list of float32."""
    if pa.types.is_dictionary(type_):
        return "text"
    if pa.types.is_fixed_size_list(type_):
        return f"{format_type(type_.value_type)} × {type_.list_size}"
    if pa.types.is_list(type_):
        return f"list of {format_type(type_.value_type)}"
    return {"double": "float64", "float": "float32"}.get(str(type_), str(type_))


def format_row(field):
    """Return the row of one column: name, type, unit, frame, meaning."""
    about = {k.decode(): v.decode() for k, v in (field.metadata or {}).items()}
    cells = [f"`{field.name}`", format_type(field.type)]
    cells += [about.get(key, "") for key in ("unit", "frame", "meaning")]
    return "| " + " | ".join(cells) + " |"


@pytest.mark.parametrize("table", SCHEMAS)
def test_the_page_lists_the_columns_of_a_table_with_their_units(table):
    section = PAGE.split(f"\n### {table}")[1].split("\n#")[0]
    rows = [line for line in section.splitlines() if line.startswith("| `")]
    assert rows == [format_row(field) for field in SCHEMAS[table]]


def test_the_page_has_no_table_that_is_not_written():
    assert set(re.findall(r"^### (\S+)", PAGE, re.MULTILINE)) == set(SCHEMAS)


def test_the_page_names_every_package_of_the_library():
    packages = {p.name for p in (ROOT / "scripts" / "calib").iterdir() if p.is_dir()}
    named = set(re.findall(r"^\| `calib/(\w+)`", PAGE, re.MULTILINE))
    assert named == packages - {"__pycache__"}
