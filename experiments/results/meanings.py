"""What the columns of result tables mean, one line each, for docs/formats.md."""

from __future__ import annotations

from collections.abc import Mapping

from experiments.metrics.registry import METRICS

COLUMNS: Mapping[str, str] = {
    "technique": "registered name",
    "label": "name of the run",
    "frame": "frame of the path",
    "scene": "name; `all` for the rows over all scenes",
    "frame_ms": "median over the repeats of all that the technique needs for the frame, milliseconds",
    "shadow_ms": "the same without G-buffer and shading",
    "fps": "1000 / frame_ms",
    "m_x_max": "greatest perspective error across the view, along the view vector; empty without a light map",
    "m_z_max": "the same along the view",
    "receiver_pixels": "pixels that show a receiver",
    "disoccluded": "share of these pixels that the frame before did not see",
    "repeat": "number of the repeat, from 0",
    "pass": "name of the pass; a product that is built has one of its own",
    "ms": "its time, median over the repeats, milliseconds",
    "what": "what was left out, or would have been",
    "reason": "why",
    "count": "how often, or of how many pixels",
    "error": "type and message",
    "frames": "frames that were rendered",
    "reference_frames": "those with a reference",
    "frame_ms_ratio": "median of the frames' own ratios to the baseline",
    "shadow_ms_ratio": "the same of `shadow_ms`",
    "pareto": "whether no label is better in both time and RMSE: yes or no",
    "distinguishable": "whether the RMSE exceeds twice the reference's standard error",
    "distinguishable_from_baseline": "whether its difference from the baseline's RMSE does",
    "predictor": "the column of frames.csv that predicts",
    "n": "points; frames for `(labels of one frame)`",
    "spearman": "rank correlation with `rmse`, -1 to 1",
    "quantity": "a column of summary.csv, or an error of a curve",
    "published": "what the source prints",
    "ours": "what was measured",
    "published_ratio": "the source's over its baseline's",
    "ours_ratio": "ours over ours",
    "ratio": "median of the paired time ratios to the baseline; for `all` the geometric mean over scenes",
    "error_to_reference": "`distinguishable` or `not distinguishable`",
    "on_front": "whether no label dominates it: yes or no; empty where it failed",
    "dominated_by": "labels that do",
    "budget_label": "whose time is the budget; empty for a number of milliseconds",
    "budget_ms": "the budget, milliseconds",
    "target_label": "whose error is the target",
    "target_rmse": "the target",
    "place": "1 is best; labels that cannot be told apart share a place",
    "step": "frame or samples of the step",
    "over": "`frames`, `samples`, or empty for a technique that is rendered once",
    "coverage_2se": "share of penumbra pixels whose true error lies within two standard errors",
    "penumbra_rmse": "RMSE where the reference lies between 0 and 1",
    "penumbra_standard_error": "root mean square of the standard error there",
    "n_effective": "median of 1 + v (1 - v) / s^2 there: as many independent samples have the standard error s",
    "zero_standard_error": "share of penumbra pixels whose standard error is 0",
    "penumbra_pixels": "pixels whose reference lies between 0 and 1",
    "last_step": "the last step that was measured",
    "rmse_slope": "exponent p of RMSE ~ step^p; empty along a path",
    "standard_error_slope": "the same of the standard error",
    "error_ratio": "penumbra_rmse / penumbra_standard_error",
    "coverage_2se_least": "least coverage over the later steps",
    "coverage_2se_median": "its median",
    "tau": "the test, 0 or 1",
    "psi": "mean of the tests so far, equation 2 of Scherzer et al. 2009",
    "variance": "its estimated variance, equation 3; empty at n = 1",
    "ms_without": "median frame time without the skip, milliseconds",
    "ms_with": "with all skips",
    "saving_ms": "median of the frames' differences",
    "case": "name of the stiff case",
    "level": "how stiff",
    "status": "`ok`, `declared` (breaks as its file says) or `broken`",
    "detail": "what was seen",
    "z": "eye depth",
    "m_x": "perspective error across the view at unit resolution ratios",
    "m_z": "the same along the view",
    "splits": "number of splits",
    "warp": "name of the warp",
    "storage_factor": "splits times the greatest m_x times the greatest m_z",
    "labels": "labels that both sweeps have",
}
"""By column name, where it means the same in every table."""

OWN: Mapping[str, Mapping[str, str]] = {
    "repeats.csv": {"frame_ms": "its time, milliseconds", "shadow_ms": "the same without G-buffer and shading"},
    "left_out.csv": {"frame": "frame of the path; empty where it is about the whole run"},
    "failures.csv": {
        "frame": "frame, or step; empty where it is about more",
        "what": "what failed: `technique`, `file`, `folder`, `reference`, `report`; of a sweep also `scene`",
    },
    "convergence.csv": {"n": "light samples behind the estimate; empty without a standard error"},
    "estimates.csv": {"n": "tests so far", "standard_error": "root of the variance"},
    "pareto.csv": {
        "frame_ms": "of the scene's summary.csv",
        "rmse": "of the scene's summary.csv; for `all` the geometric mean relative to the baseline",
    },
    "recommendation.csv": {
        "label": "the one with the least error in the baseline's time",
        "reason": "why, with numbers",
    },
    "savings.csv": {
        "what": "what the skip leaves out, or `everything`",
        "ratio": "median of the frames' ratios, without over with",
        "image_difference": "greatest difference of visibility between the two: 0",
    },
    "factors.csv": {"m_x_max": "greatest m_x of the curve", "m_z_max": "greatest m_z"},
}
"""By table, where a column means something of its own there."""


def meaning(table: str, column: str) -> str:
    """What a column of a table means; KeyError where nobody has said."""
    own = OWN.get(table, {})
    if column in own:
        return own[column]
    if column in METRICS:
        return METRICS[column].description
    return COLUMNS[column]
