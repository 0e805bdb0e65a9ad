"""Draw a board target of the config at true size, as a PDF to be printed at 100 %.

The checkerboard, the outline as a line to cut along, places for markers with their coordinates in
the target frame, the directions of x and y, and two bars that tell whether the printer kept the
scale. `--page custom` makes the page as large as the board needs; `--turn-deg 45` lays a diamond
flat.
"""

import argparse
import sys
from pathlib import Path

from calib.io.config import validate_and_complete
from calib.io.safe_yaml import load_yaml
from calib.io.status import InputError
from calib.targets.board_pdf import PAGE_SIZES_MM, lay_out_sheet, write_board_pdf
from calib.targets.target_shapes import target_from_config


def parse_board_arguments(argv):
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    add("target", type=Path, metavar="TARGET.yaml")
    add("out", type=Path, metavar="OUT.pdf")
    add("--page", choices=[*PAGE_SIZES_MM, "custom"], default="custom")
    add("--turn-deg", type=float, default=0.0, help="turns the board on the page, to the left")
    return parser.parse_args(argv)


def draw_target_pdf(path, out, page, turn_deg):
    """Write the sheet of a target's config; its size (2,), mm."""
    block = validate_and_complete("target", load_yaml(path), path)
    if block["shape"] != "board":
        raise InputError(f"{path}: shape {block['shape']}; only a board can be printed")
    laid_out = lay_out_sheet(target_from_config(block), path.stem, page, turn_deg)
    write_board_pdf(out, laid_out)
    return laid_out.size_mm


def main(argv=None):
    args = parse_board_arguments(argv)
    try:
        wide, high = draw_target_pdf(args.target, args.out, args.page, args.turn_deg)
    except InputError as error:
        sys.exit(f"error: {error}")
    print(f"wrote {args.out}: {wide:.0f} × {high:.0f} mm", file=sys.stderr)


if __name__ == "__main__":
    main()
