"""Error measures of one visibility image, as a table of descriptors.

Every metric is a number over *receiver pixels*: those where neither the visibility nor the reference is NaN. What
cannot be measured is None, never 0. A descriptor carries a version, which is stored with the results and grows when its
definition changes, so that numbers of different definitions are never mixed.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from wkernels.sampling_rate import MapUse

FLIP_PIXELS_PER_DEGREE = 67.02  # a 0.7 m wide 4K screen seen from 0.7 m, the value of the FLIP paper
MOST_PIXELS = 50.0  # at a shadow's edge no texel counts for more; where the light grazes m is in the thousands
HARD_EDGE = 0.5  # a larger difference of visibility between neighbouring pixels is an edge, not a slope


@dataclass(frozen=True, eq=False)
class Measured:
    """What one frame of one label offers to the metrics.

    Attributes:
        visibility: (H, W), 1 = lit, NaN where no receiver is seen.
        standard_error: (H, W) of the technique's light sampling; None for techniques that do not sample the light.
        reference: (H, W) reference visibility of the same receiver points; None where none was made.
        reference_standard_error: (H, W), goes with ``reference``.
        previous: Visibility of the frame before, carried to this frame's receiver points (``carry_over``), (H, W), NaN
            where these were not seen; None on a first frame or where nothing asked for it.
        map_use: How the light map that the technique read suits the frame; None for techniques that read none, or where
            nothing asked for it.
    """

    visibility: np.ndarray
    standard_error: np.ndarray | None = None
    reference: np.ndarray | None = None
    reference_standard_error: np.ndarray | None = None
    previous: np.ndarray | None = None
    map_use: MapUse | None = None


@dataclass(frozen=True)
class Metric:
    """One metric.

    Attributes:
        name: Column in frames.csv and key under ``metrics`` in an experiment file.
        title: Name for axes and table heads.
        description: What it measures, in one sentence.
        unit: Unit of the number.
        best: The value of a perfect image; larger distance from it is worse.
        worst: The value furthest from ``best`` that can occur.
        always: Whether it is computed without being asked for (whenever its inputs exist).
        from_images: Whether the stored raw images of that frame suffice to compute it again.
        version: Version of the definition.
        evaluate: The function; None where an input is missing.
    """

    name: str
    title: str
    description: str
    unit: str
    best: float
    worst: float
    always: bool
    from_images: bool
    version: int
    evaluate: Callable[[Measured], float | None]


def signed_error(visibility: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """``visibility - reference`` at receiver pixels, float64 (N,); negative where too dark."""
    error = visibility.astype(np.float64) - reference.astype(np.float64)
    return error[np.isfinite(error)]


def _over_errors(reduce: Callable[[np.ndarray], float]) -> Callable[[Measured], float | None]:
    def evaluate(m: Measured) -> float | None:
        if m.reference is None:
            return None
        error = signed_error(m.visibility, m.reference)
        return float(reduce(error)) if len(error) else None

    return evaluate


def _root_mean_square(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def _rms_of_finite(image: np.ndarray | None, where: np.ndarray) -> float | None:
    if image is None:
        return None
    values = image[np.isfinite(image) & np.isfinite(where)].astype(np.float64)
    return _root_mean_square(values) if len(values) else None


def _standard_error(m: Measured) -> float | None:
    return _rms_of_finite(m.standard_error, m.visibility)


def _reference_standard_error(m: Measured) -> float | None:
    return None if m.reference is None else _rms_of_finite(m.reference_standard_error, m.reference)


def _flicker(m: Measured) -> float | None:
    if m.previous is None:
        return None
    return _rms_of_finite(m.visibility - m.previous, np.where(beside_hard_edge(m.visibility), np.nan, m.visibility))


def beside_hard_edge(visibility: np.ndarray) -> np.ndarray:
    """Whether one of a pixel's four neighbours differs by more than ``HARD_EDGE``; bool (H, W)."""
    out = np.zeros(visibility.shape, dtype=bool)
    across, down = np.abs(np.diff(visibility, axis=1)), np.abs(np.diff(visibility, axis=0))
    with np.errstate(invalid="ignore"):
        across, down = across > HARD_EDGE, down > HARD_EDGE
    out[:, 1:] |= across
    out[:, :-1] |= across
    out[1:] |= down
    out[:-1] |= down
    return out


def _over_lookups(reduce: Callable[[np.ndarray], float]) -> Callable[[Measured], float | None]:
    """Of the largest error m at the receiver pixels that look into the map."""

    def evaluate(m: Measured) -> float | None:
        if m.map_use is None:
            return None
        error = m.map_use.rate.m[m.map_use.rate.is_read & np.isfinite(m.visibility)]
        return float(reduce(error.astype(np.float64))) if len(error) else None

    return evaluate


def _edge_error(m: Measured) -> tuple[float, float] | None:
    """Mean m, up to ``MOST_PIXELS``, beside the reference's hard edges, and the share of receivers there."""
    if m.map_use is None or m.reference is None:
        return None
    receiver = np.isfinite(m.visibility) & np.isfinite(m.reference)
    edge = beside_hard_edge(m.reference) & receiver
    error = m.map_use.rate.m[edge & m.map_use.rate.is_read]
    if not len(error):
        return None
    mean = np.minimum(error, MOST_PIXELS).mean(dtype=np.float64)
    return float(mean), np.count_nonzero(edge) / np.count_nonzero(receiver)


def _m_edge(m: Measured) -> float | None:
    found = _edge_error(m)
    return None if found is None else found[0]


def _predicted_rmse(m: Measured) -> float | None:
    # a point is judged by the centre of its texel, on average a quarter of a texel away across an edge; an edge of
    # length 1 px has about two pixels beside it
    found = _edge_error(m)
    return None if found is None else float(np.sqrt(0.25 * found[0] * 0.5 * found[1]))


def flip_map(visibility: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """FLIP (andersson2020flip) of two visibility images shown as linear grey, float32 (H, W) in [0, 1].

    The low-dynamic-range form, because visibility is in [0, 1]; its exposure does not depend on the image, so it is
    defined for shadow masks, whose median is often 0. Pixels without a receiver in either image are equal in both.
    """
    import OpenImageIO as oiio

    blank = ~(np.isfinite(visibility) & np.isfinite(reference))

    def as_buffer(image: np.ndarray) -> oiio.ImageBuf:
        grey = np.clip(np.where(blank, 1.0, image), 0.0, 1.0).astype(np.float32)
        spec = oiio.ImageSpec(grey.shape[1], grey.shape[0], 3, "float")
        spec.attribute("oiio:ColorSpace", "lin_rec709_scene")
        buffer = oiio.ImageBuf(spec)
        buffer.set_pixels(oiio.ROI(), np.ascontiguousarray(np.repeat(grey[:, :, None], 3, axis=2)))
        return buffer

    # One thread: measuring must not fight with the next timed frame for cores.
    result = oiio.ImageBufAlgo.FLIP_diff(
        as_buffer(reference), as_buffer(visibility), hdr=0, ppd=FLIP_PIXELS_PER_DEGREE, nthreads=1
    )
    if result.has_error:
        raise RuntimeError(f"FLIP failed: {result.geterror()}")
    return np.asarray(result.get_pixels(oiio.FLOAT))[:, :, 0]


def _flip(m: Measured) -> float | None:
    if m.reference is None:
        return None
    receiver = np.isfinite(m.visibility) & np.isfinite(m.reference)
    if not receiver.any():
        return None
    return float(flip_map(m.visibility, m.reference)[receiver].mean(dtype=np.float64))


METRICS: Mapping[str, Metric] = {
    metric.name: metric
    for metric in (
        Metric(
            "rmse",
            "RMSE",
            "Root mean square of visibility minus reference.",
            "visibility",
            best=0.0,
            worst=1.0,
            always=True,
            from_images=True,
            version=1,
            evaluate=_over_errors(_root_mean_square),
        ),
        Metric(
            "mean_signed_error",
            "mean signed error",
            "Mean of visibility minus reference; negative = darker than the reference.",
            "visibility",
            best=0.0,
            worst=1.0,
            always=True,
            from_images=True,
            version=1,
            evaluate=_over_errors(np.mean),
        ),
        Metric(
            "p99_error",
            "p99 error",
            "99th percentile of |visibility - reference|.",
            "visibility",
            best=0.0,
            worst=1.0,
            always=True,
            from_images=True,
            version=1,
            evaluate=_over_errors(lambda error: float(np.percentile(np.abs(error), 99.0))),
        ),
        Metric(
            "flip",
            "FLIP",
            f"Mean FLIP of visibility shown as linear grey, {FLIP_PIXELS_PER_DEGREE} pixels per degree.",
            "FLIP",
            best=0.0,
            worst=1.0,
            always=False,
            from_images=True,
            version=1,
            evaluate=_flip,
        ),
        Metric(
            "standard_error",
            "standard error",
            "Root mean square of the technique's own standard error; only techniques that sample the light have one.",
            "visibility",
            best=0.0,
            worst=1.0,
            always=True,
            from_images=True,
            version=1,
            evaluate=_standard_error,
        ),
        Metric(
            "reference_standard_error",
            "reference standard error",
            "Root mean square of the reference's standard error: what lies within twice of it cannot be told apart.",
            "visibility",
            best=0.0,
            worst=0.5,
            always=True,
            from_images=True,
            version=1,
            evaluate=_reference_standard_error,
        ),
        Metric(
            "flicker",
            "flicker",
            "Root mean square change of visibility since the frame before, at surface points seen in both and beside a "
            "hard edge in neither, where what a pixel shows depends on where its centre lies.",
            "visibility",
            best=0.0,
            worst=1.0,
            always=False,
            from_images=False,
            version=2,  # 1 counted pixels beside hard edges, which flicker under every technique
            evaluate=_flicker,
        ),
        Metric(
            "m_pixel_median",
            "m, median",
            "Median over receiver pixels of the largest err_accurate, texel over pixel; above 1 the map is too coarse.",
            "texels in pixels",
            best=0.0,
            worst=float("inf"),
            always=False,
            from_images=False,
            version=1,
            evaluate=_over_lookups(np.median),
        ),
        Metric(
            "m_pixel_p99",
            "m, p99",
            "99th percentile over receiver pixels of the largest err_accurate.",
            "texels in pixels",
            best=0.0,
            worst=float("inf"),
            always=False,
            from_images=False,
            version=1,
            evaluate=_over_lookups(lambda error: float(np.percentile(error, 99.0))),
        ),
        Metric(
            "undersampled",
            "undersampled",
            "Share of the receiver pixels that look into the map whose err_accurate is above 1 in some direction.",
            "share",
            best=0.0,
            worst=1.0,
            always=False,
            from_images=False,
            version=1,
            evaluate=_over_lookups(lambda error: float(np.mean(error > 1.0))),
        ),
        Metric(
            "map_waste",
            "map wasted",
            "Share of the map's area outside of what the eye can see of the receivers' box; mean over layers.",
            "share",
            best=0.0,
            worst=1.0,
            always=False,
            from_images=False,
            version=1,
            evaluate=lambda m: None if m.map_use is None else m.map_use.waste,
        ),
        Metric(
            "map_unread",
            "map unread",
            "Share of the map's texels that no receiver pixel falls into; it depends on the number of pixels.",
            "share",
            best=0.0,
            worst=1.0,
            always=False,
            from_images=False,
            version=1,
            evaluate=lambda m: None if m.map_use is None else m.map_use.unread,
        ),
        Metric(
            "m_edge",
            "m, edges",
            f"Mean of the largest err_accurate, up to {MOST_PIXELS:g}, at pixels beside a hard edge of the reference.",
            "texels in pixels",
            best=0.0,
            worst=float("inf"),
            always=False,
            from_images=False,
            version=1,
            evaluate=_m_edge,
        ),
        Metric(
            "rmse_predicted",
            "RMSE predicted",
            "What the map's texels would do to the reference's hard edges, were each a quarter of m pixels off: "
            "sqrt(m_edge times the share of pixels beside an edge / 8). Too large: m is that of the worst direction.",
            "visibility",
            best=0.0,
            worst=float("inf"),
            always=False,
            from_images=False,
            version=1,
            evaluate=_predicted_rmse,
        ),
    )
}

MAP_METRICS = ("m_pixel_median", "m_pixel_p99", "undersampled", "map_waste", "map_unread", "m_edge", "rmse_predicted")
"""How the light map suits the picture: 20 to 40 ms for a label's frame of 640 x 360, outside all timings."""
GROUPS: Mapping[str, tuple[str, ...]] = {"sampling": MAP_METRICS}
"""Names under ``metrics`` in an experiment file that stand for several."""


def evaluate(names: frozenset[str], measured: Measured) -> dict[str, float | None]:
    """All metrics in ``names`` and those that are always on; the others, and what has no inputs, are None."""
    return {
        metric.name: metric.evaluate(measured) if metric.always or metric.name in names else None
        for metric in METRICS.values()
    }


def distinguishable(difference: float | None, reference_standard_error: float | None) -> bool | None:
    """Whether a difference of errors exceeds twice the reference's standard error; None where either is unknown."""
    if difference is None or reference_standard_error is None:
        return None
    if not (np.isfinite(difference) and np.isfinite(reference_standard_error)):
        return None
    return bool(abs(difference) > 2.0 * reference_standard_error)
