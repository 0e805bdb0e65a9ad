"""A flat board: its face is z = 0 of its frame, seen from +z; an outline, maybe a pattern."""

from dataclasses import dataclass

import numpy as np

from calib.geometry.polygon import sample_polygon_outline, signed_polygon_distance
from calib.targets.patterns.pattern_registry import pattern_from_config

BOARD_GRAZING_COSINE = (
    1e-4  # cosine of incidence below which a beam is taken to run along the plane
)


@dataclass(frozen=True)
class Board:
    """vertices (n, 2), m, of the outline, and whether that is stated; thickness, m; pattern or
    None; points or None."""

    vertices: np.ndarray
    thickness: float
    pattern: object
    point_template: object = None
    has_config_outline: bool = True

    name = "board"
    color = None
    symmetry_axes = ()

    @classmethod
    def from_config(cls, config):
        pattern = pattern_from_config(config["pattern"]) if config.get("pattern") else None
        stated = "outline_m" in config
        vertices = np.asarray(config["outline_m"], float) if stated else pattern.outline
        return cls(vertices, config["thickness_m"], pattern, has_config_outline=stated)

    @property
    def uses_exact_surface(self) -> bool:
        """Whether measurements are compared with the exact surface, not with template points."""
        return self.point_template is None

    @property
    def centre(self):
        return np.append((self.vertices.min(0) + self.vertices.max(0)) / 2, 0.0)

    @property
    def bounding_radius(self):
        return np.linalg.norm(self.vertices - self.centre[:2], axis=1).max()

    @property
    def extents(self):
        """Largest width and the width across it."""
        spread = self.vertices[:, None] - self.vertices[None]
        far = np.unravel_index(np.linalg.norm(spread, axis=-1).argmax(), spread.shape[:2])
        across = np.array([[0, -1], [1, 0]]) @ spread[far] / np.linalg.norm(spread[far])
        return np.array([np.linalg.norm(spread[far]), np.ptp(self.vertices @ across)])

    @property
    def area(self):
        x, y = self.vertices.T
        return abs(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y)) / 2

    def outline_points(self):
        return np.column_stack([self.vertices, np.zeros(len(self.vertices))])

    def surface_distance(self, x, y, z):
        return z

    def distance_along_beam(self, points, beam):
        # Smoothly held away from zero, for beams along the plane.
        return points[2] * -beam[2] / (beam[2] * beam[2] + BOARD_GRAZING_COSINE**2), -beam[2]

    def distance_inside_rim(self, points):
        return -signed_polygon_distance(self.vertices, points[:, :2])

    def is_near_cap(self, points, reach):
        return np.zeros(len(points), bool)

    def check_facing(self, sensor_position):
        direction = sensor_position - self.centre
        cosine = direction[2] / np.linalg.norm(direction)
        return cosine > 0, cosine

    def required_image_points(self):
        return np.zeros((0, 3)) if self.pattern is None else self.pattern.corners()

    def sample_surface(self, spacing):
        """A grid over the face, and the outline itself, so that it ends where the board does."""
        low, high = self.vertices.min(0), self.vertices.max(0)
        x, y = (np.arange(a, b, spacing) for a, b in zip(low, high, strict=True))
        grid = np.stack(np.meshgrid(x, y), -1).reshape(-1, 2)
        inside = grid[signed_polygon_distance(self.vertices, grid) < -spacing / 2]
        flat = np.concatenate([inside, sample_polygon_outline(self.vertices, spacing)])
        return np.column_stack([flat, np.zeros(len(flat))])

    def outline_edges(self):
        if not self.has_config_outline:
            return np.zeros((0, 2, 3))
        a = self.outline_points()
        return np.stack([a, np.roll(a, -1, 0)], 1)

    def fit_inliers(self, points, T_sensor_target, margin, lidar, options):
        """Indices of the points (n, 3) of one cluster on the plane that holds most of them.

        Planes through three points drawn at random compete; one that leans farther from the
        expected normal than the guess may be wrong is no candidate.
        """
        normal = T_sensor_target[:3, 2]
        lean = np.cos(min(np.linalg.norm(margin[3:]), np.pi / 2))
        near = 3 * lidar.range_sigma
        rng = np.random.default_rng(options["seed"])
        best = _ransac_plane(points, normal, lean, near, rng)
        for _ in range(5):
            if len(best) < 3:
                return best
            centre = points[best].mean(0)
            axis = np.linalg.svd(points[best] - centre, full_matrices=False)[2][2]
            if abs(axis @ normal) < lean:
                return best[:0]
            inside = np.linalg.norm(points - centre, axis=1) < 1.2 * self.bounding_radius + near
            best = np.flatnonzero((np.abs((points - centre) @ axis) < near) & inside)
        return best


def _ransac_plane(points, normal, lean, near, rng, draws=300):
    """Indices of the points within near, m, of the best of `draws` planes through three points."""
    triples = points[rng.integers(0, len(points), (draws, 3))]
    n = np.cross(triples[:, 1] - triples[:, 0], triples[:, 2] - triples[:, 0])
    length = np.linalg.norm(n, axis=1)
    n /= np.maximum(length, 1e-12)[:, None]
    offset = np.sum(n * triples[:, 0], 1)
    inliers = np.abs(points @ n.T - offset) < near
    valid = (length > 1e-6) & (np.abs(n @ normal) > lean)
    votes = np.where(valid, inliers.sum(0), 0)
    winner = votes.argmax()
    return np.flatnonzero(inliers[:, winner]) if votes[winner] else np.zeros(0, int)
