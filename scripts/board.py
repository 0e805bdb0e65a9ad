"""Draw a board target of the config at true size, as a PDF to be printed at 100 %.

The page shows the checkerboard or ChArUco board, the outline as a line to cut along, places for
markers with their coordinates in the target frame, the directions of x and y, and two bars to check
the printer's scale. `--page custom` makes the page as large as the board needs; `--turn-deg 45`
lays a diamond flat.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from calib.io.config import validate_and_complete
from calib.io.safe_yaml import load_yaml
from calib.io.status import InputError
from calib.targets.board import Board
from calib.targets.board_pdf import PAGE_SIZES_MM, lay_out_sheet, write_board_pdf
from calib.targets.target_shapes import target_from_config


def parse_board_arguments(argv: Sequence[str] | None) -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("target", type=Path, metavar="TARGET.yaml")
    parser.add_argument("out", type=Path, metavar="OUT.pdf")
    parser.add_argument("--page", choices=[*PAGE_SIZES_MM, "custom"], default="custom")
    parser.add_argument(
        "--turn-deg", type=float, default=0.0, help="turns the board on the page, to the left"
    )
    return parser.parse_args(argv)


def draw_target_pdf(path: Path, out: Path, page: str, turn_deg: float) -> tuple[float, float]:
    """Write the sheet of a target's config as PDF; return its width and height, mm.

    Raises InputError if the target cannot be printed.
    """
    config = validate_and_complete("target", load_yaml(path), path)
    target = target_from_config(config)
    if not isinstance(target, Board):
        raise InputError(
            f"{path}: shape {config['shape']} cannot be printed; expected shape: board. "
            "Choose the config file of a board."
        )
    sheet = lay_out_sheet(target, path.stem, page, turn_deg)
    write_board_pdf(out, sheet)
    return sheet.size_mm


def main(argv: Sequence[str] | None = None) -> None:
    """Run the tool."""
    args = parse_board_arguments(argv)
    try:
        width, height = draw_target_pdf(args.target, args.out, args.page, args.turn_deg)
    except InputError as error:
        sys.exit(f"error: {error}")
    print(f"wrote {args.out}: {width:.0f} × {height:.0f} mm", file=sys.stderr)


if __name__ == "__main__":
    main()
