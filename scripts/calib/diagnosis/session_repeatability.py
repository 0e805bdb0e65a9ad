"""Every session for itself: how well poses of sensors repeat, and which sensor moved between."""

from dataclasses import replace

import numpy as np
from scipy import stats

from calib.diagnosis.observability import UNDETERMINED_SIGMA
from calib.estimation.corrections.base import ModelCorrection
from calib.estimation.estimate_state import get_correction_values
from calib.estimation.pose_chain import ROBOT_MARKERS
from calib.estimation.solver import estimate_poses
from calib.geometry.se3 import invert_pose, se3_exp, se3_log


def session_setup(setup, result, session):
    """The Setup of one session's placements; targets, and the robot's markers, which it cannot tell
    by itself, sit where all sessions together put them."""
    at = [
        i for i, p in enumerate(setup.placements) if p.session == session and p.moving_view is None
    ]
    index = {k: i for i, k in enumerate(at)}
    anew = get_correction_values(setup, result.state, ROBOT_MARKERS, session)
    T = np.eye(4) if anew is None else se3_exp(anew)
    places = [
        replace(
            p,
            T_robot_body=T @ p.T_robot_body,
            T_body_target=result.state.mounts.get(p.target, p.T_body_target),
        )
        for p in (setup.placements[k] for k in at)
    ]
    groups = [
        replace(g, placement=index[g.placement], initial_features=None)
        for g in setup.groups
        if g.placement in index
    ]
    seen = {g.sensor for g in groups}
    kept = [h for h in setup.corrections if isinstance(h, ModelCorrection) and h.subject in seen]
    return replace(
        setup,
        models={n: m for n, m in setup.models.items() if n in seen},
        placements=places,
        groups=groups,
        initial_mounts={},
        corrections=tuple(kept),
    )


def session_poses(setup, result, session, **limits):
    """{sensor: (twist (6,) from its joint pose, covariance (6, 6))} by one session's data alone, of
    the sensors that these determine."""
    own = session_setup(setup, result, session)
    start = {n: result.state.T_robot_sensor[n] for n in own.models}
    found = estimate_poses(own, start, **limits)
    if found.solve_result is None:
        return {}
    spread, out = found.solve_result.covariance, {}
    for i, name in enumerate(sorted(own.models)):
        block = spread[6 * i : 6 * i + 6, 6 * i : 6 * i + 6]
        variances = np.diag(block)
        if (
            np.isfinite(variances).all()
            and (variances > 0).all()
            and (variances < UNDETERMINED_SIGMA**2).all()
        ):
            off = invert_pose(start[name]) @ found.state.T_robot_sensor[name]
            out[name] = se3_log(off), block
    return out


def repeatability_json(setup, result, **limits):
    """[{session, sensor, shift, sigma, others, chance}] of every session that is not alone.

    shift (6,): of the sensor's pose by that session alone from that by the others, m and rad, along
    the sensor's axes; sigma (6,): what both σ make of it; chance of so much where nothing moved.
    """
    names = sorted({p.session for p in setup.placements})
    if len(names) < 2 or result.solve_result is None:
        return []
    found = {s: session_poses(setup, result, s, **limits) for s in names}
    out = []
    for session in names:
        for sensor, (xi, block) in found[session].items():
            rest = [found[s][sensor] for s in names if s != session and sensor in found[s]]
            if rest:
                out.append(
                    {"session": session, "sensor": sensor, **_compare_with_others(xi, block, rest)}
                )
    return out


def _compare_with_others(xi, covariance, others):
    """What a twist (6,) and its covariance (6, 6) say against those of others."""
    weights = [np.linalg.inv(C) for _, C in others]
    both = np.linalg.inv(sum(weights))
    mean = both @ sum(W @ x for W, (x, _) in zip(weights, others, strict=True))
    shift, spread = xi - mean, covariance + both
    chance = stats.chi2.sf(shift @ np.linalg.solve(spread, shift), 6)
    sigma = np.sqrt(np.diag(spread))
    return {
        "shift": shift.tolist(),
        "sigma": sigma.tolist(),
        "n_other_sessions": len(others),
        "p_value": float(chance),
    }
