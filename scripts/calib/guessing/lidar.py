"""A lidar from what moved as the targets did.

In each scan everything of a target's shape and size is a candidate for it, with its centre and, by
the returns' flatness or length, its direction. Two placements with a candidate each give a pose of
the lidar if distance and directions between the candidates are those between the targets; the pose
at which most placements have a candidate where the target was wins. What stood still or moved
otherwise agrees with no more than a few by chance.
"""

from calib.guessing import candidates, pairing
from calib.guessing.looks import readable


def find(lidar, shapes, looks, content_of, options):
    """Found: the pose at which most placements have a candidate where the target was."""
    forms = {n: candidates.Form.of(s) for n, s in shapes.items()}
    rows = []
    for number, (look, (xyz, _, _)) in enumerate(readable(looks, content_of)):
        points = candidates.thinned(lidar, xyz.astype(float))
        form, target = forms[look.target], shapes[look.target]
        for seen in candidates.find(lidar, target, form, points, options):
            rows.append(pairing.pair(*seen, form, look.T_robot_target, number))
    what = "a thing like the target"
    return pairing.matched(pairing.Pairs.of(rows), len(looks), what, options)
