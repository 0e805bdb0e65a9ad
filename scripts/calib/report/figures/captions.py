"""What each plot asks, how to read it, and what good looks like."""

STANDARDIZED_HISTOGRAM = (
    "Does the noise model hold? {n} residuals, rms {rms} σ; {out} beyond 3 σ (dotted); "
    "{expected}{good}"
)
STANDARDIZED_HISTOGRAM_GOOD = {
    "signed": "Good: bars fill the curve. Heavy tails are outliers, two humps a wrong model.",
    "length": "These are lengths, never negative. Good: one hump and a tail that ends soon after.",
    "board_outline": "A crossing lies anywhere between two beams, and the scans of a placement repeat it, "
    "which is why they weigh as one: flat or narrower than the curve is right here. "
    "Wider, or off to one side: the outline is wrong, or the beam's footprint widens it.",
}
RESIDUAL_HISTOGRAM = (
    "How large are they? rms {rms} {unit}. These are {meaning}: mostly the sensor's own noise, "
    "not the error of the calibration. Good: one peak about zero."
)
PIXEL_RESIDUALS = (
    "How large are they, and do they lean one way? rms {rms} px (2-D), mean ({u}, {v}) px. Good: "
    "one round cloud about zero. A streak points to motion or a time offset."
)
PLACEMENT_RMS = (
    "Is one placement off? Good: all about 1 (dashed). One far above the rest was not still, or "
    "the motion capture saw it wrongly."
)
PLACEMENT_RMS_SESSIONS = " A line parts the sessions, in order of name."
RESIDUAL_VECTORS = (
    "Do residuals depend on where in the image they are? Grey: every residual, × {gain}. Red: "
    "the mean of a cell with {few} or more, × {mean_gain}; the longest is {longest} px, and "
    "{beyond} of {cells} cells exceed 3 σ of their mean. Good: red arrows short and without "
    "order. A pattern that turns or opens with the radius: a wrong lens model; the same way "
    "everywhere: a time offset."
)
RESIDUALS_BY_RING = (
    "Does one beam read long or short? Dot: median, bar: 16 to 84 % of a ring's returns. Good: "
    "dots about zero. Dots that differ by more than a third of their bars are range biases of "
    "single beams, which the sensor's own calibration should remove."
)
RESIDUALS_BY_RANGE = (
    "Does the error grow with range? In σ, so that bars should span −1 to 1 (band) at every "
    "range. Good: level. Bars that widen: the noise grows with range; dots that climb: a range "
    "scale error."
)
LIDAR_RESIDUALS_BY_INCIDENCE = (
    "Does the error depend on how flat the beam meets the surface? Good: level, bars in the "
    "band. Dots that leave zero at large angles: the footprint of the beam."
)
SESSION_TIMELINE = (
    "When was there something to see? Bars: the target is still relative to the robot. Strokes: "
    "frames of a sensor, green used in the solve, orange kept but not used, short and grey not "
    "kept. Good: every bar holds green strokes of every sensor that faces it."
)
RIG_FIGURE = (
    "Where do the sensors sit, and how sure is that? Left: dot and stroke show a sensor's origin "
    "and the way it looks (a camera's z, a lidar's x), red by the first guess, green by the "
    "result. Right: σ of every number of a pose."
)
RIG_FIGURE_TRUTH = (
    " Diamonds: distance from the truth. Good: about two of three within their bar, hardly any "
    "beyond twice its height."
)
CAMERA_COVERAGE = (
    "Where in the image were targets measured? Good: points all over, corners of the image "
    "included, at several distances; directions of the boards' normals (dots) and of the round "
    "targets' axes (strokes), in the robot's frame, well apart."
)
LIDAR_COVERAGE = (
    "Which part of its view held targets? Good: several azimuths around, several heights, several "
    "distances; normals of the boards (dots) and axes of the round targets (strokes), in the "
    "robot's frame, well apart: three boards that all face the same way leave two directions open."
)
SIGMA_BY_PLACEMENTS = (
    "Would more placements help? The largest σ of each pose if only so many of its placements had "
    "been recorded, the median over random choices of them, with the noise that all show. Good: "
    "the curve has flattened, below the limit. Twice as many placements then bring it down by 1.4."
)
PLACEMENT_INFLUENCE = (
    "Does the result hang on one placement? Bars: how far the pose moves without it, in its σ. "
    "Dots: what the placement says of the target's pose against what the others predict, over what "
    "both σ expect, per direction. Good: bars well below 1 where there are many, dots about 1 "
    "(dashed). A dot above 3 was not still, or was seen wrongly by the motion capture."
)
PIXEL_SIGMA_MAP = (
    "How far off may a point of another sensor, 10 m from the camera, fall in the image? Lines of "
    "equal σ, px; the cross marks the worst place. Good: below a pixel all over. What grows to one "
    "side is a rotation about an axis that lies across it; what is the same everywhere, one about "
    "the axes of the image."
)
RMS_BY_GROUP = (
    "Does one target, session or speed stand out? rms of the residuals in σ. Good: all about 1 "
    "(dashed). A target that stands out is of another size or mounted elsewhere; a session, after "
    "something moved; a rise with speed is a clock that is off or a blur."
)
QUANTILE_PLOT = (
    "Are the residuals normal? Their quantiles over those of N(0, 1). Good: on the dashed line. "
    "Steeper all over: the noise is larger than stated; ends that turn away: outliers; edges are "
    "flatter, as they weigh as one."
)
MESSAGE_TIMING = (
    "Did messages come as they should? Left: every interval between stamps over the usual one. "
    "Right: how late the log took each message. Good: left a level line at 1, without points at 2 "
    "or more (lost messages) or at 0 (repeated ones); right a level band. A slope is a clock that "
    "drifts, steps are a clock that was set."
)
SCENE_3D = (
    "What does it look like? Sensors, targets at every placement that was used, and members "
    "coloured by their residual in σ (blue short, grey right, red long; of cameras its size), in "
    "the robot's frame. Good: by the result all points lie on the targets, grey with red and blue "
    "mixed; by the first guess they lie beside them. One colour on one target or at one side: "
    "something is not modelled there."
)
LIDAR_ON_IMAGE = (
    "Returns coloured by distance, near yellow to far violet. Good: colours change at the edges "
    "of the target and of what stands behind it."
)
CORRELATION_MATRIX = (
    "Which numbers are off together? Correlation of all errors, translations and rotations along "
    "each sensor's axes; red: both the same way, blue: opposite. Good: pale but for the diagonal. "
    "A strong pair within one sensor trades one for the other: views at other distances part "
    "them. Strong between two sensors: they share what is unsure, and their relative pose is surer "
    "than each of them."
)
CAMERA_RESIDUALS_BY_INCIDENCE = (
    "Does the error depend on how flat the target is seen? Good: level, bars in the band. Bars "
    "that widen at large angles: blur, or corners that are hard to find."
)
