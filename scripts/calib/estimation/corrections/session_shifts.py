"""What may have moved within a session: a target in its MCS body, or a sensor on the robot."""

import numpy as np

from calib.estimation.corrections.correction import Hypothesis
from calib.estimation.corrections.number_wording import shift
from calib.geometry import se3

SLIPPED, BUMPED = MOVED = "slipped", "bumped"
LEAST = 6  # placements in a session, below which nobody asks whether something moved between them
CUTS = (0.25, 0.5, 0.75)  # of the placements, after which it may have


def slips(setup):
    """A target that sits elsewhere in its MCS body from some placement on: its markers were
    knocked, or it slipped in its holder."""
    exact = {n for n, target in setup.targets.items() if target.points is None}
    for (session, name), starts in sorted(_rests(setup, lambda g, p: p.target).items()):
        if name in exact:
            remedy = f"see whether {name} or its markers were knocked then"
            yield from _since(
                SLIPPED, name, False, session, starts, _of_target, "in its MCS body", remedy
            )


def bumps(setup):
    """A sensor that sits elsewhere on the robot from some placement on."""
    for (session, name), starts in sorted(_rests(setup, lambda g, p: g.sensor).items()):
        remedy = f"see whether {name} was bumped then"
        yield from _since(BUMPED, name, True, session, starts, _of_sensor, "on the robot", remedy)


def _rests(setup, of):
    """{(session, name): {start, ns, of the still placements}}; of(group, placement) names it."""
    out = {}
    for g in setup.groups:
        place = setup.placements[g.placement]
        if place.moving is None:
            out.setdefault((place.session, of(g, place)), set()).add(place.start)
    return out


def _cuts(starts):
    """[(start, ns, of the first placement after a cut, its number from 1)]."""
    if len(starts) < LEAST:
        return []
    order = sorted(starts)
    return [(order[int(share * len(order))], int(share * len(order)) + 1) for share in CUTS]


def _since(name, of, on_sensor, session, starts, derivative, where, remedy):
    """Hypotheses of a pose that differs from some of the starts, ns, of a session on."""
    apart = "calibrate what comes before and after as sessions of their own (from_s, to_s)"
    for first, count in _cuts(starts):

        def slope(view, first=first):
            place = view.setup.placements[view.group.placement]
            later = place.session == session and place.start >= first
            return derivative(view) if later else np.zeros((6, *view.J.shape[::2]))

        def told(theta, sigma, count=count):
            return (
                f"{of} sits elsewhere {where} from its placement {count} in session {session} on, "
                f"along and about its own x, y, z: by {shift(theta, sigma)}"
            )

        yield Hypothesis(name, of, on_sensor, (), 6, slope, told, f"{remedy}; {apart}")


def _of_target(view):
    return np.swapaxes(view.J, 0, 1)


def _of_sensor(view):
    """(6, k, n) by the right perturbation of T_robot_sensor."""
    A = -se3.adjoint(se3.inverse(view.T_sensor_target))
    return np.einsum("kin,ij->jkn", view.J, A)
