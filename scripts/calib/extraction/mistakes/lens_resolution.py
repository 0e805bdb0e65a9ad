"""A lens of another resolution or binning than the images."""

from collections.abc import Iterator
from dataclasses import replace

from calib.extraction.mistakes.stated_setup import ConfigCorrection, StatedSetup
from calib.io.config_change import any_rig_change
from calib.sensors.camera.camera_model import CameraModel

BINNING_FACTORS = (1 / 2, 2, 1 / 4, 4, 1 / 3, 3, 2 / 3, 3 / 2)


def correct_lens_resolution(stated: StatedSetup) -> Iterator[ConfigCorrection]:
    """Yield the setups with the lens of another resolution (see Mistake)."""
    camera = stated.model
    if not isinstance(camera, CameraModel) or not stated.images:
        return
    height, width = stated.images[0].shape
    if camera.size_px != (width, height):
        resized = replace(camera, size_px=(width, height))
        yield _describe_lens(stated, resized, camera)
        yield _describe_lens(stated, scale_lens(resized, width / camera.size_px[0]), camera)
        return
    for factor in BINNING_FACTORS:
        yield _describe_lens(stated, scale_lens(camera, factor), camera)


def scale_lens(camera: CameraModel, factor: float) -> CameraModel:
    """Return the lens for images that are enlarged by a factor; (0, 0) is the middle of a pixel."""
    fx, fy, cx, cy, *rest = camera.params
    middle = [factor * (c + 0.5) - 0.5 for c in (cx, cy)]
    return replace(camera, params=(factor * fx, factor * fy, *middle, *rest))


def _written_params(camera: CameraModel) -> list[float]:
    """Return the params without optional ones that are zero."""
    params, n_optional = list(camera.params), len(camera.lens.OPTIONAL_PARAMETERS)
    while n_optional and params[-1] == 0:
        params.pop()
        n_optional -= 1
    return params


def _describe_lens(stated: StatedSetup, lens: CameraModel, before: CameraModel) -> ConfigCorrection:
    """Return the correction to a lens, with the size and the params to write."""
    changes, written, block = [], [], f"sensors.{stated.sensor}"
    if lens.size_px != before.size_px:
        changes.append(f"size_px to [{lens.size_px[0]}, {lens.size_px[1]}]")
        written.append(any_rig_change(f"{block}.size_px", list(lens.size_px)))
    if lens.params != before.params or stated.has_camera_info:
        numbers = ", ".join(f"{p:.6g}" for p in _written_params(lens))
        changes.append(f"params to [{numbers}]")
        written.append(any_rig_change(f"{block}.params", _written_params(lens)))
    what = f"size_px {list(before.size_px)}, fx {before.params[0]:.5g}"
    true = f"size_px {list(lens.size_px)}, fx {lens.params[0]:.5g}"
    place = f" in place of camera_info, with model {lens.model}," if stated.has_camera_info else ""
    return ConfigCorrection(
        replace(stated, model=lens),
        f"the lens of {stated.sensor} is of another resolution than its images: stated {what}; "
        f"{true} agrees with what it saw",
        f"Set{place} {' and '.join(changes)} of {block}.",
        written[0] if len(written) == 1 and not place else None,
    )
