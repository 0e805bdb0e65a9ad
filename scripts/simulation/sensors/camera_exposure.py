"""Make a camera's images from rendered ones: motion, blur, noise, rounding, compression."""

from collections.abc import Callable

import cv2
import numpy as np

from calib.geometry.units import NS_PER_S
from simulation.sensors.image_renderer import FINE_POINTS_PER_PIXEL
from simulation.world.smooth_motion import find_motion_progress

BGR_TO_GREY = np.array([0.114, 0.587, 0.299])  # of B, G, R
N_EXPOSURE_INSTANTS = 8  # whose mean is an image in motion
MOVING_POINTS_PER_PIXEL = 8  # at targets in motion, where no corner is read
COMPRESSION_OPTIONS = {
    "jpeg": [cv2.IMWRITE_JPEG_QUALITY, 95],
    "png": [cv2.IMWRITE_PNG_COMPRESSION, 1],
}


def sample_exposure_times(t: int, exposure_s: float, placement_times_ns: np.ndarray) -> np.ndarray:
    """Return the times (n,), ns, whose mean is the image stamped t, the middle of the exposure.

    It is t alone if everything rests during the exposure.
    """
    offsets = (np.arange(N_EXPOSURE_INSTANTS) + 0.5) / N_EXPOSURE_INSTANTS - 0.5
    instants = t + np.round(offsets * exposure_s * NS_PER_S).astype(np.int64)
    is_moving = find_motion_progress(instants, placement_times_ns)[1] > 0
    return instants if exposure_s and is_moving.any() else np.array([t])


class Shutter:
    """Takes unrounded images (height, width, 3) at any time; renders each placement once.

    render_at(t, n) renders the instant t, ns, with n points per pixel at targets.
    """

    def __init__(
        self,
        render_at: Callable[[int, int], np.ndarray],
        placement_times_ns: np.ndarray,
        exposure_s: float,
        blur_px: float,
    ) -> None:
        self.render_at, self.placement_times_ns = render_at, placement_times_ns
        self.exposure_s, self.blur_px = exposure_s, blur_px
        self._still_placement = -1
        self._still_image = np.zeros((0, 0, 3))

    def capture_image(self, t: int) -> np.ndarray:
        """Return the image stamped t, ns."""
        instants = sample_exposure_times(t, self.exposure_s, self.placement_times_ns)
        placement, progress = find_motion_progress(instants, self.placement_times_ns)
        if progress.any():
            images = [self.render_at(instant, MOVING_POINTS_PER_PIXEL) for instant in instants]
            return blur_image(np.add.reduce(images) / len(instants), self.blur_px)
        if self._still_placement != placement[0]:
            exact = self.render_at(t, FINE_POINTS_PER_PIXEL)
            self._still_placement = placement[0]
            self._still_image = blur_image(exact, self.blur_px)
        return self._still_image


def blur_image(image: np.ndarray, sigma_px: float) -> np.ndarray:
    """Blur an image (height, width, 3) with a Gaussian."""
    if not sigma_px:
        return image
    reach = 2 * int(np.ceil(4 * sigma_px)) + 1
    return cv2.GaussianBlur(image, (reach, reach), sigma_px, borderType=cv2.BORDER_REFLECT)


def digitize_image(
    image: np.ndarray, encoding: str, noise_sigma: float, rng: np.random.Generator
) -> np.ndarray:
    """Add Gaussian noise per channel to an unrounded image, and round it to uint8.

    Returns (height, width, 3) blue green red, or (height, width) grey for a grey encoding.
    """
    image = (image @ BGR_TO_GREY if encoding.startswith("mono") else image).astype(np.float32)
    if noise_sigma:
        drawn = rng.standard_normal(image.shape, np.float32)
        image += np.multiply(drawn, np.float32(noise_sigma), out=drawn)
    return np.clip(np.rint(image, out=image), 0, 255, out=image).astype(np.uint8)


def _bayer_mosaic(pixels: np.ndarray, pattern: str) -> np.ndarray:
    """Return what a Bayer mosaic sees (height, width); pattern: its first four pixels by row."""
    out = np.empty(pixels.shape[:2], np.uint8)
    for i, color in enumerate(pattern):
        rows, columns = slice(i // 2, None, 2), slice(i % 2, None, 2)
        out[rows, columns] = pixels[rows, columns, "bgr".index(color)]
    return out


# What an Image of that encoding holds of pixels as digitize_image makes them.
IMAGE_ENCODERS: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "bgr8": lambda p: p,
    "mono8": lambda p: p,
    "mono16": lambda p: p.astype("<u2") * 257,
    "rgb8": lambda p: p[..., ::-1],
    "rgb16": lambda p: p[..., ::-1].astype("<u2") * 257,
    "bgra8": lambda p: cv2.cvtColor(p, cv2.COLOR_BGR2BGRA),
    "rgba8": lambda p: cv2.cvtColor(p, cv2.COLOR_BGR2RGBA),
    "bayer_rggb8": lambda p: _bayer_mosaic(p, "rggb"),
    "bayer_bggr8": lambda p: _bayer_mosaic(p, "bggr"),
    "bayer_gbrg8": lambda p: _bayer_mosaic(p, "gbrg"),
    "bayer_grbg8": lambda p: _bayer_mosaic(p, "grbg"),
    "yuv422": lambda p: cv2.cvtColor(p, cv2.COLOR_BGR2YUV_UYVY),
    "yuv422_yuy2": lambda p: cv2.cvtColor(p, cv2.COLOR_BGR2YUV_YUY2),
}


def compress_image(pixels: np.ndarray, encoding: str) -> np.ndarray:
    """Compress an image (height, width, 3) uint8 to the bytes (n,) of a JPEG or PNG file."""
    return cv2.imencode(f".{encoding}", pixels, COMPRESSION_OPTIONS[encoding])[1].reshape(-1)
