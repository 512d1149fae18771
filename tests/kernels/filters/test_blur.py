from __future__ import annotations

import numpy as np
import pytest
import warp as wp

from wkernels.filters.blur import box_weights, gaussian_weights, separable_blur
from wkernels.filters.texels import DOUBLE, components

DTYPES = {components(texel): texel for texel in DOUBLE}


def random_image(height: int, width: int, channels: int) -> np.ndarray:
    return np.random.default_rng(height + channels).normal(size=(height, width, channels)).astype(np.float32)


def direct_blur(image: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """The whole two-dimensional kernel at once, on an image padded with its border."""
    radius = len(weights) // 2
    height, width = image.shape[:2]
    padded = np.pad(image.astype(float), ((radius, radius), (radius, radius), (0, 0)), mode="edge")
    out = np.zeros(image.shape)
    for i, j in np.ndindex(len(weights), len(weights)):
        out += weights[i] * weights[j] * padded[i : i + height, j : j + width]
    return out


def test_weights() -> None:
    np.testing.assert_allclose(box_weights(2), [0.2] * 5)
    np.testing.assert_array_equal(box_weights(0), [1.0])
    for radius, sigma in ((1, None), (4, None), (6, 1.7)):
        weights = gaussian_weights(radius, sigma)
        assert weights.sum() == pytest.approx(1.0)
        np.testing.assert_allclose(weights, weights[::-1])
        s = radius / 2 if sigma is None else sigma
        assert weights[0] / weights[radius] == pytest.approx(np.exp(-0.5 * (radius / s) ** 2))
    np.testing.assert_array_equal(gaussian_weights(0), [1.0])


@pytest.mark.parametrize("channels", DTYPES)
@pytest.mark.parametrize("weights", [box_weights(0), box_weights(1), box_weights(5), gaussian_weights(4)], ids=len)
def test_blur_equals_the_direct_kernel(weights: np.ndarray, channels: int) -> None:
    image = random_image(50, 70, channels)
    source = wp.array(image[..., 0] if channels == 1 else image, dtype=DTYPES[channels])
    blurred = separable_blur(source, weights).numpy().reshape(image.shape)
    np.testing.assert_allclose(blurred, direct_blur(image, weights), atol=2e-6)


def test_kernel_wider_than_the_image() -> None:
    image = random_image(3, 5, 2)
    blurred = separable_blur(wp.array(image, dtype=wp.vec2), gaussian_weights(9)).numpy()
    np.testing.assert_allclose(blurred, direct_blur(image, gaussian_weights(9)), atol=2e-6)


def test_asymmetric_weights_keep_their_direction() -> None:
    image = random_image(20, 20, 2)
    weights = np.array([0.7, 0.2, 0.1])
    blurred = separable_blur(wp.array(image, dtype=wp.vec2), weights).numpy()
    np.testing.assert_allclose(blurred, direct_blur(image, weights), atol=2e-6)


def test_blur_does_not_depend_on_threads_and_keeps_its_input() -> None:
    image = random_image(90, 110, 2)
    source = wp.array(image, dtype=wp.vec2)
    one = separable_blur(source, gaussian_weights(3), threads=1).numpy()
    np.testing.assert_array_equal(separable_blur(source, gaussian_weights(3), threads=2).numpy(), one)
    np.testing.assert_array_equal(source.numpy(), image)
    assert separable_blur(source, gaussian_weights(3), scratch=wp.empty_like(source), out=source) is source
    np.testing.assert_array_equal(source.numpy(), one)  # in place


def test_wrong_arguments_are_refused() -> None:
    with pytest.raises(TypeError, match="float, vec2, vec4 or vec8, not vec3f"):
        separable_blur(wp.zeros((4, 4), dtype=wp.vec3), box_weights(1))
    with pytest.raises(ValueError, match="odd number"):
        separable_blur(wp.zeros((4, 4), dtype=wp.vec2), np.full(4, 0.25))
