"""The text of docs/benchmark.md, with the names of its tables and numbers in braces."""

PAGE_TEMPLATE = """# Benchmark

`{command}` made this page from logs simulated with `scripts/simulate.py`, one per table line: a
VLP-16 at 10 Hz, a pinhole camera of 900 × 700 px, motion capture (MCS) at 100 Hz, one second per
placement. No job of the pipeline reads the truth. Extraction starts from an initial guess with
errors up to ±3 cm and ±5° per axis. A second run gives the same results, except times and memory.

{machine}.

## Accuracy

![errors of all cases](benchmark.svg)

{accuracy}

* *N*: number of placements.
* *error*: norm of the translation error and geodesic angle of the rotation error; *σ reported*: the
  same from the covariance in calibration.json.
* *reference*: the accuracy of an efficient estimator with the same data that `surface` used: square
  root of the trace of the inverse information, at the true poses and with the true noise.
* *goal*: only the default method `surface` has goals. A single log has a goal only if its data have
  no noise; the goals for noisy data are in the next section. `points` is the method of the paper:
  its keypoints are all returns, or the corners of the board.
* *paper*: errors claimed in the paper; *C++*: its published code, measured on logs of a similar rig
  with other targets and poses, so compare only orders of magnitude. The camera error is with its
  saddle-point corners; with its OpenCV corners it is 0.015, 0.025 and 0.133 mm at N = 30, 15 and 5.

Errors of the corners and contour points in the camera images:

{pixels}

## Many draws of the noise

Each line uses one recording without noise. Every draw adds new noise to every range or pixel and to
every MCS pose, and rotates the scan pattern by a random part of its step at every placement. Then
extraction and the joint estimate run again, from the same initial guess.

{drawn}

* *reference*: as above; *without outlines*: from the returns alone, without the points where scan
  lines leave the target (outline of a board, sides of a cylinder). Each such point counts once per
  placement, with an error uniform between two beams.
* *goal*: the goal of the row, or {ensemble} × the reference, for the RMS error of the draws.
* *above {single:g} ×*: share of draws with an error above {single:g} × the reference, in mm or in
  degrees; in brackets: the same for an efficient estimator, whose errors are Gaussian.
* *NEES/6*: mean of the squared error over the reported covariance, 1 if the covariance is correct;
  in brackets: the band that contains 95 % of such means for a correct covariance. *of their mean*:
  the same for the mean error of all draws; well above 2 if all draws share an error that is not
  noise.
* *95 % ellipsoids hold*: share of draws whose 95 % ellipsoid contains the truth.

## Is the reported σ correct?

Keypoints are drawn from the noise model itself: returns along the beam, outline crossings anywhere
between two beams and the same in every scan, corners and contour points in pixels, MCS errors from
their priors with one robot error for all targets. Goal: {held} % of the 95 % ellipsoids contain the
truth (*held*), and the mean NEES lies in its band.

{covered}

Small logs with all noise, each with a different rig, through the whole pipeline to
calibration.json:

{full}

## Cost

{about}, with default settings: {wall} s wall time from the log to solution.json, without the start
of Snakemake itself. The times of a stage are sums over its jobs and include the start of Python.
Compare CPU times: wall times depend on the other load of the machine. The goals are for 2 lidars
and 1 camera, 30 placements each, 1.7 GB.

{speed}

{decoding} {memory}

{sections}

## Not reached

{missed}
"""
