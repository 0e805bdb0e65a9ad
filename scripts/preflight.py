"""What the recordings of a rig can and cannot support, before anyone waits for a solve.

Reads   log.json, mocap.parquet, frames.parquet and placements.parquet of every session
Writes  preflight.json  what each sensor may see of the targets, findings, and a verdict on them
        preflight.txt   the same for people, with the audit of the logs
Decides by the limits of judge, the sensors' fields of view, and their poses as rig or log state
them: what is out of view for certain is not seen, and of a pose that nobody states nothing is. No
payload is read. A verdict of fail says that no sensor can be calibrated.
"""

from calib.io import atomic_files, parquet_tables, stage_cli, table_schemas
from calib.io.stage_cli import logger
from calib.io.status import Status
from calib.report.page import preflight_text
from calib.verdict import preflight_findings, preflight_visibility


def session_of(name, audit, frames, mocap, placements, options):
    """The looks.Session of the files of one."""
    placed, status, notes = parquet_tables.read(placements, table_schemas.PLACEMENTS)
    about = options["sessions"][name]
    return preflight_visibility.Session(
        audit=stage_cli.read_json(audit),
        frames=parquet_tables.read(frames, table_schemas.FRAMES)[0],
        poses=parquet_tables.read(mocap, table_schemas.MOCAP)[0],
        placements=placed,
        status=status,
        targets={t: Status.from_dict(note) for t, note in sorted(notes.items())},
        remounted=about["remounted"],
        streams=tuple(about["sensors"]),
    )


def judged(sessions, options):
    """The content of preflight.json."""
    seen = {
        sensor: {
            name: preflight_visibility.look(session, sensor, options)
            for name, session in sessions.items()
            if sensor in session.streams
        }
        for sensor in sorted(options["sensors"])
    }
    verdict, findings, levels = preflight_findings.of_rig(sessions, seen, options)
    about = {"rig": options["rig"], "verdict": verdict, "findings": findings, "levels": levels}
    targets = preflight_findings.turns(sessions, options)
    return about | {"sensors": preflight_findings.numbers(seen), "targets": targets}


def main(argv=None):
    args = stage_cli.parser(
        __doc__,
        audits="*input log.json, one per session, in their order",
        mocap="*input, likewise",
        frames="*input, likewise",
        placements="*input, likewise",
        json="output",
        text="output",
        options="slice of the config",
    ).parse_args(argv)
    options = args.options
    paths = zip(args.audits, args.frames, args.mocap, args.placements, strict=True)
    named = zip(sorted(options["sessions"]), paths, strict=True)
    sessions = {name: session_of(name, *of, options) for name, of in named}
    found = judged(sessions, options)
    told = preflight_text.lines(options["rig"], found, preflight_text.Told(options, sessions))
    with atomic_files.whole(args.text) as part:
        part.write_text("\n".join(told) + "\n")
    stage_cli.write_json(args.json, found)
    logger.info("%s: %s", options["rig"], found["verdict"])


if __name__ == "__main__":
    stage_cli.run(main)
