"""Captions of the figures: the question, what is drawn, and (from "Good:" on) how to read it."""

STANDARDIZED_HISTOGRAM = (
    "Does the noise model hold? {n} residuals, rms {rms} σ; {n_beyond} beyond 3 σ (dotted)"
    "{normal}. {good}"
)
STANDARDIZED_HISTOGRAM_NORMAL = ", {expected} expected of a normal distribution"
STANDARDIZED_HISTOGRAM_GOOD = {
    "signed": "Good: the bars fill the curve. Long tails are outliers; two peaks a model error.",
    "length": "These residuals are lengths, which are never negative. Good: one peak and a tail "
    "that ends soon after it.",
    "board_outline": "A crossing can lie anywhere between two beams, and the scans of a placement "
    "repeat it; therefore they count as one. Good: flat or narrower than the curve. Wider or off "
    "to one side: the outline is wrong, or the footprint of the beam widens it.",
}
RESIDUAL_HISTOGRAM = (
    "How large are the residuals? rms {rms} {unit}. These are {meaning}: mostly noise of the "
    "sensor, not the error of the calibration. Good: one peak at zero."
)
PIXEL_RESIDUALS = (
    "How large are the residuals, and do they have a direction? rms {rms} px (2-D), mean ({u}, "
    "{v}) px. Good: one round cloud around zero. A line indicates motion or a time offset."
)
PLACEMENT_RMS = (
    "Is one placement wrong? Good: all near 1 (dashed). If one is far above the others, its "
    "target moved, or its motion capture poses are wrong."
)
PLACEMENT_RMS_SESSIONS = " Vertical lines separate the sessions, in order of name."
RESIDUAL_VECTORS = (
    "Do residuals depend on the position in the image? Grey: all residuals, × {gain}. Red: mean of "
    "each cell with {min_count} residuals or more, × {mean_gain}; the longest is {longest} px, and "
    "{n_beyond} of {n_cells} cells exceed 3 σ of their mean. Good: red arrows are short and "
    "random. Arrows that rotate or diverge with the radius: a wrong lens model; the same "
    "direction everywhere: a time offset."
)
RESIDUALS_BY_RING = (
    "Do single beams read too long or too short? Dot: median, bar: 16 to 84 % of the returns of a "
    "ring. Good: dots near zero. Dots that differ by more than a third of their bars are range "
    "errors of single beams, which the factory calibration of the sensor should remove."
)
RESIDUALS_BY_RANGE = (
    "Does the error grow with range? In σ: bars should span −1 to 1 (band) at all ranges. Good: "
    "level. Bars that widen: the noise grows with range; dots that rise: a scale error of the "
    "ranges."
)
LIDAR_RESIDUALS_BY_INCIDENCE = (
    "Does the error depend on the angle between beam and surface normal? Good: level, bars in the "
    "band. Dots that leave zero at large angles: the footprint of the beam."
)
CAMERA_RESIDUALS_BY_INCIDENCE = (
    "Does the error depend on the angle at which the target is seen? Good: level, bars in the "
    "band. Bars that widen at large angles: blur, or corners that are hard to find."
)
SESSION_TIMELINE = (
    "When was a target visible? Bars: the target is still relative to the robot. Strokes: frames "
    "of a sensor, green used in the solve, orange kept but not used, short and grey not kept. "
    "Good: each bar contains green strokes of each sensor that sees the target."
)
RIG_FIGURE = (
    "Where are the sensors, and how certain is it? Left: a dot and a stroke show the origin of a "
    "sensor and its viewing direction (z of a camera, x of a lidar), red for the initial guess, "
    "green for the result. Right: σ of each number of a pose."
)
RIG_FIGURE_TRUTH = (
    " Diamonds: distance from the truth. Good: about two of three diamonds inside their bar, "
    "hardly any above twice its height."
)
CAMERA_COVERAGE = (
    "Where in the image were targets measured? Good: points everywhere, also in the corners of the "
    "image, at several distances; and normals of boards (dots) and axes of cylinders (strokes), in "
    "the robot frame, far apart."
)
LIDAR_COVERAGE = (
    "Which part of the view of the lidar contained targets? Good: several azimuths, heights and "
    "distances; and normals of boards (dots) and axes of cylinders (strokes), in the robot frame, "
    "far apart. Three boards with the same orientation leave two directions undetermined."
)
SIGMA_BY_PLACEMENTS = (
    "Would more placements help? The largest σ of each pose for fewer placements: the median over "
    "random selections, with the noise estimated from all. Good: the curve is flat, below the "
    "limit. From there, twice as many placements reduce σ by a factor of 1.4."
)
PLACEMENT_INFLUENCE = (
    "Does the result depend on one placement? Bars: shift of the pose without it, in σ of the "
    "pose. Dots: leave-one-out error of the placement, in its predicted σ, per direction. Good: "
    "bars well below 1 if there are many placements, dots near 1 (dashed). A dot above 3: the "
    "target moved, or its motion capture poses are wrong."
)
PIXEL_SIGMA_MAP = (
    "Where in the image does a point of another sensor fall, 10 m from the camera? Lines: equal σ, "
    "px; cross: largest σ. Good: below one pixel everywhere. A σ that grows to one side is a "
    "rotation about an axis perpendicular to that direction; a constant σ is a rotation about the "
    "axes of the image."
)
RMS_BY_GROUP = (
    "Does one target, session or speed differ? rms of the residuals in σ. Good: all near 1 "
    "(dashed). A target that differs has another size or another mount; a session that differs: "
    "something moved before it; a rise with speed: a time offset or blur."
)
QUANTILE_PLOT = (
    "Are the residuals normally distributed? Their quantiles over those of N(0, 1). Good: on the "
    "dashed line. Steeper everywhere: the noise is larger than stated; ends that bend away: "
    "outliers. Board outlines are flatter, because the scans of a placement count as one."
)
MESSAGE_TIMING = (
    "Did messages arrive regularly? Left: intervals between stamps over their median. Right: delay "
    "of the log time after the stamp. Good: left a level line at 1, without points at 2 or above "
    "(lost messages) or at 0 (repeated messages); right a level band. A slope is a clock drift; "
    "a step is a clock that was set."
)
SCENE_3D = (
    "What does the rig look like? Sensors, targets at all used placements, and inliers coloured by "
    "their residual in σ (blue: short, grey: correct, red: long; for cameras its length), in the "
    "robot frame. Good: by the result all points lie on the targets, grey with red and blue mixed; "
    "by the initial guess they lie beside them. One colour on one target or on one side: a model "
    "error there."
)
LIDAR_ON_IMAGE = (
    "Returns coloured by distance, near yellow to far violet. Good: the colour changes at the "
    "edges of the target and of the objects behind it."
)
CORRELATION_MATRIX = (
    "Which errors occur together? Correlation of the errors of all poses, translations and "
    "rotations along the axes of each sensor; red: same sign, blue: opposite. Good: pale except on "
    "the diagonal. A strong pair within one sensor: the data cannot separate the two; views at "
    "other distances can. A strong pair between two sensors: they share an error, and their "
    "relative pose is more certain than each of them."
)
