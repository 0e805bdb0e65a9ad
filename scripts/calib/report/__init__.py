"""What a person must know of a calibration: tables, figures and overlays of report.html.

inputs, run    the inputs, as plain data        text          numbers as they are printed
summary        verdict in three lines, limits   provenance    logs, settings, rounds of the solve
intake         what the recordings held         funnel        losses from frame to solve
coverage       what of the view held targets    residuals, splits   members, by what may matter
extrinsics     poses before and after, with σ   nuisance      clocks, mounts, lenses
directions     what the data tell badly         task          σ between sensors in mm and px
evidence       suspicions, placements left out  diagnostics   what went wrong, by its cost
scene          the 3-D view as data             overlays, shared_overlays   which views are shown
plots          figures for screen and paper; the modules *_figure(s) and figures draw on them
html, paper    pages from templates, as PDF     terminal, overview   a few lines; all rigs
"""
