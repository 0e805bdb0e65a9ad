"""The text of docs/benchmark.md, with the names of its tables and numbers in braces."""

PAGE_TEMPLATE = """# Benchmark

`{command}` made this page from logs that `scripts/simulate.py` writes, one per line: a VLP-16
at 10 Hz, a pinhole camera of 900 × 700 px, MCS at 100 Hz, a second at rest per placement. No job of
the pipeline sees the truth; extraction starts from a guess that is off by up to ±3 cm and ±5° per
axis. Everything but times and memory comes out the same again.

{machine}.

## Accuracy

![errors of all cases](benchmark.svg)

{accuracy}

* *error*: norm of the translation error and geodesic angle of the rotation error; *σ reported*: the
  same from the covariance in calibration.json.
* *reference*: square root of the trace of the inverse information of the very data that `surface`
  used, at the truth and with the true noise: what an efficient estimator would reach.
* *goal*: only `surface`, the default, is held to the goals, and one log alone only where its data
  carry no noise; the others are below. `points` is the paper's way of comparing, with all returns
  or the board's corners as keypoints.
* *paper*: as claimed; *C++*: its published code, measured on logs of a like rig with other targets
  and poses, so that orders of magnitude compare. For the camera its saddle-point corners stand
  here; its OpenCV corners reach 0.015, 0.025 and 0.133 mm at N = 30, 15 and 5.

What a camera finds, against the truth:

{pixels}

## Many draws of the noise

From one recording per line without noise: every draw puts fresh noise on every range or pixel and
on every pose from the MCS, turns the pattern of the scans by a share of its step at every
placement, and goes through extraction and the joint estimate again, from the same guess.

{drawn}

* *reference*: as above; *without outlines*: of the returns alone, without where scan lines leave
  the target: a board's outline, a cylinder's sides. Each such crossing counts once per placement,
  as uniform between two beams.
* *goal*: that of the row, or {ensemble} × the reference for the root mean square of the draws.
* *above {single:g} ×*: the share of draws whose error is more than {single:g} × the reference in mm
  or in degrees; in brackets that of an efficient estimator, whose errors are Gaussian too.
* *NEES/6*: mean of the squared error over the reported covariance, 1 where that is honest; in
  brackets the band in which 95 % of honest means of so many draws lie; *of their mean*: the same of
  the mean error of all draws, well above 2 where the draws share an error that no noise explains.

## Does σ hold what it promises?

Measurements drawn from the noise model itself, as keypoints: returns along the beam, crossings
anywhere between two beams and the same in every scan, corners and contour points in pixels, errors
of the MCS from their priors, the robot's shared by all targets. Goal: 95 % ellipsoids hold the
truth in {held} %, and the mean NEES lies in its band.

{covered}

Small logs with all noise, each with another rig, through the whole pipeline to calibration.json:

{full}

## Cost

{about}, to extrinsics by default settings: {wall} s wall from the log to solution.json,
Snakemake's own start apart. The figures of a stage are of its jobs, start of Python included. CPU
times are the safer ones: wall times grow with whatever else the machine does meanwhile. The goal's
case is 2 lidars + 1 camera, 30 placements each, 1.7 GB.

{speed}

{decoding} {memory}

{sections}

## Not reached

{missed}
"""
