"""The robot's markers, mounted anew before a session: where its MCS body then sits in R."""

import numpy as np

from calib.estimation.corrections.correction import Correction
from calib.estimation.estimate_state import get_correction_values
from calib.estimation.pose_chain import ROBOT_MARKERS
from calib.geometry.se3 import invert_pose, se3_exp, se3_log
from calib.io.pose_block import pose_json

MARKERS_PRIOR_SIGMA = np.repeat(
    [0.5, np.radians(60.0)], 3
)  # m, rad: markers may sit anywhere on a robot
TWIST_STEP = 1e-6  # m, rad


def make_markers_corrections(notes_by_session, remounted_sessions):
    """[Hypothesis] of the sessions that mounted the markers anew; if all did, but the first.

    notes_by_session: session -> sensor -> {T_robot_sensor: as extract worked it out, or None}. To begin with,
    the markers sit where a sensor says that one of the other sessions saw too.
    """
    fixed = [s for s in notes_by_session if s not in remounted_sessions] or list(notes_by_session)[
        :1
    ]
    out = []
    for session in (s for s in notes_by_session if s not in fixed):
        pairs = [
            (notes_by_session[f][n]["T_robot_sensor"], note["T_robot_sensor"])
            for n, note in sorted(notes_by_session[session].items())
            for f in fixed
            if n in notes_by_session[f]
        ]
        there = [(np.array(a), np.array(b)) for a, b in pairs if a is not None and b is not None]
        T = there[0][0] @ invert_pose(there[0][1]) if there else np.eye(4)
        out.append(make_session_markers_correction(session, T))
    return out


def make_session_markers_correction(session, T_robot_markers):
    """The Hypothesis that a session's MCS body sits at T_robot_markers (4, 4) in the robot frame
    of the other sessions, or near: θ is its twist."""
    return Correction(
        ROBOT_MARKERS, session, False, (), 6, _markers_twist_derivative, lambda theta, sigma: "", "",
        MARKERS_PRIOR_SIGMA, lambda model, theta, placement: model, is_per_session=True,
        initial_values=se3_log(T_robot_markers),
    )  # fmt: skip


def _markers_twist_derivative(view):
    """(6, k, n): what moving the markers does to the residuals of a view."""
    session = view.setup.placements[view.group.placement].session
    theta = get_correction_values(view.setup, view.state, ROBOT_MARKERS, session)
    T = view.state.T_robot_sensor[view.group.sensor]
    back = invert_pose(se3_exp(theta)) @ T
    moved = invert_pose(T) @ se3_exp(theta + TWIST_STEP * np.eye(6)) @ back
    there = [view.residuals_with(T_sensor_target=M @ view.T_sensor_target) for M in moved]
    return (np.stack(there) - view.assignment.standardized.T) / TWIST_STEP


def robot_markers_json(setup, result):
    """{session: {T_robot_markers, covariance}} of those whose markers were mounted anew."""
    out = {}
    for h, at in setup.correction_slices:
        if h.name == ROBOT_MARKERS:
            theta = result.state.correction_values[at]
            spread = result.solve_result.covariance[
                setup.n_chain_unknowns :, setup.n_chain_unknowns :
            ]
            spread = spread[at, at] * np.outer(h.prior_sigma, h.prior_sigma)
            T = se3_exp(theta)
            near = invert_pose(T) @ se3_exp(theta + TWIST_STEP * np.eye(6))
            J = se3_log(near).T / TWIST_STEP
            spread = (J @ spread @ J.T).tolist()
            out[h.subject] = {"T_robot_markers": pose_json(T), "covariance": spread}
    return out
