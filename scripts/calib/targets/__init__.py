"""Target shapes.

A shape is one module with a frozen dataclass that has
  from_config(config)   from config/targets/<name>.yaml;
  reach                 m, radius of the ball around `centre` that holds it;
  centre (3,), size (k,)   its middle, m, target frame, and its extents, m, largest first;
  area                  m², seen face on;
  outline_points()      (n, 3), m: what must be inside an image for the target to be in view;
  distance(x, y, z)     signed distance to the surface, m; one source for arrays and CasADi;
  normal(q)             (n, 3) outward unit normals at q (n, 3);
  depth(q)              (n,) how far, m, q (n, 3) lies inside the rim of the surface, at any
                        distance from it; negative beyond;
  faces(p)              whether a sensor at p (3,) sees it, and its cosine of incidence;
  edges()               (m, 2, 3) straight outline edges that a scan line can leave it by, or empty.
  fit(points, T_sensor_target, margin, lidar, options)   indices of the returns (n, 3) of one
                        cluster that the shape explains, near where it may be.

To add a shape: write calib/targets/<name>.py and add it to SHAPES.
"""

from calib.targets import board, cylinder

SHAPES = {"board": board.Board, "cylinder": cylinder.Cylinder}


def from_config(config):
    """The target of one config/targets/*.yaml."""
    return SHAPES[config["shape"]].from_config(config)
