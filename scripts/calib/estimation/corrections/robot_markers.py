"""The robot's markers, mounted anew before a session: where its MCS body then sits in R."""

import numpy as np

from calib.estimation import estimate_state, pose_chain
from calib.estimation.corrections.correction import Hypothesis
from calib.geometry import se3
from calib.io.pose_block import pose_json

SIGMA = np.repeat([0.5, np.radians(60.0)], 3)  # m, rad: markers may sit anywhere on a robot
STEP = 1e-6  # m, rad


def corrections(notes, anew):
    """[Hypothesis] of the sessions that mounted the markers anew; if all did, but the first.

    notes: session -> sensor -> {T_robot_sensor: as extract worked it out, or None}. To begin with,
    the markers sit where a sensor says that one of the other sessions saw too.
    """
    fixed = [s for s in notes if s not in anew] or list(notes)[:1]
    out = []
    for session in (s for s in notes if s not in fixed):
        pairs = [
            (notes[f][n]["T_robot_sensor"], note["T_robot_sensor"])
            for n, note in sorted(notes[session].items())
            for f in fixed
            if n in notes[f]
        ]
        there = [(np.array(a), np.array(b)) for a, b in pairs if a is not None and b is not None]
        T = there[0][0] @ se3.inverse(there[0][1]) if there else np.eye(4)
        out.append(remounted(session, T))
    return out


def remounted(session, T_robot_markers):
    """The Hypothesis that a session's MCS body sits at T_robot_markers (4, 4) in the robot frame
    of the other sessions, or near: θ is its twist."""
    return Hypothesis(
        pose_chain.MARKERS, session, False, (), 6, _by_twist, lambda theta, sigma: "", "",
        SIGMA, lambda model, theta, placement: model, session=True,
        start=se3.se3_log(T_robot_markers),
    )  # fmt: skip


def _by_twist(view):
    """(6, k, n): what moving the markers does to the residuals of a view."""
    session = view.setup.placements[view.group.placement].session
    theta = estimate_state.number_of(view.setup, view.state, pose_chain.MARKERS, session)
    T = view.state.T_robot_sensor[view.group.sensor]
    back = se3.inverse(se3.se3_exp(theta)) @ T
    moved = se3.inverse(T) @ se3.se3_exp(theta + STEP * np.eye(6)) @ back
    there = [view.changed(T_sensor_target=M @ view.T_sensor_target) for M in moved]
    return (np.stack(there) - view.assigned.standard.T) / STEP


def told(setup, result):
    """{session: {T_robot_markers, covariance}} of those whose markers were mounted anew."""
    out = {}
    for h, at in setup.spans:
        if h.name == pose_chain.MARKERS:
            theta = result.state.theta[at]
            spread = result.solution.covariance[setup.chained :, setup.chained :]
            spread = spread[at, at] * np.outer(h.sigma, h.sigma)
            T = se3.se3_exp(theta)
            near = se3.inverse(T) @ se3.se3_exp(theta + STEP * np.eye(6))
            J = se3.se3_log(near).T / STEP
            spread = (J @ spread @ J.T).tolist()
            out[h.of] = {"T_robot_markers": pose_json(T), "covariance": spread}
    return out
