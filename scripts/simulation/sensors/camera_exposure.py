"""From rendered images to those of a camera: motion, blur, noise, rounding, compression."""

import cv2
import numpy as np

from calib.geometry.units import NS_PER_S
from simulation.sensors.image_renderer import FINE_POINTS_PER_PIXEL
from simulation.world.smooth_motion import find_motion_progress

BGR_TO_GREY = np.array([0.114, 0.587, 0.299])  # of B, G, R
N_EXPOSURE_INSTANTS = 8  # whose mean is an image in motion
MOVING_POINTS_PER_PIXEL = 8  # per pixel at targets in motion, where no corner is read
COMPRESSION_OPTIONS = {
    "jpeg": [cv2.IMWRITE_JPEG_QUALITY, 95],
    "png": [cv2.IMWRITE_PNG_COMPRESSION, 1],
}


def sample_exposure_times(t, exposure_s, placement_times_ns):
    """Times (n,), ns, whose mean is the image stamped t, the middle of the exposure; only t where
    everything rests throughout."""
    offsets = (np.arange(N_EXPOSURE_INSTANTS) + 0.5) / N_EXPOSURE_INSTANTS - 0.5
    all_of_them = t + np.round(offsets * exposure_s * NS_PER_S).astype(np.int64)
    moving = find_motion_progress(all_of_them, placement_times_ns)[1] > 0
    return all_of_them if exposure_s and moving.any() else np.array([t])


class Shutter:
    """Unrounded images (height, width, 3) at any time; that of a placement is rendered once.

    image_at(t, points) renders the instant t, ns, with so many points per pixel at targets.
    """

    def __init__(self, render_at, placement_times_ns, exposure_s, blur_px):
        self.render_at, self.placement_times_ns = render_at, placement_times_ns
        self.exposure_s, self.blur_px = exposure_s, blur_px
        self.still_image = (-1, None)

    def capture_image(self, t):
        """The image stamped t, ns."""
        when = sample_exposure_times(t, self.exposure_s, self.placement_times_ns)
        k, way = find_motion_progress(when, self.placement_times_ns)
        if way.any():
            images = (self.render_at(t, MOVING_POINTS_PER_PIXEL) for t in when)
            return blur_image(sum(images) / len(when), self.blur_px)
        if self.still_image[0] != k[0]:
            exact = self.render_at(t, FINE_POINTS_PER_PIXEL)
            self.still_image = (k[0], blur_image(exact, self.blur_px))
        return self.still_image[1]


def blur_image(image, sigma_px):
    """Image (height, width, 3) after a Gaussian blur."""
    if not sigma_px:
        return image
    reach = 2 * int(np.ceil(4 * sigma_px)) + 1
    return cv2.GaussianBlur(image, (reach, reach), sigma_px, borderType=cv2.BORDER_REFLECT)


def digitize_image(image, encoding, noise_sigma, rng):
    """Image (height, width[, 3]) uint8 of an unrounded one: Gaussian noise per channel, rounded.

    It is blue green red, or grey where the encoding is.
    """
    image = (image @ BGR_TO_GREY if encoding.startswith("mono") else image).astype(np.float32)
    if noise_sigma:
        drawn = rng.standard_normal(image.shape, np.float32)
        image += np.multiply(drawn, np.float32(noise_sigma), out=drawn)
    return np.clip(np.rint(image, out=image), 0, 255, out=image).astype(np.uint8)


def _bayer_mosaic(pixels, pattern):
    """What the pixels of a Bayer mosaic see: pattern names the first four, row by row."""
    out = np.empty(pixels.shape[:2], np.uint8)
    for i, color in enumerate(pattern):
        at = np.s_[i // 2 :: 2, i % 2 :: 2]
        out[at] = pixels[(*at, "bgr".index(color))]
    return out


# What an Image of that encoding holds of pixels as `expose` makes them.
IMAGE_ENCODERS = {
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


def compress_image(pixels, encoding):
    """JPEG or PNG bytes of an image (height, width, 3) uint8."""
    return cv2.imencode(f".{encoding}", pixels, COMPRESSION_OPTIONS[encoding])[1].reshape(-1)
