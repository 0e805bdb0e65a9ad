"""A cylinder's limbs in images drawn here: shaded, blurred, noisy, before a wall's edge."""

from functools import cache

import cv2
import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from scipy.optimize import least_squares
from scipy.spatial import cKDTree

from calib.geometry.se3 import make_pose, se3_exp, so3_exp, transform_points
from calib.sensors.camera.camera_model import CameraModel
from calib.sensors.camera.cylinder_silhouette import find_color_contour, find_cylinder_silhouette
from calib.sensors.camera.silhouette_edges import refine_outline
from calib.targets.color import Color
from calib.targets.cylinder import Cylinder

GREEN = Color.from_config({"hue_deg": [90, 150], "saturation": [0.3, 1], "value": [0.15, 1]})
TARGET, ROD = Cylinder(0.8, 0.1), Cylinder(0.3, 0.015)
CAMERAS = {
    "pinhole": CameraModel(
        "radtan", (802.3, 801.1, 452.6, 347.9, -0.1, 0.02, 1e-3, -5e-4), (900, 700)
    ),
    "fisheye": CameraModel(
        "kannala_brandt", (620, 621, 448, 352, 0.02, -0.01, 3e-3, 0), (900, 700)
    ),
}
PLACES = ((0.1, 0.05, 1.9), (-0.35, 0.1, 2.0), (0.3, -0.15, 1.8))  # m, camera frame
LEANS = ((10, 20, 80), (0, 35, -20), (0, -30, 130))  # roll, out of the image, in it, deg
LIGHT = np.array([0.75, -0.6, -0.28])  # unit, camera frame: one limb is lit, the other in shadow
PAINT, METAL, WALL, SKIRT = (60, 160, 50), (90, 90, 90), (135, 135, 130), (95, 105, 115)  # BGR


def place(k):
    """T_camera_target (4, 4) of the k-th place."""
    roll, out, turn = np.deg2rad(LEANS[k])
    R = so3_exp([0, 0, turn]) @ so3_exp([0, out, 0]) @ so3_exp([roll, 0, 0])
    return make_pose(R, PLACES[k])


def meet(cylinder, T, d):
    """Distances (n,) along rays d (n, 3) to a closed cylinder, infinite for a miss, and the cosine
    (n,) of LIGHT there."""
    o, d = -T[:3, :3].T @ T[:3, 3], d @ T[:3, :3]
    half, light = cylinder.length / 2, T[:3, :3].T @ LIGHT
    a, b = np.sum(d[:, 1:] ** 2, 1), d[:, 1:] @ o[1:]
    with np.errstate(invalid="ignore"):
        side = (-b - np.sqrt(b * b - a * (o[1:] @ o[1:] - cylinder.radius**2))) / a
    p = o + side[:, None] * d
    on_side = np.abs(p[:, 0]) <= half
    cap = (-np.sign(d[:, 0]) * half - o[0]) / d[:, 0]
    on_cap = np.hypot(*(o + cap[:, None] * d)[:, 1:].T) <= cylinder.radius
    cosine = np.where(on_side, p[:, 1:] @ light[1:] / cylinder.radius, -np.sign(d[:, 0]) * light[0])
    return np.where(on_side, side, np.where(on_cap, cap, np.inf)), np.maximum(cosine, 0)


def colors_of(d, T):
    """Colours (n, 3) seen along rays d (n, 3): cylinder, rod out of its cap at -x, two tones."""
    far = np.where((d @ [0.1, 1, 0.0] > 0.02 * d[:, 2])[:, None], SKIRT, WALL).astype(float)
    rod = T @ make_pose(t=[-TARGET.length / 2 - ROD.length / 2, 0, 0])
    nearest = np.full(len(d), np.inf)
    for cylinder, T_part, paint in ((TARGET, T, PAINT), (ROD, rod, METAL)):
        t, cosine = meet(cylinder, T_part, d)
        near = t < nearest
        far[near] = np.outer(0.45 + 0.55 * cosine[near], paint)
        nearest = np.minimum(t, nearest)
    return far


@cache
def drawn(name, k):
    """Unrounded region (h, w, 3) around the cylinder, and its offset (2,) in the image.

    Pixels beside others of another colour are means over 36 places, drawn one per cell.
    """
    camera, T = CAMERAS[name], place(k)
    outline = camera.project(transform_points(T, TARGET.outline_points()))[0]
    low, high = np.rint(outline.min(0)).astype(int) - 50, np.rint(outline.max(0)).astype(int) + 50
    u, v = np.meshgrid(np.arange(low[0], high[0]), np.arange(low[1], high[1]))
    rays = camera.unproject(np.column_stack([u.ravel(), v.ravel()]))[0]
    region = colors_of(rays, T).reshape(*u.shape, 3)
    lowest, highest = (f(region, np.ones((3, 3))) for f in (cv2.erode, cv2.dilate))
    busy = np.any(highest - lowest > 15, axis=2)
    cells = np.stack(np.meshgrid(np.arange(6), np.arange(6)), -1).reshape(-1, 2)
    places = cells + np.random.default_rng(0).random((busy.sum(), 36, 2))
    uv = np.column_stack([u[busy], v[busy]])[:, None] + places / 6 - 0.5
    seen = colors_of(camera.unproject(uv.reshape(-1, 2))[0], T)
    region[busy] = seen.reshape(-1, 36, 3).mean(1)
    return region, low


def exposed(region, blur=0.7, noise=1.8, seed=0):
    """Image (h, w, 3) uint8 of an unrounded one, with blur, px, and noise, grey levels."""
    if blur:
        region = gaussian_filter(region, (blur, blur, 0))
    region = region + noise * np.random.default_rng(seed).standard_normal(region.shape)
    return np.clip(np.rint(region), 0, 255).astype(np.uint8)


def guess(k):
    """T_camera_target (4, 4) off by 3 cm and 5° per axis."""
    error = make_pose(so3_exp(np.deg2rad([5, -5, 5])), [0.03, -0.03, 0.03])
    return place(k) @ error


def find(name, k, image, offset=None):
    offset = drawn(name, k)[1] if offset is None else offset
    return find_cylinder_silhouette(
        image, offset, GREEN, CAMERAS[name], target=TARGET, T_camera_target=guess(k)
    )


def residuals(found, camera, T):
    """Distance, px, of each limb point's ray from touching the cylinder at T_camera_target, and
    where along its axis, m, it comes nearest; its side must be that which it was given."""

    def gap(uv):
        ray = camera.unproject(uv)[0]
        n = np.cross(axis, ray)
        n /= np.linalg.norm(n, axis=1)[:, None]
        across = np.cross(n, axis)
        along = ray @ axis * (across @ centre) / np.sum(across * ray, 1) - axis @ centre
        return side * (n @ centre) - TARGET.radius, along

    axis, centre, limb = T[:3, 0], T[:3, 3], found.side != 0
    uv, normal, side = found.edges.uv[limb], found.edges.normal[limb], found.side[limb]
    (off, along), (further, _) = gap(uv), gap(uv + normal)
    return off / (further - off), along


@pytest.mark.parametrize("blur", [0.0, 0.7, 1.0])
@pytest.mark.parametrize(("name", "k"), [("pinhole", 0), ("pinhole", 1), ("fisheye", 2)])
def test_limb_rays_touch_the_true_cylinder_within_0_02_px_on_average_and_0_1_px_rms(name, k, blur):
    found, status = find(name, k, exposed(drawn(name, k)[0], blur))
    assert status.ok
    off, _ = residuals(found, CAMERAS[name], place(k))
    assert abs(off.mean()) < 0.02 and np.sqrt(np.mean(off**2)) < 0.1
    for side in (-1, 1):
        assert abs(off[found.side[found.side != 0] == side].mean()) < 0.02
    assert np.count_nonzero(found.edges.is_measured) > 0.9 * len(found.side)


@pytest.mark.parametrize("k", [0, 1, 2])
def test_limb_points_keep_off_caps_and_stand_and_cover_the_rest_of_both_sides(k):
    found, _ = find("pinhole", k, exposed(drawn("pinhole", k)[0]))
    along = residuals(found, CAMERAS["pinhole"], place(k))[1]
    for side in (-1, 1):
        x = along[found.side[found.side != 0] == side]
        assert np.abs(x).max() < TARGET.length / 2
        assert np.ptp(x) > 0.85 * TARGET.length


def test_three_images_place_the_camera_within_0_6_mm_and_0_012_deg_from_a_wrong_guess():
    rays = []
    for k in range(3):
        found, _ = find("pinhole", k, exposed(drawn("pinhole", k)[0]))
        limb = found.side != 0
        rays.append((CAMERAS["pinhole"].unproject(found.edges.uv[limb])[0], found.side[limb], k))

    def gaps(xi):
        out = []
        for ray, side, k in rays:
            T = se3_exp(xi) @ place(k)
            n = np.cross(T[:3, 0], ray)
            out.append(side * (n @ T[:3, 3]) / np.linalg.norm(n, axis=1) - TARGET.radius)
        return np.concatenate(out)

    start = np.concatenate([[0.03, -0.03, 0.03], np.deg2rad([5, -5, 5])])
    xi = least_squares(gaps, start, x_scale="jac", xtol=1e-12, ftol=1e-12).x
    assert np.linalg.norm(se3_exp(xi)[:3, 3]) < 6e-4
    assert np.rad2deg(np.linalg.norm(xi[3:])) < 0.012


@pytest.mark.parametrize("noise", [2.0, 6.0])
def test_the_scatter_of_edge_points_is_what_their_sigma_says_within_a_factor_2(noise):
    region = drawn("fisheye", 2)[0]
    outline = find_color_contour(exposed(region, noise=0), GREEN)
    draws = [refine_outline(exposed(region, noise=noise, seed=s), outline) for s in range(10)]
    settled = np.all([d.is_measured for d in draws], axis=0)
    place = np.array([np.sum(d.uv * d.normal, 1)[settled] for d in draws])
    sigma = np.median([d.sigma[settled] for d in draws])
    assert 0.5 < np.median(place.std(0, ddof=1)) / sigma < 2


def test_a_mirrored_image_gives_the_mirrored_edge_to_1e_6_px():
    image = exposed(drawn("fisheye", 2)[0])
    mirrored = np.ascontiguousarray(image[:, ::-1])
    a, b = (refine_outline(i, find_color_contour(i, GREEN)) for i in (image, mirrored))
    back = b.uv * [-1, 1] + [image.shape[1] - 1, 0]
    distance, match = cKDTree(back).query(a.uv)
    assert len(a.uv) == len(b.uv) == len(np.unique(match))
    assert distance.max() < 1e-6
    assert np.array_equal(a.is_measured, b.is_measured[match])


def test_hue_may_wrap_around_360_deg():
    hue = np.arange(0, 360, 10, dtype=np.float32)
    hsv = np.stack([hue, np.full(36, 0.8, np.float32), np.full(36, 0.7, np.float32)], -1)[None]
    image = np.rint(255 * cv2.cvtColor(hsv, cv2.COLOR_HSV2BGR)).astype(np.uint8)
    whole = {"saturation": [0.3, 1], "value": [0.15, 1]}

    def passed(low, high):
        color = Color.from_config({"hue_deg": [low, high], **whole})
        return hue[color.mask(image)[0]].tolist()

    assert passed(335, 25) == [0, 10, 20, 340, 350]
    assert passed(85, 125) == [90, 100, 110, 120]
    assert len(passed(0, 360)) == 36


def test_a_second_smaller_thing_of_the_colour_changes_nothing():
    region = drawn("pinhole", 1)[0].copy()
    alone = find_color_contour(exposed(region), GREEN)
    region[5:35, 5:35] = PAINT
    assert np.array_equal(find_color_contour(exposed(region), GREEN), alone)


def test_what_hides_a_piece_of_a_limb_takes_only_that_piece():
    region, offset = drawn("pinhole", 0)
    found, _ = find("pinhole", 0, exposed(region))
    points = found.edges.uv[found.side == 1]
    u, v = np.rint(points[len(points) // 2] - offset).astype(int)
    hidden = region.copy()
    hidden[v - 15 : v + 16, u - 15 : u + 16] = METAL
    found, status = find("pinhole", 0, exposed(hidden))
    assert status.ok
    off, _ = residuals(found, CAMERAS["pinhole"], place(0))
    assert np.abs(off).max() < 0.3
    gap = np.abs(found.edges.uv[found.side != 0] - offset - [u, v]).max(1)
    assert gap.min() > 15


def test_a_blob_that_touches_the_border_is_refused_in_words():
    region, offset = drawn("pinhole", 0)
    found, status = find("pinhole", 0, exposed(region[:, :-90]))
    assert found is None and "touches the border" in str(status)


def test_a_blob_of_the_wrong_size_is_refused_with_both_areas():
    image = exposed(drawn("pinhole", 0)[0])
    near = make_pose(t=[0, 0, -0.7]) @ place(0)
    found, status = find_cylinder_silhouette(
        image, [0, 0], GREEN, CAMERAS["pinhole"], target=TARGET, T_camera_target=near
    )
    assert found is None and "size" in status.reason
    assert "px²" in status.found and "px²" in status.expected


def test_a_blob_that_lies_across_the_expected_axis_is_refused():
    image, offset = exposed(drawn("pinhole", 0)[0]), drawn("pinhole", 0)[1]
    across = (
        make_pose(t=place(0)[:3, 3]) @ make_pose(so3_exp([0, 0, 1.4])) @ make_pose(place(0)[:3, :3])
    )
    found, status = find_cylinder_silhouette(
        image, offset, GREEN, CAMERAS["pinhole"], target=TARGET, T_camera_target=across
    )
    assert found is None and "straight sides" in status.reason


def test_an_image_without_the_colour_or_with_a_speck_of_it_is_refused():
    image = np.full((200, 300, 3), WALL, np.uint8)
    assert "nothing of the target's colour" in find("pinhole", 0, image)[1].reason
    image[90:100, 100:140] = PAINT
    assert "too small" in find("pinhole", 0, image)[1].reason
