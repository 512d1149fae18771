"""Metrics of how the light map that a technique read suits the picture (``wkernels.analysis.sampling_rate``).

They cost more than many a frame, outside all timings, and are computed only on request.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from experiments.metrics.measured import Measured, Metric, beside_hard_edge

MOST_PIXELS = 50.0  # at a shadow's edge no texel counts for more; where the light grazes m is in the thousands


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


MAP_DESCRIPTORS = (
    Metric(
        "m_pixel_median",
        "m, median",
        "Median over receiver pixels of the largest err_accurate, texel over pixel; above 1 the map is too coarse.",
        "texels in pixels",
        _over_lookups(np.median),
        worst=float("inf"),
        always=False,
        from_images=False,
    ),
    Metric(
        "m_pixel_p99",
        "m, p99",
        "99th percentile over receiver pixels of the largest err_accurate.",
        "texels in pixels",
        _over_lookups(lambda error: float(np.percentile(error, 99.0))),
        worst=float("inf"),
        always=False,
        from_images=False,
    ),
    Metric(
        "undersampled",
        "undersampled",
        "Share of the receiver pixels that look into the map whose err_accurate is above 1 in some direction.",
        "share",
        _over_lookups(lambda error: float(np.mean(error > 1.0))),
        always=False,
        from_images=False,
    ),
    Metric(
        "map_waste",
        "map wasted",
        "Share of the map's area outside of what the eye can see of the receivers' box; mean over layers.",
        "share",
        lambda m: None if m.map_use is None else m.map_use.waste,
        always=False,
        from_images=False,
    ),
    Metric(
        "map_unread",
        "map unread",
        "Share of the map's texels that no receiver pixel falls into; it depends on the number of pixels.",
        "share",
        lambda m: None if m.map_use is None else m.map_use.unread,
        always=False,
        from_images=False,
    ),
    Metric(
        "m_edge",
        "m, edges",
        f"Mean of the largest err_accurate, up to {MOST_PIXELS:g}, at pixels beside a hard edge of the reference.",
        "texels in pixels",
        _m_edge,
        worst=float("inf"),
        always=False,
        from_images=False,
    ),
    Metric(
        "rmse_predicted",
        "RMSE predicted",
        "What the map's texels would do to the reference's hard edges, were each a quarter of m pixels off: "
        "sqrt(m_edge times the share of pixels beside an edge / 8). Too large: m is that of the worst direction.",
        "visibility",
        _predicted_rmse,
        worst=float("inf"),
        always=False,
        from_images=False,
    ),
)
MAP_METRICS = tuple(metric.name for metric in MAP_DESCRIPTORS)
