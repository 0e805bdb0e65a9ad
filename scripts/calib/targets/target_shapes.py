"""Target shapes.

A shape is one module with a frozen dataclass that has
  from_config(config)   from config/targets/<name>.yaml;
  turns                 axes of its frame, 0 to 2, that it can be turned about unseen;
  reach                 m, radius of the ball around `centre` that holds it;
  centre (3,), size (k,)   its middle, m, target frame, and its extents, m, largest first;
  area                  m², seen face on;
  outline_points()      (n, 3), m: what must be inside an image for the target to be in view;
  distance(x, y, z)     signed distance to the surface, m; one source for arrays and CasADi;
  gap(q, beam)          of a return q (3) by a unit beam (3): how far, m, it lies before the surface
                        along the beam, and the cosine of incidence; likewise;
  depth(q)              (n,) how far, m, q (n, 3) lies inside the rim of the surface, at any
                        distance from it; negative beyond;
  near_ends(q, reach)   (n,) whether q (n, 3) lies within reach, m, of a flat end (kinds.cap);
  faces(p)              whether a sensor at p (3,) sees it, and its cosine of incidence;
  edges()               (m, 2, 3) straight outline edges that a scan line can leave it by;
  image_points()        (n, 3), m: what of it must be inside an image that is to be used; none
                        where it has nothing that a camera could find;
  pattern, color        what a camera finds it by, or None;
  template(spacing)     (n, 3), m: points all over its surface, so far apart;
  points                targets.points.Points where the target's method is `points`, else None;
  fit(points, T_sensor_target, margin, lidar, options)   indices of the returns (n, 3) of one
                        cluster that the shape explains, near where it may be.
distance, gap, depth and near_ends are not needed of a shape that is only ever compared by points.

To add a shape: write calib/targets/<name>.py and add it to SHAPES.
"""

from dataclasses import replace
from typing import Any

from calib.targets.board import Board
from calib.targets.cylinder import Cylinder
from calib.targets.point_template import point_template_from_config
from calib.targets.template_cloud import TemplateCloud

TARGET_SHAPES = {"board": Board, "cloud": TemplateCloud, "cylinder": Cylinder}


def target_from_config(config):
    """The target of one config/targets/*.yaml."""
    shape = TARGET_SHAPES[config["shape"]].from_config(config)
    if config.get("method", "surface") == "surface":
        return shape
    return replace(shape, point_template=point_template_from_config(config["points"], shape))


def is_compared_by_points(config: dict[str, Any]) -> bool:
    """Return whether a target is compared by the points of a template (method `points`)."""
    return config.get("method", "surface") == "points"
