from __future__ import annotations

import numpy as np
import pytest
from small_rooms import looking, room, wall

from wheelsight.core.calibration import Calibration
from wheelsight.core.errors import ConfigError
from wheelsight_sim.cameras import camera_model, camera_names
from wheelsight_sim.depth_sensor import IdealDepth, StructuredLight, TimeOfFlight
from wheelsight_sim.scene import Scene


def test_there_are_two_kinects_a_stereo_and_an_ideal_camera() -> None:
    assert camera_names() == ("ideal", "kinect-v1", "kinect-v2", "realsense-d455")
    models = {name: camera_model(name) for name in camera_names()}
    assert {name: model.name for name, model in models.items()} == {name: name for name in camera_names()}
    assert isinstance(models["kinect-v1"].depth, StructuredLight)
    assert isinstance(models["kinect-v2"].depth, TimeOfFlight)
    assert isinstance(models["ideal"].depth, IdealDepth)
    sizes = [(model.camera.width, model.camera.height) for model in models.values()]
    assert sizes == [(640, 480), (640, 480), (512, 424), (848, 480)]


@pytest.mark.parametrize(
    ("name", "across_deg", "down_deg"), [("kinect-v1", 57, 43), ("kinect-v2", 70.6, 60), ("realsense-d455", 87, 58)]
)
def test_fields_of_view_are_the_makers_to_two_degrees(name: str, across_deg: float, down_deg: float) -> None:
    lens = camera_model(name).camera
    seen = np.degrees(2 * np.arctan([lens.width / 2 / lens.fx, lens.height / 2 / lens.fy]))
    np.testing.assert_allclose(seen, (across_deg, down_deg), atol=2)


@pytest.mark.parametrize("name", camera_names())
@pytest.mark.parametrize("size", [(320, 240), (160, 120), (1280, 960), (333, 77)])
def test_another_size_shows_the_same_field(name: str, size: tuple[int, int]) -> None:
    native, other = camera_model(name).camera, camera_model(name, size).camera
    assert (other.width, other.height) == size
    for lens in (native, other):
        corners = lens.normalise([(-0.5, -0.5), (lens.width - 0.5, lens.height - 0.5)])
        expected = native.normalise([(-0.5, -0.5), (native.width - 0.5, native.height - 0.5)])
        np.testing.assert_allclose(corners, expected, atol=1e-12)


def test_half_the_size_sees_the_mean_of_four_rays() -> None:
    native, half = camera_model("kinect-v1").camera.rays(), camera_model("kinect-v1", (320, 240)).camera.rays()
    np.testing.assert_allclose(native.reshape(240, 2, 320, 2, 3).mean(axis=(1, 3)), half, atol=1e-12)


@pytest.mark.parametrize("name", camera_names())
def test_its_calibration_shows_the_noise_it_has(name: str) -> None:
    model = camera_model(name, (320, 240))
    Calibration.registered_camera(
        model.camera, depth_noise=model.depth_noise, rolling_shutter_s=model.rolling_shutter_s
    )
    for distance_m in (1.5, 3.0):
        view = Scene(room(wall(distance_m, 0.1)), threads=1).cast(model.camera, looking())
        depth_m = model.depth.measure(view, model.camera, np.array([0.6]), np.zeros(1), np.random.default_rng(0))
        inner = (slice(20, -20), slice(60, -60))
        error = (depth_m - view.depth_m)[inner][depth_m[inner] > 0]
        assert len(error) > 20_000
        believed = model.depth_noise.sigma_m(np.array(distance_m))
        assert error.std() < 1.15 * believed
        assert name == "ideal" or error.std() > 0.6 * believed


@pytest.mark.parametrize("name", ["kinect-v3", "", "Ideal"])
def test_an_unknown_camera_is_refused_with_those_there_are(name: str) -> None:
    with pytest.raises(ConfigError, match="ideal, kinect-v1, kinect-v2, realsense-d455"):
        camera_model(name)


@pytest.mark.parametrize("size", [(0, 240), (320, -1), (100_000, 240)])
def test_impossible_sizes_are_refused(size: tuple[int, int]) -> None:
    with pytest.raises(ConfigError, match="cannot be made"):
        camera_model("ideal", size)
