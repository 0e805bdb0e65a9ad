"""What may have moved within a session: a target in its MCS body, or a sensor on the robot."""

import numpy as np

from calib.estimation.corrections.correction import Correction
from calib.estimation.corrections.number_wording import format_twist_sigma
from calib.geometry.se3 import adjoint, invert_pose

TARGET_SLIP, SENSOR_BUMP = SESSION_SHIFT_NAMES = "target_slip", "sensor_bump"
MIN_SHIFT_PLACEMENTS = (
    6  # placements in a session, below which nobody asks whether something moved between them
)
SHIFT_CUT_SHARES = (0.25, 0.5, 0.75)  # of the placements, after which it may have


def make_slip_corrections(setup):
    """A target that sits elsewhere in its MCS body from some placement on: its markers were
    knocked, or it slipped in its holder."""
    exact = {n for n, target in setup.targets.items() if target.uses_exact_surface}
    for (session, name), starts in sorted(_placement_starts(setup, lambda g, p: p.target).items()):
        if name in exact:
            remedy = f"see whether {name} or its markers were knocked then"
            yield from _make_shift_corrections(
                TARGET_SLIP,
                name,
                False,
                session,
                starts,
                _target_twist_derivative,
                "in its MCS body",
                remedy,
            )


def make_bump_corrections(setup):
    """A sensor that sits elsewhere on the robot from some placement on."""
    for (session, name), starts in sorted(_placement_starts(setup, lambda g, p: g.sensor).items()):
        remedy = f"see whether {name} was bumped then"
        yield from _make_shift_corrections(
            SENSOR_BUMP,
            name,
            True,
            session,
            starts,
            _sensor_twist_derivative,
            "on the robot",
            remedy,
        )


def _placement_starts(setup, name_subject):
    """{(session, name): {start, ns, of the still placements}}; of(group, placement) names it."""
    out = {}
    for g in setup.groups:
        place = setup.placements[g.placement]
        if place.moving_view is None:
            out.setdefault((place.session, name_subject(g, place)), set()).add(place.start_ns)
    return out


def _cut_starts(starts):
    """[(start, ns, of the first placement after a cut, its number from 1)]."""
    if len(starts) < MIN_SHIFT_PLACEMENTS:
        return []
    order = sorted(starts)
    return [
        (order[int(share * len(order))], int(share * len(order)) + 1) for share in SHIFT_CUT_SHARES
    ]


def _make_shift_corrections(
    name, subject, on_sensor, session, starts, derivative, place_text, remedy
):
    """Hypotheses of a pose that differs from some of the starts, ns, of a session on."""
    apart = "calibrate what comes before and after as sessions of their own (from_s, to_s)"
    for first, count in _cut_starts(starts):

        def slope(view, first=first):
            place = view.setup.placements[view.group.placement]
            later = place.session == session and place.start_ns >= first
            return derivative(view) if later else np.zeros((6, *view.J_pose.shape[::2]))

        def told(theta, sigma, count=count):
            return (
                f"{subject} sits elsewhere {place_text} from its placement {count} in session {session} on, "
                f"along and about its own x, y, z: by {format_twist_sigma(theta, sigma)}"
            )

        yield Correction(name, subject, on_sensor, (), 6, slope, told, f"{remedy}; {apart}")


def _target_twist_derivative(view):
    return np.swapaxes(view.J_pose, 0, 1)


def _sensor_twist_derivative(view):
    """(6, k, n) by the right perturbation of T_robot_sensor."""
    A = -adjoint(invert_pose(view.T_sensor_target))
    return np.einsum("kin,ij->jkn", view.J_pose, A)
