"""A board: its face is z = 0 of its frame, seen from +z; an outline, and maybe a pattern.

A board that is not flat has a face of second order, as in mrcal: over coordinates x and y that are
-1 and 1 at the ends of its outline,
    z = bow_x (1 - x²) + bow_y (1 - y²) + twist x y.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from calib.geometry.numpy_or_casadi import ArrayOrExpression
from calib.geometry.polygon import sample_polygon_outline, signed_polygon_distance
from calib.geometry.ransac_plane import largest_plane_inliers
from calib.targets.patterns.pattern_registry import TargetPattern, pattern_from_config
from calib.targets.point_template import PointTemplate

BOARD_GRAZING_COSINE = 1e-4  # below this cosine of incidence a beam counts as along the plane
INLIER_SIGMAS = 3  # distance of a return on the board from its plane
MAX_RADIUS_SHARE = 1.2  # distance of a return on the board from their centroid, bounding radii
N_PLANE_FITS = 5
N_PLANE_DRAWS = 300
N_SPOT_POINTS = 24  # of equal area in the spot of a beam
GOLDEN_ANGLE_RAD = np.pi * (3 - 5**0.5)  # spreads points over a disk


@dataclass(frozen=True)
class Board:
    """A board; see TargetShape for its members.

    vertices: (n, 2) of the outline, m; thickness: m; has_config_outline: whether the config states
    the outline, so that scan lines that leave it can be used; warp: bow_x, bow_y, twist, m;
    flatness: their σ, m, None for a board that is flat; leaves_out_pattern: whether a lidar's
    returns on the pattern are left out.
    """

    vertices: np.ndarray
    thickness: float
    pattern: TargetPattern | None
    point_template: PointTemplate | None = None
    has_config_outline: bool = True
    flatness: float | None = None
    warp: tuple[float, float, float] = (0.0, 0.0, 0.0)
    leaves_out_pattern: bool = False

    name = "board"
    color = None
    symmetry_axes = ()

    @classmethod
    def from_config(cls, config: dict[str, Any]) -> "Board":
        """Make the board of a target's config; without outline_m it ends where its pattern does."""
        pattern = pattern_from_config(config["pattern"]) if config.get("pattern") else None
        outline = config.get("outline_m")
        has_outline = outline is not None or pattern is None
        return cls(
            np.asarray(outline if pattern is None or has_outline else pattern.outline, float),
            config["thickness_m"],
            pattern,
            has_config_outline=has_outline,
            flatness=config.get("flatness_m"),
            leaves_out_pattern=config.get("pattern_returns") == "leave_out",
        )

    @property
    def uses_exact_surface(self) -> bool:
        """Whether measurements are compared with the exact surface, not with template points."""
        return self.point_template is None

    @property
    def centre(self) -> np.ndarray:
        return np.append((self.vertices.min(0) + self.vertices.max(0)) / 2, 0.0)

    @property
    def bounding_radius(self) -> float:
        return np.linalg.norm(self.vertices - self.centre[:2], axis=1).max()

    @property
    def extents(self) -> np.ndarray:
        """Largest width and the width across it (2,), m."""
        differences = self.vertices[:, None] - self.vertices[None]
        lengths = np.linalg.norm(differences, axis=-1)
        longest = differences[np.unravel_index(lengths.argmax(), lengths.shape)]
        across = np.array([[0, -1], [1, 0]]) @ longest / np.linalg.norm(longest)
        return np.array([np.linalg.norm(longest), np.ptp(self.vertices @ across)])

    @property
    def area(self) -> float:
        x, y = self.vertices.T
        return abs(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y)) / 2

    @property
    def half_size(self) -> np.ndarray:
        """Half width and half height (2,), m, of the outline."""
        return np.ptp(self.vertices, axis=0) / 2

    def height(
        self, x: ArrayOrExpression, y: ArrayOrExpression
    ) -> tuple[ArrayOrExpression, ArrayOrExpression, ArrayOrExpression]:
        """Return z of the face, m, and its derivatives by x and y."""
        (a, b), middle, (bow_x, bow_y, twist) = self.half_size, self.centre, self.warp
        u, v = (x - middle[0]) / a, (y - middle[1]) / b
        z = bow_x * (1 - u * u) + bow_y * (1 - v * v) + twist * u * v
        return z, (twist * v - 2 * bow_x * u) / a, (twist * u - 2 * bow_y * v) / b

    def lift(self, points: np.ndarray) -> np.ndarray:
        """Return points (..., 3) of the plane z = 0 where they are on the face."""
        z = self.height(points[..., 0], points[..., 1])[0]
        return np.concatenate([points[..., :2], (points[..., 2] + z)[..., None]], axis=-1)

    def outline_points(self) -> np.ndarray:
        return np.column_stack([self.vertices, np.zeros(len(self.vertices))])

    def surface_distance(
        self, x: ArrayOrExpression, y: ArrayOrExpression, z: ArrayOrExpression
    ) -> ArrayOrExpression:
        return z - self.height(x, y)[0]

    def distance_along_beam(
        self, points: ArrayOrExpression, beam: ArrayOrExpression
    ) -> tuple[ArrayOrExpression, ArrayOrExpression]:
        # To the tangent plane at the return: 1 µm off, 1 cm before a bow of 5 mm.
        z, slope_x, slope_y = self.height(points[0], points[1])
        approach = beam[2] - slope_x * beam[0] - slope_y * beam[1]
        # Smoothly held away from zero, for beams along the plane.
        gap = (points[2] - z) * -approach / (approach * approach + BOARD_GRAZING_COSINE**2)
        return gap, -approach / (1 + slope_x * slope_x + slope_y * slope_y) ** 0.5

    def distance_inside_rim(self, points: np.ndarray) -> np.ndarray:
        return -signed_polygon_distance(self.vertices, points[:, :2])

    def pattern_darkness(self, points: np.ndarray, spot_radius: np.ndarray) -> np.ndarray:
        """Return how dark (n, q) the pattern is in the mean over spots at points (n, 3).

        spot_radius: (n,) of the spots of the beams, m; q: see TargetPattern.darkness.
        """
        assert self.pattern is not None
        number = np.arange(N_SPOT_POINTS) + 0.5
        share, angle = np.sqrt(number / N_SPOT_POINTS), GOLDEN_ANGLE_RAD * number
        offsets = share[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
        xy = points[:, None, :2] + spot_radius[:, None, None] * offsets
        dark = self.pattern.darkness(xy.reshape(-1, 2))
        return dark.reshape(*xy.shape[:2], -1).mean(axis=1)

    def is_left_out(self, points: np.ndarray, spot_radius: np.ndarray) -> np.ndarray:
        """Return which returns at points (n, 3), with spots of a radius (n,), are left out."""
        if self.pattern is None or not self.leaves_out_pattern:
            return np.zeros(len(points), bool)
        return signed_polygon_distance(self.pattern.outline, points[:, :2]) < spot_radius

    def is_near_cap(self, points: np.ndarray, reach: float) -> np.ndarray:
        return np.zeros(len(points), bool)

    def check_facing(self, sensor_position: np.ndarray) -> tuple[bool, float]:
        direction = sensor_position - self.centre
        cosine = direction[2] / np.linalg.norm(direction)
        return bool(cosine > 0), float(cosine)

    def required_image_points(self) -> np.ndarray:
        return np.zeros((0, 3)) if self.pattern is None else self.pattern.corners()

    def sample_surface(self, spacing: float) -> np.ndarray:
        """Sample the face on a grid, and its outline, so that the points end with the board."""
        low, high = self.vertices.min(0), self.vertices.max(0)
        x, y = (np.arange(a, b, spacing) for a, b in zip(low, high, strict=True))
        grid = np.stack(np.meshgrid(x, y), -1).reshape(-1, 2)
        inside = grid[signed_polygon_distance(self.vertices, grid) < -spacing / 2]
        flat = np.concatenate([inside, sample_polygon_outline(self.vertices, spacing)])
        return np.column_stack([flat, np.zeros(len(flat))])

    def outline_edges(self) -> np.ndarray:
        if not self.has_config_outline:
            return np.zeros((0, 2, 3))
        a = self.outline_points()
        return np.stack([a, np.roll(a, -1, 0)], 1)

    def edge_tangents(self, edge: np.ndarray, fraction: np.ndarray) -> np.ndarray:
        """Return tangents (k, 2, 3) of the outline at fractions (k,) of edges (k,), by number.

        Each is given by two points that are as far apart as the ends of the edge, which the tangent
        of a flat board joins.
        """
        ends = self.outline_edges()[edge]
        along = ends[:, 1] - ends[:, 0]
        at = self.lift(ends[:, 0] + fraction[:, None] * along)
        _, slope_x, slope_y = self.height(at[:, 0], at[:, 1])
        along[:, 2] = slope_x * along[:, 0] + slope_y * along[:, 1]
        start = at - fraction[:, None] * along
        return np.stack([start, start + along], 1)

    def fit_inliers(
        self,
        points: np.ndarray,
        T_sensor_target: np.ndarray,
        margin: np.ndarray,
        *,
        range_sigma: float,
        seed: int,
    ) -> np.ndarray:
        """Return the indices of the points on the plane that holds most of them.

        The plane is found by random sampling and fitted again to its own points. A plane that leans
        away from the expected normal by more than the margin is not used.
        """
        normal = T_sensor_target[:3, 2]
        min_cosine = np.cos(min(float(np.linalg.norm(margin[3:])), np.pi / 2))
        tolerance = INLIER_SIGMAS * range_sigma
        is_on_plane = largest_plane_inliers(
            points,
            tolerance,
            np.random.default_rng(seed),
            n_draws=N_PLANE_DRAWS,
            normal=normal,
            min_cosine=min_cosine,
        )
        inliers = np.flatnonzero(is_on_plane)
        for _ in range(N_PLANE_FITS):
            if len(inliers) < 3:
                return inliers
            centroid = points[inliers].mean(0)
            axis = np.linalg.svd(points[inliers] - centroid, full_matrices=False)[2][2]
            if abs(axis @ normal) < min_cosine:
                return inliers[:0]
            offset = points - centroid
            reach = MAX_RADIUS_SHARE * self.bounding_radius + tolerance
            is_inside = np.linalg.norm(offset, axis=1) < reach
            inliers = np.flatnonzero((np.abs(offset @ axis) < tolerance) & is_inside)
        return inliers
