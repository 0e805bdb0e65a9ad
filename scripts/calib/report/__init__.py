"""What a person must know of a calibration: tables, figures and overlays of report.html.

inputs, run    the inputs, as plain data        text          numbers as they are printed
summary        verdict, advice, provenance      extrinsics    poses before and after, with σ
funnel         audit, losses from frame to solve
coverage       what of the view held targets    residuals     members and their statistics
plots          figures for screen and paper; rig_figure, coverage_figures, figures draw on them
overlays       which views are shown; camera_overlays, lidar_overlays draw them
paper          the page as PDF                  terminal      the result in a few lines
"""
