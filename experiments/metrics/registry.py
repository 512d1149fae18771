"""Error measures of one visibility image, as a table of descriptors.

Every metric is a number over *receiver pixels*: those where neither the visibility nor the reference is NaN. What
cannot be measured is None, never 0. A descriptor carries a version, which is stored with the results and grows when its
definition changes, so that numbers of different definitions are never mixed.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from experiments.metrics.map_metrics import MAP_DESCRIPTORS, MAP_METRICS
from experiments.metrics.measured import HARD_EDGE, Measured, Metric, beside_hard_edge
from experiments.metrics.shadow_scores import SCORE_DESCRIPTORS, SCORES

__all__ = [
    "GROUPS",
    "HARD_EDGE",
    "MAP_METRICS",
    "METRICS",
    "ROUNDING",
    "SCORES",
    "Measured",
    "Metric",
    "beside_hard_edge",
    "distinguishable",
    "evaluate",
    "flip_map",
    "outdated",
    "signed_error",
]

ROUNDING = 1e-6
"""Of the change of a float32 visibility that is carried from frame to frame: less is none."""
FLIP_PIXELS_PER_DEGREE = 67.02  # a 0.7 m wide 4K screen seen from 0.7 m, the value of the FLIP paper


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
    change = _rms_of_finite(m.visibility - m.previous, np.where(beside_hard_edge(m.visibility), np.nan, m.visibility))
    return 0.0 if change is not None and change < ROUNDING else change


def _flicker_edges(m: Measured) -> float | None:
    if m.previous_across_edges is None:
        return None
    return _rms_of_finite(m.visibility - m.previous_across_edges, m.visibility)


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
            _over_errors(_root_mean_square),
        ),
        Metric(
            "mean_signed_error",
            "mean signed error",
            "Mean of visibility minus reference; negative = darker than the reference.",
            "visibility",
            _over_errors(np.mean),
        ),
        Metric(
            "p99_error",
            "p99 error",
            "99th percentile of |visibility - reference|.",
            "visibility",
            _over_errors(lambda error: float(np.percentile(np.abs(error), 99.0))),
        ),
        Metric(
            "flip",
            "FLIP",
            f"Mean FLIP of visibility shown as linear grey, {FLIP_PIXELS_PER_DEGREE} pixels per degree.",
            "FLIP",
            _flip,
            always=False,
        ),
        Metric(
            "standard_error",
            "standard error",
            "Root mean square of the technique's own standard error; only techniques that sample the light have one.",
            "visibility",
            _standard_error,
        ),
        Metric(
            "reference_standard_error",
            "reference standard error",
            "Root mean square of the reference's standard error: what lies within twice of it cannot be told apart.",
            "visibility",
            _reference_standard_error,
            worst=0.5,
        ),
        Metric(
            "flicker",
            "flicker",
            "Root mean square change of visibility since the frame before, at surface points seen in both and beside a "
            "hard edge in neither, where what a pixel shows depends on where its centre lies. In summaries empty where "
            "that is no change on any frame, as for most hard shadows: flicker_edges has theirs.",
            "visibility",
            _flicker,
            always=False,
            from_images=False,
            version=2,  # 1 counted pixels beside hard edges, which flicker under every technique
        ),
        Metric(
            "flicker_edges",
            "flicker with edges",
            "As flicker, with hard edges: compares techniques whose edges are not equally hard; exact hard ones have "
            "some of it, too.",
            "visibility",
            _flicker_edges,
            always=False,
            from_images=False,
        ),
        *MAP_DESCRIPTORS,
        *SCORE_DESCRIPTORS,
    )
}

GROUPS: Mapping[str, tuple[str, ...]] = {"sampling": MAP_METRICS}
"""Names under ``metrics`` in an experiment file that stand for several."""


def evaluate(names: frozenset[str], measured: Measured) -> dict[str, float | None]:
    """All metrics in ``names`` and those that are always on; the others, and what has no inputs, are None."""
    return {
        metric.name: metric.evaluate(measured) if metric.always or metric.name in names else None
        for metric in METRICS.values()
    }


def outdated(versions: Mapping[str, int]) -> list[str]:
    """Sentences about the metrics of a folder that are defined otherwise now, or are new; see ``Metric.version``.

    Args:
        versions: ``metrics`` of its environment.json.
    """
    other = [m for m in METRICS.values() if m.name in versions and versions[m.name] != m.version]
    new = [m.title for m in METRICS.values() if m.name not in versions and m.always]
    out = [f"{m.title} is that of version {versions[m.name]}; this program has version {m.version}." for m in other]
    if new:
        out.append(f"Older than the scores {', '.join(new)}, which are missing.")
    return out


def distinguishable(difference: float | None, reference_standard_error: float | None) -> bool | None:
    """Whether a difference of errors exceeds twice the reference's standard error; None where either is unknown."""
    if difference is None or reference_standard_error is None:
        return None
    if not (np.isfinite(difference) and np.isfinite(reference_standard_error)):
        return None
    return bool(abs(difference) > 2.0 * reference_standard_error)
