"""From rendered images to those of a camera: motion, blur, noise, rounding, compression."""

import cv2
import numpy as np

from simulation.sensors import render_image
from simulation.world import smooth_motion

GREY = np.array([0.114, 0.587, 0.299])  # of B, G, R
INSTANTS = 8  # whose mean is an image in motion
MOVING_POINTS = 8  # per pixel at targets in motion, where no corner is read
QUALITY = {"jpeg": [cv2.IMWRITE_JPEG_QUALITY, 95], "png": [cv2.IMWRITE_PNG_COMPRESSION, 1]}


def instants(t, exposure_s, times):
    """Times (n,), ns, whose mean is the image stamped t, the middle of the exposure; only t where
    everything rests throughout."""
    offsets = (np.arange(INSTANTS) + 0.5) / INSTANTS - 0.5
    all_of_them = t + np.round(offsets * exposure_s * 1e9).astype(np.int64)
    moving = smooth_motion.blend(all_of_them, times)[1] > 0
    return all_of_them if exposure_s and moving.any() else np.array([t])


class Shutter:
    """Unrounded images (height, width, 3) at any time; that of a placement is rendered once.

    image_at(t, points) renders the instant t, ns, with so many points per pixel at targets.
    """

    def __init__(self, image_at, times, exposure_s, blur_px):
        self.image_at, self.times = image_at, times
        self.exposure_s, self.blur_px = exposure_s, blur_px
        self.at_rest = (-1, None)

    def open(self, t):
        """The image stamped t, ns."""
        when = instants(t, self.exposure_s, self.times)
        k, way = smooth_motion.blend(when, self.times)
        if way.any():
            images = (self.image_at(t, MOVING_POINTS) for t in when)
            return blurred(sum(images) / len(when), self.blur_px)
        if self.at_rest[0] != k[0]:
            exact = self.image_at(t, render_image.FINE)
            self.at_rest = (k[0], blurred(exact, self.blur_px))
        return self.at_rest[1]


def blurred(image, sigma_px):
    """Image (height, width, 3) after a Gaussian blur."""
    if not sigma_px:
        return image
    reach = 2 * int(np.ceil(4 * sigma_px)) + 1
    return cv2.GaussianBlur(image, (reach, reach), sigma_px, borderType=cv2.BORDER_REFLECT)


def expose(image, encoding, noise, rng):
    """Image (height, width[, 3]) uint8 of an unrounded one: Gaussian noise per channel, rounded.

    It is blue green red, or grey where the encoding is.
    """
    image = (image @ GREY if encoding.startswith("mono") else image).astype(np.float32)
    if noise:
        drawn = rng.standard_normal(image.shape, np.float32)
        image += np.multiply(drawn, np.float32(noise), out=drawn)
    return np.clip(np.rint(image, out=image), 0, 255, out=image).astype(np.uint8)


def _mosaic(pixels, pattern):
    """What the pixels of a Bayer mosaic see: pattern names the first four, row by row."""
    out = np.empty(pixels.shape[:2], np.uint8)
    for i, color in enumerate(pattern):
        at = np.s_[i // 2 :: 2, i % 2 :: 2]
        out[at] = pixels[(*at, "bgr".index(color))]
    return out


# What an Image of that encoding holds of pixels as `expose` makes them.
ENCODINGS = {
    "bgr8": lambda p: p,
    "mono8": lambda p: p,
    "mono16": lambda p: p.astype("<u2") * 257,
    "rgb8": lambda p: p[..., ::-1],
    "rgb16": lambda p: p[..., ::-1].astype("<u2") * 257,
    "bgra8": lambda p: cv2.cvtColor(p, cv2.COLOR_BGR2BGRA),
    "rgba8": lambda p: cv2.cvtColor(p, cv2.COLOR_BGR2RGBA),
    "bayer_rggb8": lambda p: _mosaic(p, "rggb"),
    "bayer_bggr8": lambda p: _mosaic(p, "bggr"),
    "bayer_gbrg8": lambda p: _mosaic(p, "gbrg"),
    "bayer_grbg8": lambda p: _mosaic(p, "grbg"),
    "yuv422": lambda p: cv2.cvtColor(p, cv2.COLOR_BGR2YUV_UYVY),
    "yuv422_yuy2": lambda p: cv2.cvtColor(p, cv2.COLOR_BGR2YUV_YUY2),
}


def compress(pixels, encoding):
    """JPEG or PNG bytes of an image (height, width, 3) uint8."""
    return cv2.imencode(f".{encoding}", pixels, QUALITY[encoding])[1].reshape(-1)
