"""Sensors, bodies and noise in SI units, from the config slices that a job receives."""

from dataclasses import dataclass

import numpy as np

from calib import geometry
from calib.cameras import Camera
from calib.status import InputError

TYPED = 0.02  # what rounding to two decimals does to a rotation that is typed in


def pose(config):
    """T (4, 4) of a pose block: matrix, or xyz_m with rpy_deg or quat_xyzw.

    Raises InputError where that is no rigid motion; rounding is made good.
    """
    if "matrix" in config:
        return _rigid(np.asarray(config["matrix"], float))
    if "quat_xyzw" in config:
        norm = np.linalg.norm(config["quat_xyzw"])
        if not abs(norm - 1) < TYPED:
            raise InputError(f"quat_xyzw has norm {norm:.4g}, expected 1; write x, y, z, w")
        return geometry.from_xyz_quat(config["xyz_m"], config["quat_xyzw"])
    return geometry.from_rpy(config["xyz_m"], np.radians(config["rpy_deg"]))


def _rigid(T):
    """T (4, 4) with the rotation nearest to its own."""
    R = T[:3, :3]
    off = np.abs(R.T @ R - np.eye(3)).max()
    if not (off < TYPED and np.linalg.det(R) > 0 and np.abs(T[3] - [0, 0, 0, 1]).max() < 1e-6):
        raise InputError(
            f"matrix is no rigid motion: determinant {np.linalg.det(R):.4g}, expected 1; its "
            f"axes are off by {off:.2g} from unit and square, its last row is {T[3].tolist()}; "
            "write rows, m, or give xyz_m with quat_xyzw"
        )
    return geometry.from_xyz_quat(T[:3, 3], geometry.to_quat(T))


def pose_sigma(config):
    """(6,) standard deviations of a twist, m and rad, of a block {xyz_m, rpy_deg}."""
    return np.repeat([config["xyz_m"], np.radians(config["rpy_deg"])], 3)


def pose_json(T):
    """{xyz_m, quat_xyzw, matrix} of T (4, 4), as calibration.json states poses."""
    return {
        "xyz_m": T[:3, 3].tolist(),
        "quat_xyzw": geometry.to_quat(T).tolist(),
        "matrix": T.tolist(),
    }


@dataclass(frozen=True)
class Lidar:
    """Steps and limits of the scan pattern, rad; range limits and starting noise, m.

    What its beams may do to its data, as far as it was estimated: range_bias, m, by which all
    ranges are too long, and range_offsets, those of ring 0, 1, … beside it; beam_width (m, rad):
    outlines are seen wider all round by the first, and by the second times the range. The sigmas
    are those of their priors: of one beam's range and of a width, m. apart (6,): twist from
    where the lidar is to where the outlines in its scans put it.
    """

    azimuth_step: float
    elevation_step: float
    azimuth: tuple | None
    elevation: tuple | None
    range: tuple
    range_sigma: float
    beam_range_sigma: float = 0.02
    beam_width_sigma: float = 0.01
    range_bias: float = 0.0
    range_offsets: tuple = ()
    beam_width: tuple = (0.0, 0.0)
    apart: tuple = (0.0,) * 6

    def mended(self, xyz, ring):
        """Returns xyz (n, 3) of rings (n,), sensor frame, where they should be."""
        if self.range_bias or self.range_offsets:
            offsets = np.append(self.range_offsets, 0.0)
            known = (ring >= 0) & (ring < len(self.range_offsets))
            longer = self.range_bias + offsets[np.where(known, ring, -1)]
            xyz = xyz * (1 - longer / np.linalg.norm(xyz, axis=1))[:, None]
        return xyz

    def aimed(self, ray, ranges):
        """Where unit rays (n, 3), sensor frame, that meet something at ranges (n,) should point."""
        if not any(self.apart):
            return ray
        there = geometry.transform(geometry.se3_exp(np.array(self.apart)), ray * ranges[:, None])
        return there / np.linalg.norm(there, axis=1)[:, None]

    def widening(self, ranges):
        """Angle (n,), rad, by which an outline at ranges (n,), m, is seen outside of itself."""
        width, divergence = self.beam_width
        return width / ranges + divergence

    @classmethod
    def from_config(cls, config):
        """The Lidar of a sensor block; angles converted to rad."""
        limits = {
            k: tuple(np.radians(config[f"{k}_deg"])) if f"{k}_deg" in config else None
            for k in ("azimuth", "elevation")
        }
        return cls(
            azimuth_step=np.radians(config["azimuth_step_deg"]),
            elevation_step=np.radians(config["elevation_step_deg"]),
            range=tuple(config["range_m"]),
            range_sigma=config["range_sigma_m"],
            beam_range_sigma=config["beam_range_sigma_m"],
            beam_width_sigma=config["beam_width_sigma_m"],
            **limits,
        )


def camera(config):
    """The Camera of a sensor block; raises InputError for a wrong number of params."""
    try:
        return Camera(config["model"], tuple(config["params"]), tuple(config["size_px"]))
    except ValueError as error:
        raise InputError(str(error)) from None


def heard(config, found):
    """A sensor block completed by what its log tells: lens (`camera`) and `layout` of clouds of
    found, which is its part of the audit or, for the lens alone, its guess.json."""
    layout = {"layout": found["layout"]} if "layout" in found else {}
    return config | (found.get("camera") or {}) | layout


SENSORS = {"camera": camera, "lidar": Lidar.from_config}


def model(config):
    """The Camera or Lidar of a sensor block."""
    return SENSORS[config["kind"]](config)
