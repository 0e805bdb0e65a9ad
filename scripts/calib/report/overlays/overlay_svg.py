"""SVG elements of overlays on images: the image, lines, crosses, circles and dots."""

import base64
import html
from typing import Any, NamedTuple

import cv2
import numpy as np

MAX_IMAGE_WIDTH_PX = 640  # wider images are reduced
JPEG_OPTIONS = [cv2.IMWRITE_JPEG_QUALITY, 82]


class ImageBox(NamedTuple):
    """Part of an image, px: first pixel, and the pixel after the last."""

    u0: int
    v0: int
    u1: int
    v1: int

    @property
    def width(self) -> int:
        """Width, px."""
        return self.u1 - self.u0

    @property
    def height(self) -> int:
        """Height, px."""
        return self.v1 - self.v0


def fit_image_box(
    image_shape: tuple[int, ...], view: dict[str, Any], marks: list[np.ndarray]
) -> ImageBox:
    """Return the part of the window of a view that contains the marks, with a margin.

    image_shape: of the window; view: row of views.parquet with its first pixel u0, v0; marks:
    pixels (n, 2) each; without any, the whole window.
    """
    low = np.array([view["u0"], view["v0"]])
    high = low + [image_shape[1], image_shape[0]]
    marks = [m for m in marks if len(m)]
    if not marks:
        return ImageBox(*low.tolist(), *high.tolist())
    points = np.clip(np.concatenate(marks), low, high)
    margin = 0.08 * np.ptp(points, axis=0).max() + 8
    first = np.maximum(np.floor(points.min(0) - margin), low).astype(int)
    end = np.minimum(np.ceil(points.max(0) + margin), high).astype(int)
    return ImageBox(*first.tolist(), *end.tolist())


def render_svg_image(
    image: np.ndarray, view: dict[str, Any], box: ImageBox, marks: str, label: str
) -> str:
    """Render part of the window of a view with marks, in pixels of the whole image."""
    u0, v0, width, height = box.u0, box.v0, box.width, box.height
    part = image[v0 - view["v0"] : box.v1 - view["v0"], u0 - view["u0"] : box.u1 - view["u0"]]
    if width > MAX_IMAGE_WIDTH_PX:
        size = MAX_IMAGE_WIDTH_PX, max(1, round(height * MAX_IMAGE_WIDTH_PX / width))
        part = cv2.resize(part, size, interpolation=cv2.INTER_AREA)
    data = base64.b64encode(cv2.imencode(".jpg", part, JPEG_OPTIONS)[1].tobytes()).decode()
    position = f'x="{u0 - 0.5}" y="{v0 - 0.5}" width="{width}" height="{height}"'
    view_box = f'viewBox="{u0 - 0.5} {v0 - 0.5} {width} {height}"'
    return (
        f'<svg class="photo" role="img" aria-label="{html.escape(label)}" {view_box}>'
        f'<image {position} preserveAspectRatio="none" href="data:image/jpeg;base64,{data}"/>'
        f"{marks}</svg>"
    )


def svg_path(points: np.ndarray, is_closed: bool = False) -> str:
    """Return the path data of a line through points (n, 2)."""
    body = "L".join(f"{u:.2f} {v:.2f}" for u, v in points)
    return f"M{body}{'Z' if is_closed else ''}" if len(points) else ""


def svg_crosses(points: np.ndarray, radius: float, is_diagonal: bool) -> str:
    """Return the path data of a cross at each point (n, 2): + or ×."""
    strokes = ((1, 1), (1, -1)) if is_diagonal else ((1, 0), (0, 1))
    a, b = radius * np.array(strokes)
    return "".join(
        svg_path(np.array([p - a, p + a])) + svg_path(np.array([p - b, p + b])) for p in points
    )


def svg_circles(points: np.ndarray, radius: float) -> str:
    """Return the path data of a circle at each point (n, 2); one path prints faster than many."""
    r = f"{radius:.2f}"
    half = f"a{r} {r} 0 1 0"
    ring = f"{half} {2 * radius:.2f} 0{half} {-2 * radius:.2f} 0"
    return "".join(f"M{u - radius:.2f} {v:.2f}{ring}" for u, v in points)


def render_svg_line(path: str, color: str, width: float, dash: str = "") -> str:
    """Render path data as a line; dash: lengths, px."""
    if not path:
        return ""
    dashes = f' stroke-dasharray="{dash}"' if dash else ""
    style = f'fill="none" stroke="{color}" stroke-width="{width:.2f}"{dashes}'
    return f'<path {style} d="{path}"/>'


def render_svg_dots(points: np.ndarray, color: str, diameter: float, decimals: int = 2) -> str:
    """Render points (n, 2) as dots in one path."""
    path = "".join(f"M{u:.{decimals}f} {v:.{decimals}f}h.01" for u, v in points)
    line = render_svg_line(path, color, diameter)
    return line.replace("<path ", '<path stroke-linecap="round" ')
