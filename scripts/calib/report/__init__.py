"""What a person must know of a calibration: tables, figures and overlays of report.html.

run        the inputs as plain data          text       numbers as they are printed
summary    verdict, extrinsics, noise        funnel     audit, losses from frame to solve
residuals  members and their statistics      plots      figures as inline SVG
figures    residual plots and timelines      overlays   targets as seen against as predicted
"""
