"""What a person must know of a calibration, as one page that opens anywhere.

Reads   calibration.json, verdict.json, residuals.parquet, iterations.parquet; log.json and
        placements.parquet of all sessions; guess.json, views.parquet and keypoints.parquet of all
        their sensors; the page's template
Writes  report.html, complete in itself: figures, images and style inside
Decides nothing; what could not be done is shown with its reason, found, expected and remedy.
"""

import jinja2
from markupsafe import Markup

from calib import stage, tables
from calib.report import figures, funnel, overlays, residuals, summary
from calib.report.run import LIGHT, VIEWS, Run, Session, Stream
from calib.stage import logger
from calib.status import Status


def read_stream(sensor, config, guess, views, keypoints):
    """One sensor in one session."""
    columns, seen, _ = tables.read(views, VIEWS[config["kind"]], LIGHT)
    found, status, notes = tables.read(keypoints, tables.KEYPOINTS)
    outcomes = {o["view"]: Status.from_dict(o["status"]) for o in notes["outcomes"]}
    return Stream(sensor, stage.read_json(guess), columns, seen, found, status, outcomes, views)


def read_sessions(args, options):
    """Sessions by name; per-sensor files come by session, then sensor, both sorted."""
    of_sensors = zip(args.guesses, args.views, args.keypoints, strict=True)
    out = {}
    paths = zip(sorted(options["sessions"]), args.audits, args.placements, strict=True)
    for name, audit, placements in paths:
        streams = {
            s: read_stream(s, options["sensors"][s], *next(of_sensors))
            for s in sorted(options["sessions"][name])
        }
        table, status, notes = tables.read(placements, tables.PLACEMENTS)
        still = {target: Status.from_dict(note) for target, note in notes.items()}
        out[name] = Session(stage.read_json(audit), table, status, still, streams)
    return out


def read_run(args):
    """Everything the report shows."""
    options = args.options
    return Run(
        options=options,
        calibration=stage.read_json(args.calibration),
        verdict=stage.read_json(args.verdict),
        residuals=tables.read(args.residuals, tables.RESIDUALS)[0],
        iterations=tables.read(args.iterations, tables.ITERATIONS)[0],
        sessions=read_sessions(args, options),
    )


def content(run):
    """What the template prints, by section."""
    return {
        "title": run.options["report"]["title"] or run.options["rig"],
        "rig": run.options["rig"],
        "body": run.options["body"],
        "verdict": summary.verdict(run),
        "extrinsics": summary.extrinsics(run),
        "between": summary.between(run),
        "unknowns": summary.other_unknowns(run),
        "sessions": [session(run, name) for name in run.sessions],
        "residuals": [
            {"name": n, "rows": residuals.overview(run, n), "figures": figures.of_sensor(run, n)}
            for n in run.sensors
        ],
        "noise": residuals.noise(run),
        "mocap_factor": run.calibration["noise"]["mocap_factor"],
        "overlays": [
            {"name": n, "kind": s["kind"], "views": overlays.of_sensor(run, n)}
            for n, s in run.sensors.items()
        ],
        "convergence": summary.convergence(run),
        "provenance": summary.provenance(run),
    }


def session(run, name):
    """Audit and funnel of one session."""
    return {
        "name": name,
        "streams": funnel.streams(run, name),
        "bodies": funnel.bodies(run, name),
        "unused": funnel.unused_topics(run, name),
        "problems": funnel.problems(run, name),
        "funnel": funnel.table(run, name),
        "timeline": figures.timeline(run, name),
    }


def arguments(argv):
    """The parsed command line."""
    return stage.parser(
        __doc__,
        calibration="input",
        verdict="input",
        residuals="input",
        iterations="input",
        audits="*input log.json, one per session",
        placements="*input, one per session",
        guesses="*input, one per session and sensor",
        views="*input, one per session and sensor",
        keypoints="*input, one per session and sensor",
        template="input, Jinja2",
        html="output",
        options="slice of the config",
    ).parse_args(argv)


def main(argv=None):
    args = arguments(argv)
    run = read_run(args)
    environment = jinja2.Environment(
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    environment.filters["drawn"] = Markup
    template = environment.from_string(args.template.read_text())
    args.html.write_text(template.render(content(run)))
    logger.info(
        "%s: %s, %d bytes", run.options["rig"], run.verdict["verdict"], args.html.stat().st_size
    )


if __name__ == "__main__":
    stage.run(main)
