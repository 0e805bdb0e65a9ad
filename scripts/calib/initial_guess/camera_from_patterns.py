"""A camera from the patterns that its images show: every image alone tells where it sits."""

from itertools import zip_longest

import numpy as np

from calib.geometry import se3
from calib.initial_guess import bearing_pnp, camera_from_blobs, pose_voting
from calib.initial_guess.frame_sampling import readable
from calib.initial_guess.pose_guess import Found
from calib.sensors.camera.images import image_messages

RIVAL = 4.0  # a reading that reprojects this much worse than the best of its image is out
MISFIT = 0.1  # of the corners' spacing: a reading that reprojects worse is none of this pattern


def find(camera, shapes, looks, content_of, options):
    """Found: by printed patterns; by coloured bodies where they show too little."""
    patterned = [[k for k in looks if k.target == n] for n in sorted(shapes) if shapes[n].pattern]
    readings, seen = [], 0
    # In turn over the targets, until enough is found.
    in_turn = (k for turn in zip_longest(*patterned) for k in turn if k is not None)
    for look, image in readable(in_turn, content_of):
        found = read(camera, shapes[look.target], image)
        readings += [(look.placement, look.T_robot_target @ se3.inverse(T)) for T in found]
        seen += bool(found)
        if seen >= options["enough_images"]:
            break
    by_pattern = agreed(readings, seen, sum(map(len, patterned)), options)
    if by_pattern.status.ok or not any(shapes[k.target].color for k in looks):
        return by_pattern
    by_color = camera_from_blobs.find(camera, shapes, looks, content_of, options)
    return by_color if by_color.status.ok or not seen else by_pattern


def read(camera, target, image):
    """[T_camera_target (4, 4)]: every reading of the target's pattern in an image (h, w, 3)."""
    uv = target.pattern.detect(image_messages.grey(image))
    return [] if uv is None else poses(camera, target, uv)


def poses(camera, target, uv):
    """[T_camera_target (4, 4)] of corners uv (n, 2) in the detector's order, as it may be read.

    Every labelling and both solutions of a plane are tried; what shows the target from where it
    cannot be seen, or reprojects much worse than another, is left out.
    """
    corners = target.pattern.corners()
    rays, ok = camera.unproject(uv)
    if not ok.all():
        return []
    found = []
    for labels in target.pattern.labellings():
        for T in bearing_pnp.of_plane(rays, corners[labels]):
            again, valid = camera.project(se3.transform(T, corners[labels]))
            if valid.all() and target.faces(se3.inverse(T)[:3, 3])[0]:
                found.append((np.sqrt(((again - uv) ** 2).sum(1).mean()), T))
    spacing = np.sort(np.linalg.norm(uv[:, None] - uv[None], axis=-1), axis=1)[:, 1].mean()
    best = min((misfit for misfit, _ in found), default=np.inf)
    most = min(MISFIT * spacing, RIVAL * best + 0.1)
    return [T for misfit, T in found if misfit <= most]


def agreed(readings, seen, looked, options):
    """Found: the mean of the readings, one per placement, that agree."""
    group = np.array([g for g, _ in readings], int)
    T = np.reshape([T for _, T in readings], (-1, 4, 4))
    tolerance = pose_voting.tolerance(options)
    rows, rival = pose_voting.agreeing(T, group, tolerance) if len(T) else (group, 0)
    least = options["min_placements"]
    if len(rows) < least or not pose_voting.decided(len(rows), rival):
        return Found(status=pose_voting.refused("pattern", len(rows), rival, seen, looked, least))
    mean, xi = se3.mean(T[rows])
    sigma = np.maximum(
        np.sqrt((xi**2).sum(0) / (len(xi) - 1) / len(xi)), pose_voting.floor(options)
    )
    basis = f"the pattern in {len(rows)} of {seen} images that show one, {looked} placements"
    return Found(mean, sigma, basis + f", agree to {pose_voting.scatter(xi)}")
