"""The library, in the order of the pipeline: each package imports only from packages above it.

package          stage (script)      content
geometry         all                 SE(3), frame graph, polygons, ICP, units
io               all                 status and errors, Parquet tables, config, logs, URDF
mocap            decode, gate        motion capture: messages, faults, trajectories, stillness
targets          all                 boards, cylinders, template clouds, printed patterns
sensors          all                 lidars and cameras: messages, models, configs
decoding         decode              one pass through a log: poses, frames, audit
views            crop                which frames show a target, and the part of each around it
initial_guess    guess               first pose and time offset of each sensor
estimation       associate, solve    residuals, corrections, noise and the joint problem
extraction       extract             keypoints of one sensor
diagnosis        solve               model selection, cross-validation, observability, solution.json
verdict          judge, preflight    findings against limits: pass, warn or fail
report           report, preflight   HTML page, PDF, figures, terminal summary
export           export              files that robots load, accepted calibrations

The library does not depend on Snakemake, on command lines or on where files are.
docs/architecture.md follows the data from a log to the extrinsics.
"""
