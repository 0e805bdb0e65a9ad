"""The header of a PCD or PLY file, checked before Open3D allocates what it declares."""

import re
from pathlib import Path

from calib.io.status import InputError

MAX_TEMPLATE_POINTS = 2_000_000
MAX_HEADER_BYTES = 1 << 16
MAX_LZF_RATIO = 100  # of the compression in PCD files: 264 bytes are stored in 3 or more
MIN_TEXT_BYTES = 2  # of a number in a text file, with what parts it from the next
PLY_TYPE_BYTES = {"char": 1, "uchar": 1, "short": 2, "ushort": 2, "int": 4, "uint": 4}
PLY_TYPE_BYTES |= {"float": 4, "double": 8, "int8": 1, "uint8": 1, "int16": 2, "uint16": 2}
PLY_TYPE_BYTES |= {"int32": 4, "uint32": 4, "float32": 4, "float64": 8}
HEADER_END = {
    ".pcd": re.compile(r"^DATA[ \t]+\w+", re.MULTILINE),
    ".ply": re.compile(r"^end_header", re.MULTILINE),
}


def require_true_header(path: Path) -> None:
    """Raise InputError unless a template file holds as many points as its header declares."""
    kind, n_bytes = path.suffix.lower(), path.stat().st_size
    with path.open("rb") as stream:
        text = stream.read(MAX_HEADER_BYTES).decode("latin-1")
    end = HEADER_END[kind].search(text) if kind in HEADER_END else None
    try:
        if end is None:
            raise ValueError("no header of a .pcd or .ply file")
        read = _read_pcd_sizes if kind == ".pcd" else _read_ply_sizes
        sizes = read(text[: end.end()])
    except (ValueError, KeyError, IndexError) as error:
        raise InputError(f"{path}: {error}. Write the points as .pcd or .ply.") from None
    for count, min_bytes in sizes:
        if not 0 <= count <= MAX_TEMPLATE_POINTS or count * min_bytes > n_bytes:
            raise InputError(
                f"{path}: its header declares {count} points or faces, and the file has {n_bytes} "
                f"bytes; expected at most {min(MAX_TEMPLATE_POINTS, int(n_bytes / min_bytes))} of "
                "them. Write the template again, or thin it out."
            )


def _read_pcd_sizes(header: str) -> list[tuple[int, float]]:
    """Return number and least bytes in the file of the points of a PCD header."""
    lines = [line.split() for line in header.splitlines()]
    values = {words[0]: words[1:] for words in lines if words}
    sizes = [int(size) for size in values["SIZE"]]
    repeats = [int(n) for n in values.get("COUNT", ["1"] * len(sizes))]
    if len(repeats) != len(sizes) or not set(sizes) <= {1, 2, 4, 8} or min(repeats) < 1:
        raise ValueError("a header with a wrong SIZE or COUNT")
    point_bytes = sum(size * n for size, n in zip(sizes, repeats, strict=True))
    least = {
        "ascii": MIN_TEXT_BYTES * sum(repeats),
        "binary": point_bytes,
        "binary_compressed": point_bytes / MAX_LZF_RATIO,
    }[values["DATA"][0].lower()]
    width, height = int(values["WIDTH"][0]), int(values.get("HEIGHT", ["1"])[0])
    counts = [width * height, *(int(n) for n in values.get("POINTS", [])[:1])]
    return [(count, least) for count in counts]


def _read_ply_sizes(header: str) -> list[tuple[int, float]]:
    """Return number and least bytes in the file of each kind of element of a PLY header."""
    is_text, elements = "format ascii" in header, []
    for line in header.splitlines():
        words = line.split()
        if words[:1] == ["element"]:
            elements.append([int(words[2]), 0])
        elif words[:1] == ["property"]:
            # Of a list, the number of its items is always there.
            number_type = words[2] if words[1] == "list" else words[1]
            elements[-1][1] += MIN_TEXT_BYTES if is_text else PLY_TYPE_BYTES[number_type]
    if any(count and not size for count, size in elements):
        raise ValueError("a header with elements without properties")
    return [(count, size or 1) for count, size in elements]
