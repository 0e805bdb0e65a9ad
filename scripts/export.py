"""Files that robots load; the one job that fails on a failed verdict.

Reads   calibration.json, verdict.json
Writes  export/*, unless the verdict is fail; what stood there before is removed first; and adds
        the calibration to history/
"""

import shutil

from calib import formats, history, stage
from calib.stage import logger
from calib.status import InputError


def main(argv=None):
    args = stage.parser(
        __doc__,
        calibration="input",
        verdict="input",
        output="folder",
        history="folder of the calibrations that were accepted",
        options="slice of the config",
    ).parse_args(argv)
    shutil.rmtree(args.output, ignore_errors=True)
    calibration, judged = stage.read_json(args.calibration), stage.read_json(args.verdict)
    if judged["verdict"] == "fail":
        raise InputError(
            f"{calibration['rig']} is not exported, its calibration failed:\n  "
            + "\n  ".join(judged["reasons"])
        )
    args.output.mkdir(parents=True)
    parent = args.options["export"]["parent"] or args.options["body"]
    for name, module in sorted(formats.FORMATS.items()):
        (args.output / module.FILE).write_text(module.render(calibration, parent))
        logger.info("wrote %s (%s)", args.output / module.FILE, name)
    logger.info("accepted as %s", history.accept(args.history, calibration))


if __name__ == "__main__":
    stage.run(main)
