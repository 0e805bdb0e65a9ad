"""What one view more would tell: which of many proposals narrows a pose's worst direction most.

A proposal is measured as the target was: what a sensor found of it in the recorded placement most
alike is carried along with the target, and what that says of the unknowns is added to what all
recordings say, at the noise that was found. First order, as crossvalidation is.
"""

from dataclasses import dataclass, replace

import numpy as np

from calib.diagnosis import consider_covariance, observability
from calib.diagnosis.view_candidates import proposals
from calib.estimation import pose_chain, solver
from calib.estimation.nlp.information_matrix import covariance, inverse
from calib.estimation.nlp.measurement_factor import information
from calib.estimation.residuals import residual_registry
from calib.geometry import se3
from calib.io import pose_block
from calib.sensors.camera.camera_model import Camera
from calib.views import field_of_view

MANY = 4  # such views, of which the σ is told too


@dataclass(frozen=True)
class More:
    """What a new placement says of the unknowns of some numbers, columns (m,), that others share:
    information H (m, m), and how its slopes (m, q) depend on errors that nobody estimates."""

    columns: np.ndarray
    H: np.ndarray
    G: np.ndarray


@dataclass(frozen=True)
class Before:
    """What all recordings say: covariance P (n, n) of the unknowns but for the errors that nobody
    estimates (considered.told), their G (n, q) and σ (q,)."""

    P: np.ndarray
    G: np.ndarray
    sigma: np.ndarray

    @classmethod
    def of(cls, setup, result):
        weight = pose_chain.priors(setup, result.state)[1]
        P = covariance(information(result.solution.parts, weight))
        return cls(P, *consider_covariance.told(setup, result))

    def covariance(self, own, more=None, times=1):
        """(6, 6) of a sensor's pose, unknowns `own`, with so many placements like More besides."""
        rows, G = self.P[own], self.G
        if more is not None:
            c, H = more.columns, times * more.H
            # Woodbury, for the rows of the sensor alone.
            mixed = np.eye(len(c)) + self.P[np.ix_(c, c)] @ H
            rows = rows - rows[:, c] @ H @ np.linalg.solve(mixed, self.P[c])
            G = G.copy()
            G[c] += times * more.G
        follows = rows @ G * self.sigma
        return rows[:, own] + follows @ follows.T


def best_views(setup, result, sensors, options):
    """{sensor: what best_view says of it}."""
    if not sensors:
        return {}
    before = Before.of(setup, result)
    return {n: best_view(setup, result, before, n, options) for n in sensors}


def best_view(setup, result, before, sensor, options):
    """{target, T_sensor_target, words, direction, unit, sigma, sigma_one, sigma_four} of the
    proposal that narrows the least certain direction of a sensor's pose the most, or None where
    there is none.

    sigma: of that direction now, m or rad as unit says; sigma_one, sigma_four: with one such
    placement more, and with four. options: min_returns and max_incidence_deg of a view.
    """
    first, best = 6 * sorted(setup.models).index(sensor), None
    own = slice(first, first + 6)
    weights, sigma, unit = observability.loosest(before.covariance(own))
    for name, T, words, more in told(setup, result, sensor, options):
        spreads = [before.covariance(own, more, n) for n in (1, MANY)]
        after = [float(np.sqrt(max(weights @ spread @ weights, 0.0))) for spread in spreads]
        if best is None or after[0] < best["sigma_one"]:
            best = {"target": name, "T_sensor_target": pose_block.pose_json(T), "words": words}
            best |= {"sigma_one": after[0], "sigma_four": after[1]}
    if best is None:
        return None
    where = observability.in_words(weights, result.state.T_robot_sensor[sensor])
    return best | {"direction": where, "unit": unit, "sigma": sigma}


def told(setup, result, sensor, options):
    """(target, T_sensor_target (4, 4), in words, More) of every proposal for a sensor that it would
    see."""
    state, model = result.state, setup.models[sensor]
    T_robot_sensor, seen = state.T_robot_sensor[sensor], recorded(setup, result, sensor)
    heights = [pose_chain.T_robot_target(setup, state, k)[2, 3] for k in seen]
    by_target = {}
    for k in seen:
        by_target.setdefault(setup.placements[k].target, []).append(k)
    for name, own in sorted(by_target.items()):
        target = setup.targets[name]
        if target.points is not None:
            continue
        T = np.stack([pose_chain.T_sensor_target(setup, state, sensor, k) for k in own])
        limits = min(heights), max(heights)
        patterns = {k: Pattern(setup, result, sensor, seen[k]) for k in own}
        for there in proposals(target, model, T, limits, T_robot_sensor):
            if not hidden(model, target, there.T, options):
                pattern = patterns[own[alike(T, there.T, target)]]
                yield name, there.T, there.words, pattern.at(there.T)


def recorded(setup, result, sensor):
    """{placement: [(Group, Assignment)]} of the still ones that a sensor has members in."""
    out = {}
    for g, a in zip(setup.groups, result.assigned, strict=True):
        if g.sensor == sensor and not g.moving and (a.feature >= 0).any():
            out.setdefault(g.placement, []).append((g, a))
    return out


def hidden(model, target, T_sensor_target, options):
    """Why the sensor would not see a target well, in words; "" when it would."""
    of = (
        field_of_view.hidden_from_camera
        if isinstance(model, Camera)
        else field_of_view.hidden_from_lidar
    )
    return of(model, target, T_sensor_target, np.zeros(6), options)


def alike(T, there, target):
    """Index of the pose of T (k, 4, 4) from which a target looks most as it would from `there`: as
    far off, and under the same incidence."""
    distance, cosine = _looks(target, there)
    found = np.array([_looks(target, t) for t in T])
    return int((np.abs(np.log(found[:, 0] / distance)) + np.abs(found[:, 1] - cosine)).argmin())


def _looks(target, T_sensor_target):
    """(distance, m, cosine of incidence) of a target."""
    centre = se3.transform(T_sensor_target, target.centre)
    return np.linalg.norm(centre), target.faces(se3.inverse(T_sensor_target)[:3, 3])[1]


class Pattern:
    """What a sensor found of a target in one placement, to be carried elsewhere."""

    def __init__(self, setup, result, sensor, found):
        self.setup, self.sensor, self.found = setup, sensor, [members(*f) for f in found]
        self.k = found[0][0].placement
        self.T = pose_chain.T_sensor_target(setup, result.state, sensor, self.k)
        # A new placement has errors of the MCS of its own, of which nothing is known yet.
        y = result.state.y.copy()
        y[[setup.robots[self.k], setup.bodies[self.k]]] = 0
        self.state = replace(result.state, y=y)
        alone = replace(setup, groups=[g for g, _ in self.found])
        self.problem = solver.build(alone)
        self.problem.with_models(solver.lenses(alone, self.state))

    def at(self, T_sensor_target):
        """The More of the same measurements of the target at T_sensor_target (4, 4)."""
        there = self._setup(T_sensor_target)
        found = zip(there.groups, solver.assign_all(there, self.state), strict=True)
        more = self._more(T_sensor_target)
        assigned = [
            replace(a, trust=a.trust * more[residual_registry.KINDS[g.kind].UNIT]) for g, a in found
        ]
        slopes = solver.slopes(there, self.state, assigned)
        given = *pose_chain.unknowns(there, self.state), pose_chain.chains(there, self.state)
        parts = self.problem.parts(*given, assigned, slopes, solver.errors(there, self.state))
        unknown = consider_covariance.errors(there, self.state)
        given = there, self.state, assigned, parts
        G = [np.zeros((there.n, 0)), *(consider_covariance.coupling(*given, h) for h, _ in unknown)]
        return _reduced(parts, np.hstack(G), there)

    def _setup(self, T_sensor_target):
        """The Setup of this placement alone, its target at T_sensor_target and its measurements
        with it."""
        setup, state, k = self.setup, self.state, self.k
        place = setup.placements[k]
        markers = pose_chain.T_robot_body(setup, state, k) @ se3.inverse(place.T_robot_body)
        T_robot_target = state.T_robot_sensor[self.sensor] @ T_sensor_target
        T_target_body = se3.inverse(pose_chain.T_body_target(setup, state, k))
        there = replace(place, T_robot_body=se3.inverse(markers) @ T_robot_target @ T_target_body)
        move = T_sensor_target @ se3.inverse(self.T)
        groups = [carried(g, r, setup.models[self.sensor], move) for g, r in self.found]
        places = [there if i == k else p for i, p in enumerate(setup.placements)]
        return replace(setup, placements=places, groups=groups)

    def _more(self, T_sensor_target):
        """How many times as many measurements there are, by unit: a lidar's returns thin out with
        the distance and the slant, its crossings of an outline with the distance alone."""
        target = self.setup.targets[self.setup.placements[self.k].target]
        (near, steep), (far, flat) = _looks(target, self.T), _looks(target, T_sensor_target)
        returns = (near / far) ** 2 * max(flat, 1e-3) / max(steep, 1e-3)
        return {"px": 1.0, "m": returns, "rad": near / far}


def members(group, assigned):
    """(Group, ranges (n, 1)) of the members alone."""
    kept = assigned.feature >= 0
    return replace(group, keypoints=_kept(group.keypoints, kept)), assigned.range[kept, None]


def _kept(columns, kept):
    return {name: np.asarray(column)[kept] for name, column in columns.items()}


def carried(group, ranges, model, move):
    """The group with its measurements where they would be, had what they meet at ranges (n, 1)
    moved by (4, 4), sensor frame, m; without pixels that leave the image."""
    k = group.keypoints
    if isinstance(model, Camera):
        ray, _ = model.unproject(k["uv"])
        p = ray / np.linalg.norm(ray, axis=1)[:, None] * ranges
        uv, seen = model.project(se3.transform(move, p))
        return replace(group, keypoints=_kept(k | {"uv": uv}, seen & model.in_image(uv)))
    length = np.linalg.norm(k["xyz"], axis=1)[:, None]
    p = se3.transform(move, k["xyz"] / length * ranges)
    if residual_registry.KINDS[group.kind].UNIT == "rad":
        p = p / np.linalg.norm(p, axis=1)[:, None]
    return replace(group, keypoints=k | {"xyz": p})


def _reduced(parts, G, setup):
    """The More of the parts of one new placement, its MCS errors marginalised; G (n, q): how the
    slopes by the unknowns depend on errors that nobody estimates."""
    columns = np.unique(np.concatenate([p.columns for p in parts]))
    H = np.zeros((len(columns), len(columns)))
    for part in parts:
        at = np.searchsorted(columns, part.columns)
        H[np.ix_(at, at)] += part.hessian
    alone = (columns >= setup.poses) & (columns < setup.chained)
    own = H[np.ix_(alone, alone)] + np.eye(alone.sum())
    through = H[np.ix_(~alone, alone)] @ inverse(own)
    H_left = H[np.ix_(~alone, ~alone)] - through @ H[np.ix_(alone, ~alone)]
    G_left = G[columns[~alone]] - through @ G[columns[alone]]
    return More(columns[~alone], H_left, G_left)
