from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import warp as wp

from wkernels.device.launch import launch
from wkernels.filters.summed_area import box_mean, summed_area_table
from wkernels.filters.texels import DOUBLE, components

UNIT_ROUNDOFF = 2.0**-53
DTYPES = {components(texel): texel for texel in DOUBLE}


def random_image(height: int, width: int, channels: int, seed: int = 0) -> np.ndarray:
    """Depth-like moments: large, all of one sign, the worst case for running sums."""
    return np.random.default_rng(seed).uniform(0.5, 1.0, (height, width, channels)).astype(np.float32)


def direct_mean(image: np.ndarray, box: np.ndarray) -> np.ndarray:
    """Mean over a box by weighting each texel with the share of it inside: no table, no difference of large numbers."""
    height, width = image.shape[:2]
    cover_x = np.clip(np.minimum(box[2], np.arange(1, width + 1)) - np.maximum(box[0], np.arange(width)), 0.0, 1.0)
    cover_y = np.clip(np.minimum(box[3], np.arange(1, height + 1)) - np.maximum(box[1], np.arange(height)), 0.0, 1.0)
    return np.einsum("y,x,yxc->c", cover_y, cover_x, image.astype(float)) / (cover_x.sum() * cover_y.sum())


def upload(image: np.ndarray) -> wp.array:
    """An image (H, W, n) on the device."""
    return wp.array(image[..., 0] if image.shape[2] == 1 else image, dtype=DTYPES[image.shape[2]])


@wp.kernel
def mean_of_boxes(first: int, sat: wp.array2d[Any], boxes: wp.array[wp.vec4], mean_out: wp.array[Any]):
    i = first + wp.tid()
    box = boxes[i]
    mean_out[i] = box_mean(sat, box[0], box[1], box[2], box[3])


def box_means(sat: wp.array, boxes: np.ndarray, channels: int) -> np.ndarray:
    out = wp.empty(len(boxes), dtype=DTYPES[channels])
    launch(mean_of_boxes, len(boxes), [sat, wp.array(boxes, dtype=wp.vec4)], [out], threads=2)
    return out.numpy().reshape(-1, channels)


def random_boxes(n: int, height: int, width: int, seed: int, outside: float = 0.0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    x = np.sort(rng.uniform(-outside, width + outside, (n, 2)), axis=1)
    y = np.sort(rng.uniform(-outside, height + outside, (n, 2)), axis=1)
    return np.stack([x[:, 0], y[:, 0], x[:, 1], y[:, 1]], axis=1).astype(np.float32)


@pytest.mark.parametrize("channels", DTYPES)
@pytest.mark.parametrize("shape", [(1, 1), (1, 40), (40, 1), (33, 70), (200, 150)])
def test_table_equals_numpy_cumulative_sums(shape: tuple[int, int], channels: int) -> None:
    image = random_image(*shape, channels)
    sat = summed_area_table(upload(image)).numpy()
    assert sat.shape[:2] == (shape[0] + 1, shape[1] + 1) and sat.dtype == np.float64
    sat = sat.reshape(*sat.shape[:2], channels)
    expected = np.zeros_like(sat)
    expected[1:, 1:] = image.astype(float).cumsum(axis=1).cumsum(axis=0)
    np.testing.assert_array_equal(sat, expected)  # the same sums in the same order


@pytest.mark.parametrize("channels", DTYPES)
def test_table_does_not_depend_on_threads(channels: int) -> None:
    image = upload(random_image(300, 250, channels))
    one = summed_area_table(image, threads=1).numpy()
    for threads in (2, 3):
        np.testing.assert_array_equal(summed_area_table(image, threads=threads).numpy(), one)


def test_table_can_be_reused_and_leaves_the_image_alone() -> None:
    first, second = random_image(40, 50, 2, seed=1), random_image(40, 50, 2, seed=2)
    image = wp.array(second, dtype=wp.vec2)
    table = summed_area_table(wp.array(first, dtype=wp.vec2))
    assert summed_area_table(image, out=table) is table
    np.testing.assert_array_equal(table.numpy(), summed_area_table(image).numpy())
    np.testing.assert_array_equal(image.numpy(), second)


@pytest.mark.parametrize("channels", DTYPES)
def test_box_mean_equals_the_direct_mean_within_the_stated_bound(channels: int) -> None:
    height, width = 130, 170
    image = random_image(height, width, channels, seed=3)
    sat = summed_area_table(upload(image))
    boxes = random_boxes(600, height, width, seed=4)
    boxes[:200, 2:] = boxes[:200, :2] + np.random.default_rng(5).uniform(0.01, 3.0, (200, 2))  # small ones too
    boxes[:, 2], boxes[:, 3] = np.minimum(boxes[:, 2], width), np.minimum(boxes[:, 3], height)
    boxes = boxes[((boxes[:, 2:] - boxes[:, :2]) > 0.005).all(axis=1)]
    assert len(boxes) > 550
    ours = box_means(sat, boxes, channels)
    expected = np.array([direct_mean(image, box.astype(float)) for box in boxes])
    area = np.prod(boxes[:, 2:].astype(float) - boxes[:, :2], axis=1)
    bound = 8.0 * (height + width) * UNIT_ROUNDOFF * float(image.astype(float).sum(axis=(0, 1)).max()) / area
    rounding = 2.0**-24 * np.abs(expected)
    assert (np.abs(ours - expected) <= bound[:, None] + 1.001 * rounding).all()


def test_whole_texels_come_back_exactly() -> None:
    image = random_image(64, 64, 2, seed=6)
    sat = summed_area_table(wp.array(image, dtype=wp.vec2))
    y, x = np.divmod(np.arange(64 * 64), 64)
    boxes = np.stack([x, y, x + 1, y + 1], axis=1).astype(np.float32)
    np.testing.assert_allclose(box_means(sat, boxes, 2), image.reshape(-1, 2), rtol=1e-7)


def test_float64_keeps_single_texels_of_a_large_map() -> None:
    """In float32 the last texel of a 1024 x 1024 table is wrong by about 1.6e-2."""
    image = random_image(1024, 1024, 2, seed=7)
    sat = summed_area_table(wp.array(image, dtype=wp.vec2))
    boxes = np.array([[1023, 1023, 1024, 1024], [1000, 1010, 1001, 1011]], np.float32)
    np.testing.assert_allclose(box_means(sat, boxes, 2), [image[1023, 1023], image[1010, 1000]], atol=1e-6)
    single = image.cumsum(axis=1, dtype=np.float32).cumsum(axis=0, dtype=np.float32)
    wrong = single[1023, 1023] - single[1022, 1023] - single[1023, 1022] + single[1022, 1022] - image[1023, 1023]
    assert np.abs(wrong).max() > 1e-3


def test_boxes_are_clipped_to_the_map() -> None:
    height, width = 20, 30
    image = random_image(height, width, 2, seed=8)
    sat = summed_area_table(wp.array(image, dtype=wp.vec2))
    boxes = random_boxes(400, height, width, seed=9, outside=15.0)
    inside = np.clip(boxes, 0, np.array([width, height, width, height], np.float32))
    overlaps = ((inside[:, 2:] - inside[:, :2]) > 0.01).all(axis=1)
    sticks_out = (inside != boxes).any(axis=1) & overlaps
    assert sticks_out.sum() > 100
    expected = np.array([direct_mean(image, box.astype(float)) for box in inside[sticks_out]])
    np.testing.assert_allclose(box_means(sat, boxes[sticks_out], 2), expected, atol=1e-6)


def test_empty_boxes_take_the_nearest_texel() -> None:
    height, width = 6, 9
    image = random_image(height, width, 2, seed=10)
    sat = summed_area_table(wp.array(image, dtype=wp.vec2))
    cases = [
        ([3.4, 2.6, 3.4, 2.6], (2, 3)),  # a point
        ([4.0, 5.0, 4.0, 5.0], (5, 4)),  # on a corner: the texel right of and below it
        ([9.0, 6.0, 9.0, 6.0], (5, 8)),  # the far corner of the map
        ([-7.0, -3.0, -5.0, -1.0], (0, 0)),
        ([20.0, 8.0, 30.0, 9.0], (5, 8)),
        ([3.2, -9.0, 3.2, -8.0], (0, 3)),
        ([1e9, -1e9, 2e9, -5e8], (0, 8)),
    ]
    means = box_means(sat, np.array([box for box, _ in cases], np.float32), 2)
    np.testing.assert_allclose(means, [image[texel] for _, texel in cases], rtol=1e-6)
    line = box_means(sat, np.array([[1.0, 2.5, 4.0, 2.5]], np.float32), 2)[0]  # narrow on one axis alone
    np.testing.assert_allclose(line, image[2, 1:4].mean(axis=0), rtol=1e-6)


def test_constant_images_stay_constant() -> None:
    sat = summed_area_table(wp.array(np.full((90, 70, 2), 0.7, np.float32), dtype=wp.vec2))
    means = box_means(sat, random_boxes(300, 90, 70, seed=11, outside=20.0), 2)
    np.testing.assert_allclose(means, np.float32(0.7), rtol=2e-6)


def test_wrong_types_are_refused() -> None:
    with pytest.raises(TypeError, match="float, vec2, vec4 or vec8"):
        summed_area_table(wp.zeros((4, 4), dtype=wp.vec3))
    with pytest.raises(TypeError, match="float, vec2, vec4 or vec8"):
        summed_area_table(wp.zeros(4, dtype=wp.vec2))
    with pytest.raises(TypeError, match="does not fit"):
        summed_area_table(wp.zeros((4, 4), dtype=wp.vec2), out=wp.zeros((4, 4), dtype=wp.vec2d))
