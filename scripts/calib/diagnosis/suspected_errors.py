"""What is probably wrong about targets and sensors, from the residuals of a settled estimate.

Every Hypothesis is put to a score test (scores.py). The best explanation is accepted first, then
the others are tried beside it: what then has nothing left to say was another name for the same.
"""

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from calib.diagnosis.observability import ARM
from calib.estimation import noise_model, pose_chain
from calib.estimation.corrections import score_test
from calib.estimation.corrections.correction import View
from calib.estimation.corrections.session_shifts import MOVED
from calib.estimation.nlp.information_matrix import inverse
from calib.estimation.residuals import residual_registry

CONSIDERED = 1e-3  # chance of so large a gain where nothing is wrong, above which it is no news
MOST = 6  # explanations accepted one beside the other
LEAST_NOISE = 1e-4  # of the variance that was estimated
RIVAL = 0.5  # of the best gain: a hypothesis that explains so much might be meant instead
SIMPLER = 3.0  # log likelihood by which every further number must explain more to be preferred
MCS = "mocap"


def suspicions(setup, result, found):
    """The accepted explanations as plain data, none without a solution; of a Setup of still
    placements alone, for views in motion have errors of their own. found: the hypotheses to try.

    First what would move a pose the most. Each: name, of, text, remedy; estimate and sigma of its
    numbers (m, rad, px or 1); gain in log likelihood and the chance of it where nothing is wrong;
    explained {"sensor/kind": share of its squares}; shift {sensor: {m, rad, sigmas}} of the poses
    if it alone were mended, in the σ that they would then have; rivals, the other hypotheses that
    would do instead: name, of, text, remedy, estimate, sigma, gain.
    """
    if result.solution is None:
        return []
    ends = np.cumsum([0] + [h.size for h in found])
    columns = [np.arange(a, b) for a, b in zip(ends[:-1], ends[1:], strict=True)]
    terms = noises(setup, result, found, columns)
    moved = {i for i, h in enumerate(found) if h.name in MOVED}
    names = sorted(setup.models)
    out = [told(found, columns, terms, names, *step) for step in accepted(columns, terms, moved)]
    for one in out:
        elsewhere = {s["remedy"] for s in out} - {one["remedy"]}
        one["rivals"] = [r for r in one["rivals"] if r["remedy"] not in elsewhere]
    return sorted(out, key=_impact, reverse=True)


def accepted(columns, terms, moved):
    """[(Fit without it, {index: (Fit, gain, scatter)} of it and its rivals, its index)].

    The best is taken first, then others beside it as long as they have something to say; what
    those that came later have made superfluous is put back, or its better rival taken. moved: the
    indices of those that are taken only where nothing that stays as it is explains half as much.
    """
    chosen = []
    while len(chosen) < MOST:
        found = gains(columns, terms, _free(columns, terms, chosen))
        if not found:
            break
        chosen.append(_best(columns, found, moved))
    for _ in range(MOST):
        out = {i: _beside(columns, terms, chosen, i) for i in chosen}
        revised = list(dict.fromkeys(_best(columns, f, moved) for _, f in out.values() if f))
        if revised == chosen:
            break
        chosen = revised
    out = {i: _beside(columns, terms, chosen, i) for i in chosen}
    return [(*out[i], i) for i in chosen if i in out[i][1]]


def _best(columns, found, moved):
    """Index of the hypothesis that explains the most for its numbers."""
    most = max(gain for _, gain, _ in found.values())
    stays = [i for i, f in found.items() if i not in moved and f[1] >= RIVAL * most]
    return max(stays or found, key=lambda i: found[i][1] - SIMPLER * len(columns[i]))


def _free(columns, terms, chosen):
    """The Fit with the numbers of some hypotheses free."""
    return score_test.fitted(
        terms, np.concatenate([np.zeros(0, int), *(columns[i] for i in chosen)])
    )


def _beside(columns, terms, chosen, best):
    """The Fit of the others, and what `best` and its rivals would explain beside them."""
    now = _free(columns, terms, [i for i in chosen if i != best])
    found = gains(columns, terms, now)
    least = RIVAL * found[best][1] if best in found else np.inf
    return now, {i: f for i, f in found.items() if f[1] >= least}


def gains(columns, terms, now):
    """{index: (Fit, gain, scatter)} of the hypotheses that, beside those free in `now`, explain
    more than chance; the gain has been divided by the scatter."""
    system, out = score_test.System(terms, now.factor), {}
    drop = system.drop(now.free)
    for i, own in enumerate(columns):
        both = np.concatenate([now.free, own])
        more = system.drop(both) - drop
        if np.isin(own, now.free).any() or score_test.chance(more, len(own)) > CONSIDERED:
            continue
        fit = score_test.fitted(terms, both)
        scatter = score_test.scatter(terms, fit, own)
        gain = (fit.likelihood - now.likelihood) / scatter
        if score_test.chance(gain, len(own)) < CONSIDERED:
            out[i] = fit, gain, scatter
    return out


def noises(setup, result, found, columns):
    """{"sensor/kind" or MCS: scores.Noise} at the optimum."""
    n, p = len(result.solution.information), sum(h.size for h in found)
    parts = result.solution.parts
    errors, y = mcs_errors(setup, result)
    cluster = together(setup, parts, errors)
    blocks, least, owner = {}, {}, {}
    for g, a, part in zip(setup.groups, result.assigned, parts, strict=True):
        key, scale = f"{g.sensor}/{g.kind}", result.state.noise[noise_model.of(g)].total
        view = View(setup, result.state, pose_chain.model(setup, result.state, g), g, a, part.J)
        blocks.setdefault(key, []).append(_block(view, part, found, columns, cluster[g.placement]))
        # Where σ is the step of a scan pattern, it is at least that step.
        step = residual_registry.KINDS[g.kind].ROUNDING is None
        least[key] = 1 / scale**2 if step else LEAST_NOISE
        owner |= dict.fromkeys(part.columns.tolist(), cluster[g.placement])
    told = determined(result.solution.information, errors) / len(errors)
    of_mcs = [_prior(c, v, owner.get(c, -1), told) for c, v in zip(errors.tolist(), y, strict=True)]
    blocks[MCS], least[MCS] = of_mcs, 1 / result.state.mocap**2
    return {k: score_test.Noise(b, n, p, least[k]) for k, b in blocks.items()}


def _block(view, part, found, columns, cluster):
    """The scores.Block of one group."""
    near = [i for i, h in enumerate(found) if h.touches(view.setup, view.group)]
    none = np.zeros((0, len(part.r), part.r.shape[1]))
    D = np.concatenate([none, *(found[i].derivative(view) for i in near)])
    at = np.concatenate([np.zeros(0, int), *(columns[i] for i in near)])
    w, r = part.weight, part.r
    return score_test.Block(
        cluster,
        part.columns,
        at,
        part.hessian,
        part.by_unknowns(D),
        np.einsum("pkn,qkn->pq", D * w, D, optimize=True),
        part.slope,
        np.einsum("qkn,kn->q", D * w, r, optimize=True),
        float(np.sum(w * r**2)),
        float(np.sum(w)) * len(r),
    )


def _prior(column, value, cluster, told):
    """The scores.Block of one MCS error, which counts for what the data tell of it."""
    none, at = np.zeros((1, 0)), np.zeros(0, int)
    own = np.array([column]), at, np.eye(1), none, np.zeros((0, 0)), np.array([value]), at * 0.0
    return score_test.Block(cluster, *own, float(value**2), told)


def told(found, columns, terms, names, before, fits, best):
    """One accepted explanation as plain data."""
    after, gain, _ = fits[best]
    own = found[best].name, found[best].of
    others = [i for i in fits if (found[i].name, found[i].of) != own]
    others.sort(key=lambda i: -fits[i][1])
    return _numbers(found[best], columns[best], *fits[best]) | {
        "chance": score_test.chance(gain, len(columns[best])),
        "explained": {k: 1 - after.left[k] / v for k, v in before.left.items() if v > 0},
        "shift": _shifts(names, _free(columns, terms, []), _free(columns, terms, [best])),
        "rivals": [_numbers(found[i], columns[i], *fits[i]) for i in others],
    }


def _impact(suspected):
    """How far, m, mending it would move what a sensor sees at ARM."""
    return max(s["m"] + ARM * s["rad"] for s in suspected["shift"].values())


def _shifts(names, before, after):
    """{sensor: how far its pose moves from one Fit to another: m, rad, and the largest of its six
    numbers in the σ of the latter}."""
    rows = np.arange(6 * len(names))
    moved = (after.x - before.x)[rows].reshape(-1, 6)
    spread = np.sqrt(np.diag(after.system.covariance(after.free, rows)[1])).reshape(-1, 6)
    out = {}
    for name, by, sigma in zip(names, moved, spread, strict=True):
        m, rad = (float(np.linalg.norm(part)) for part in (by[:3], by[3:]))
        out[name] = {"m": m, "rad": rad, "sigmas": float((np.abs(by) / sigma).max())}
    return out


def _numbers(hypothesis, own, fit, gain, scatter):
    """What a Fit says of a hypothesis, as plain data."""
    theta, covariance = fit.theta[own], fit.system.covariance(fit.free, [])[0]
    sigma = np.sqrt(scatter * np.diag(covariance)[np.isin(fit.free, own)])
    return {
        "name": hypothesis.name,
        "of": hypothesis.of,
        "text": hypothesis.told(theta, sigma),
        "remedy": hypothesis.remedy,
        "estimate": theta.tolist(),
        "sigma": sigma.tolist(),
        "gain": gain,
    }


def mcs_errors(setup, result):
    """Columns (m,) of the MCS errors in the unknowns, and their values (m,) in σ of the priors."""
    return np.arange(setup.poses, setup.chained), result.state.y.reshape(-1)


def determined(information, columns):
    """How many of the unknowns with unit priors the data tell: a sum of shares (MacKay 1992)."""
    return float(np.sum(1 - np.diag(inverse(information))[columns]))


def together(setup, parts, shared):
    """Number (placements,) of the set that a placement belongs to: those that share unknowns.

    parts: parts.Part of every group; shared: columns of the unknowns that tie placements.
    """
    at = [np.intersect1d(part.columns, shared) for part in parts]
    rows = np.repeat([g.placement for g in setup.groups], [len(a) for a in at])
    columns = np.concatenate([*at, np.zeros(0, int)]).astype(int)
    n, m = len(setup.placements), int(max(columns, default=-1)) + 1
    ties = sparse.coo_matrix((np.ones(len(rows)), (rows, n + columns)), (n + m, n + m))
    return connected_components(ties, directed=False)[1][:n]
