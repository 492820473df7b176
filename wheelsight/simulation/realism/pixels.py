"""What happens to a colour image behind the sensor: one colour a pixel, filled in again, and JPEG."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from wheelsight.geometry import ByteArray


@dataclass(frozen=True, slots=True)
class PixelSettings:
    """How images are brought to the host.

    Attributes:
        has_bayer: whether pixels have one colour each, as those of all small sensors.
        jpeg_quality: of 100; 0 for none. 75 and 80 are those of Kinect's images in `kinect_v1_herrera_board` and
            red_kitchen, by their quantisation tables; with colour halved each way, as both have it.
    """

    has_bayer: bool = True
    jpeg_quality: int = 80


def as_delivered(color: ByteArray, settings: PixelSettings) -> ByteArray:
    """An image (H, W, 3) as the host gets it.

    Colours are taken out and filled in after gamma, where a camera does so before: a simplification that leaves the
    noise of edges as it is.
    """
    if settings.has_bayer:
        color = _filled_in(color)
    if settings.jpeg_quality:
        color = _by_jpeg(color, settings.jpeg_quality)
    return color


def _filled_in(color: ByteArray) -> ByteArray:
    """Each pixel's own colour of the pattern red, green / green, blue, and the others from its neighbours."""
    mosaic = color[..., 1].copy()
    mosaic[0::2, 0::2] = color[0::2, 0::2, 0]
    mosaic[1::2, 1::2] = color[1::2, 1::2, 2]
    # OpenCV names the pattern by the pixels of its second row and column.
    return np.asarray(cv2.cvtColor(mosaic, cv2.COLOR_BayerBG2RGB), np.uint8)


def _by_jpeg(color: ByteArray, quality: int) -> ByteArray:
    options = [
        cv2.IMWRITE_JPEG_QUALITY,
        quality,
        cv2.IMWRITE_JPEG_SAMPLING_FACTOR,
        cv2.IMWRITE_JPEG_SAMPLING_FACTOR_420,
    ]
    _, data = cv2.imencode(".jpg", color[..., ::-1], options)
    return np.asarray(cv2.cvtColor(np.asarray(cv2.imdecode(data, cv2.IMREAD_COLOR)), cv2.COLOR_BGR2RGB), np.uint8)
