"""What is probably wrong about targets and sensors, from the residuals of a settled estimate.

Every Hypothesis is put to a score test (scores.py). The best explanation is accepted first, then
the others are tried beside it: what then has nothing left to say was another name for the same.
"""

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from calib.diagnosis.observability import LEVER_ARM_M
from calib.estimation.corrections.group_linearization import GroupLinearization
from calib.estimation.corrections.score_test import (
    NoiseTerm,
    ScoreBlock,
    ScoreSystem,
    cluster_scatter,
    fit_score_step,
    gain_p_value,
)
from calib.estimation.corrections.session_shifts import SESSION_SHIFT_NAMES
from calib.estimation.nlp.information_matrix import invert_information
from calib.estimation.noise_model import noise_key
from calib.estimation.pose_chain import model_with_corrections
from calib.estimation.residuals.residual_registry import RESIDUAL_KINDS

P_CONSIDER = 1e-3  # chance of so large a gain where nothing is wrong, above which it is no news
MAX_SUSPECTED_ERRORS = 6  # explanations accepted one beside the other
MIN_VARIANCE_FACTOR = 1e-4  # of the variance that was estimated
MIN_RIVAL_GAIN_RATIO = (
    0.5  # of the best gain: a hypothesis that explains so much might be meant instead
)
MIN_GAIN_PER_PARAMETER = (
    3.0  # log likelihood by which every further number must explain more to be preferred
)
MOCAP_NOISE_NAME = "mocap_noise"


def find_suspected_errors(setup, result, candidates):
    """The accepted explanations as plain data, none without a solution; of a Setup of still
    placements alone, for views in motion have errors of their own. candidates: the hypotheses to try.

    First what would move a pose the most. Each: name, of, text, remedy; estimate and sigma of its
    numbers (m, rad, px or 1); gain in log likelihood and the chance of it where nothing is wrong;
    explained {"sensor/kind": share of its squares}; shift {sensor: {m, rad, sigmas}} of the poses
    if it alone were mended, in the σ that they would then have; rivals, the other hypotheses that
    would do instead: name, of, text, remedy, estimate, sigma, gain.
    """
    if result.solve_result is None:
        return []
    ends = np.cumsum([0] + [h.n_values for h in candidates])
    columns = [np.arange(a, b) for a, b in zip(ends[:-1], ends[1:], strict=True)]
    terms = make_noise_terms(setup, result, candidates, columns)
    moved = {i for i, h in enumerate(candidates) if h.name in SESSION_SHIFT_NAMES}
    names = sorted(setup.models)
    out = [
        suspected_error_json(candidates, columns, terms, names, *step)
        for step in select_suspected_errors(columns, terms, moved)
    ]
    for one in out:
        elsewhere = {s["remedy"] for s in out} - {one["remedy"]}
        one["alternatives"] = [r for r in one["alternatives"] if r["remedy"] not in elsewhere]
    return sorted(out, key=_pose_impact_m, reverse=True)


def select_suspected_errors(columns, terms, shift_indices):
    """[(Fit without it, {index: (Fit, gain, scatter)} of it and its rivals, its index)].

    The best is taken first, then others beside it as long as they have something to say; what
    those that came later have made superfluous is put back, or its better rival taken. shift_indices: the
    indices of those that are taken only where nothing that stays as it is explains half as much.
    """
    chosen = []
    while len(chosen) < MAX_SUSPECTED_ERRORS:
        found = score_corrections(columns, terms, _fit_chosen(columns, terms, chosen))
        if not found:
            break
        chosen.append(_best_correction_index(columns, found, shift_indices))
    for _ in range(MAX_SUSPECTED_ERRORS):
        out = {i: _score_beside_others(columns, terms, chosen, i) for i in chosen}
        revised = list(
            dict.fromkeys(
                _best_correction_index(columns, f, shift_indices) for _, f in out.values() if f
            )
        )
        if revised == chosen:
            break
        chosen = revised
    out = {i: _score_beside_others(columns, terms, chosen, i) for i in chosen}
    return [(*out[i], i) for i in chosen if i in out[i][1]]


def _best_correction_index(columns, found, moved):
    """Index of the hypothesis that explains the most for its numbers."""
    most = max(gain for _, gain, _ in found.values())
    stays = [i for i, f in found.items() if i not in moved and f[1] >= MIN_RIVAL_GAIN_RATIO * most]
    return max(stays or found, key=lambda i: found[i][1] - MIN_GAIN_PER_PARAMETER * len(columns[i]))


def _fit_chosen(columns, terms, chosen):
    """The Fit with the numbers of some hypotheses free."""
    return fit_score_step(terms, np.concatenate([np.zeros(0, int), *(columns[i] for i in chosen)]))


def _score_beside_others(columns, terms, chosen, best):
    """The Fit of the others, and what `best` and its rivals would explain beside them."""
    now = _fit_chosen(columns, terms, [i for i in chosen if i != best])
    found = score_corrections(columns, terms, now)
    least = MIN_RIVAL_GAIN_RATIO * found[best][1] if best in found else np.inf
    return now, {i: f for i, f in found.items() if f[1] >= least}


def score_corrections(columns, terms, current_step):
    """{index: (Fit, gain, scatter)} of the hypotheses that, beside those free in `now`, explain
    more than chance; the gain has been divided by the scatter."""
    system, out = ScoreSystem(terms, current_step.variance_factors), {}
    drop = system.cost_drop(current_step.free_index)
    for i, own in enumerate(columns):
        both = np.concatenate([current_step.free_index, own])
        more = system.cost_drop(both) - drop
        if np.isin(own, current_step.free_index).any() or gain_p_value(more, len(own)) > P_CONSIDER:
            continue
        fit = fit_score_step(terms, both)
        scatter = cluster_scatter(terms, fit, own)
        gain = (fit.log_likelihood - current_step.log_likelihood) / scatter
        if gain_p_value(gain, len(own)) < P_CONSIDER:
            out[i] = fit, gain, scatter
    return out


def make_noise_terms(setup, result, found, columns):
    """{"sensor/kind" or MCS: scores.Noise} at the optimum."""
    n, p = len(result.solve_result.information), sum(h.n_values for h in found)
    parts = result.solve_result.factors
    errors, y = mocap_error_columns(setup, result)
    cluster = placement_clusters(setup, parts, errors)
    blocks, least, owner = {}, {}, {}
    for g, a, part in zip(setup.groups, result.assignments, parts, strict=True):
        key, scale = f"{g.sensor}/{g.kind}", result.state.noise[noise_key(g)].total
        view = GroupLinearization(
            setup, result.state, model_with_corrections(setup, result.state, g), g, a, part.J_pose
        )
        blocks.setdefault(key, []).append(
            _measurement_score_block(view, part, found, columns, cluster[g.placement])
        )
        # Where σ is the step of a scan pattern, it is at least that step.
        step = RESIDUAL_KINDS[g.kind].MIN_SIGMA is None
        least[key] = 1 / scale**2 if step else MIN_VARIANCE_FACTOR
        owner |= dict.fromkeys(part.columns.tolist(), cluster[g.placement])
    told = count_determined_unknowns(result.solve_result.information, errors) / len(errors)
    of_mcs = [
        _mocap_score_block(c, v, owner.get(c, -1), told)
        for c, v in zip(errors.tolist(), y, strict=True)
    ]
    blocks[MOCAP_NOISE_NAME], least[MOCAP_NOISE_NAME] = (
        of_mcs,
        1 / result.state.mocap_noise_factor**2,
    )
    return {k: NoiseTerm(b, n, p, least[k]) for k, b in blocks.items()}


def _measurement_score_block(view, part, found, columns, cluster):
    """The scores.Block of one group."""
    near = [i for i, h in enumerate(found) if h.affects(view.setup, view.group)]
    none = np.zeros((0, len(part.residuals), part.residuals.shape[1]))
    D = np.concatenate([none, *(found[i].derivative(view) for i in near)])
    at = np.concatenate([np.zeros(0, int), *(columns[i] for i in near)])
    w, r = part.weight, part.residuals
    return ScoreBlock(
        cluster,
        part.columns,
        at,
        part.hessian_x,
        part.cross_information(D),
        np.einsum("pkn,qkn->pq", D * w, D, optimize=True),
        part.gradient_x,
        np.einsum("qkn,kn->q", D * w, r, optimize=True),
        float(np.sum(w * r**2)),
        float(np.sum(w)) * len(r),
    )


def _mocap_score_block(column, value, cluster, told):
    """The scores.Block of one MCS error, which counts for what the data tell of it."""
    none, at = np.zeros((1, 0)), np.zeros(0, int)
    own = np.array([column]), at, np.eye(1), none, np.zeros((0, 0)), np.array([value]), at * 0.0
    return ScoreBlock(cluster, *own, float(value**2), told)


def suspected_error_json(candidates, columns, terms, sensors, step_without, scored, best_index):
    """One accepted explanation as plain data."""
    after, gain, _ = scored[best_index]
    own = candidates[best_index].name, candidates[best_index].subject
    others = [i for i in scored if (candidates[i].name, candidates[i].subject) != own]
    others.sort(key=lambda i: -scored[i][1])
    return _scored_correction_json(
        candidates[best_index], columns[best_index], *scored[best_index]
    ) | {
        "p_value": gain_p_value(gain, len(columns[best_index])),
        "explained_share": {
            k: 1 - after.squares_after[k] / v
            for k, v in step_without.squares_after.items()
            if v > 0
        },
        "pose_shift": _pose_shifts_json(
            sensors, _fit_chosen(columns, terms, []), _fit_chosen(columns, terms, [best_index])
        ),
        "alternatives": [
            _scored_correction_json(candidates[i], columns[i], *scored[i]) for i in others
        ],
    }


def _pose_impact_m(suspected):
    """How far, m, mending it would move what a sensor sees at ARM."""
    return max(s["m"] + LEVER_ARM_M * s["rad"] for s in suspected["pose_shift"].values())


def _pose_shifts_json(names, before, after):
    """{sensor: how far its pose moves from one Fit to another: m, rad, and the largest of its six
    numbers in the σ of the latter}."""
    rows = np.arange(6 * len(names))
    moved = (after.x - before.x)[rows].reshape(-1, 6)
    spread = np.sqrt(np.diag(after.system.covariance(after.free_index, rows)[1])).reshape(-1, 6)
    out = {}
    for name, by, sigma in zip(names, moved, spread, strict=True):
        m, rad = (float(np.linalg.norm(part)) for part in (by[:3], by[3:]))
        out[name] = {"m": m, "rad": rad, "sigmas": float((np.abs(by) / sigma).max())}
    return out


def _scored_correction_json(hypothesis, own, fit, gain, scatter):
    """What a Fit says of a hypothesis, as plain data."""
    theta, covariance = fit.correction_values[own], fit.system.covariance(fit.free_index, [])[0]
    sigma = np.sqrt(scatter * np.diag(covariance)[np.isin(fit.free_index, own)])
    return {
        "name": hypothesis.name,
        "subject": hypothesis.subject,
        "description": hypothesis.describe(theta, sigma),
        "remedy": hypothesis.remedy,
        "estimate": theta.tolist(),
        "sigma": sigma.tolist(),
        "log_likelihood_gain": gain,
    }


def mocap_error_columns(setup, result):
    """Columns (m,) of the MCS errors in the unknowns, and their values (m,) in σ of the priors."""
    return np.arange(
        setup.n_pose_unknowns, setup.n_chain_unknowns
    ), result.state.mocap_errors.reshape(-1)


def count_determined_unknowns(information, columns):
    """How many of the unknowns with unit priors the data tell: a sum of shares (MacKay 1992)."""
    return float(np.sum(1 - np.diag(invert_information(information))[columns]))


def placement_clusters(setup, factors, tie_columns):
    """Number (placements,) of the set that a placement belongs to: those that share unknowns.

    factors: parts.Part of every group; tie_columns: columns of the unknowns that tie placements.
    """
    at = [np.intersect1d(part.columns, tie_columns) for part in factors]
    rows = np.repeat([g.placement for g in setup.groups], [len(a) for a in at])
    columns = np.concatenate([*at, np.zeros(0, int)]).astype(int)
    n, m = len(setup.placements), int(max(columns, default=-1)) + 1
    ties = sparse.coo_matrix((np.ones(len(rows)), (rows, n + columns)), (n + m, n + m))
    return connected_components(ties, directed=False)[1][:n]
