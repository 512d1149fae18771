"""``kind: analysis``: perspective error along the view vector from closed forms (Stingl 2011, section 5.8).

Writes analysis.csv with ``label,z,m_x,m_z`` at unit resolution ratios, both sides of each split border, factors.csv
with each curve's greatest errors and storage factor, published.csv where curves give the source's figures, and a plot.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from algorithms.projections.projection import WarpShape
from algorithms.projections.table import warps
from experiments.kinds.analysis.config import Analysis, Curve
from experiments.report.style import INK, Look, log_axis, save, styled
from experiments.results.environment import describe_identity, describe_machine
from experiments.results.published import compare_published, write_published
from experiments.results.result_tables import refusing
from experiments.results.store import Store
from experiments.results.tables import table_text, write_text
from wkernels.analysis.perspective_error import TiltedFrustum, partitioned_errors
from wkernels.projections.splits import pseudo_planes, shares_of_split, split_borders

COLUMNS = ("label", "z", "m_x", "m_z")
FACTORS = ("label", "splits", "warp", "m_x_max", "m_z_max", "storage_factor")
STEPS = 129  # depths per split


@dataclass(frozen=True, eq=False)
class Errors:
    """A curve's numbers.

    Attributes:
        curve: What they belong to.
        borders: Split planes (m + 1,), scene units.
        distances: n' of each split's warp, scene units.
        z, m_x, m_z: (m * STEPS,) each.
    """

    curve: Curve
    borders: np.ndarray
    distances: tuple[float, ...]
    z: np.ndarray
    m_x: np.ndarray
    m_z: np.ndarray

    @property
    def planes(self) -> tuple[float, float]:
        """Depths of the pseudo planes; near and far where there are none."""
        return pseudo_planes(self.borders[0], self.borders[-1], self.curve.pseudo_near, self.curve.pseudo_far)


def errors_of(curve: Curve, fov_deg: float) -> Errors:
    """Evaluates one curve."""
    half_fov, gamma = np.radians(0.5 * fov_deg), np.radians(curve.light_angle_deg)
    borders = split_borders(
        curve.near, curve.far, curve.splits, curve.scheme, curve.blend, curve.pseudo_near, curve.pseudo_far
    )
    planes = pseudo_planes(curve.near, curve.far, curve.pseudo_near, curve.pseudo_far)
    warp = warps()[curve.warp]()
    distances = []
    for i, (near, far) in enumerate(itertools.pairwise(borders)):
        frustum = TiltedFrustum(float(near), float(far), half_fov, gamma)
        before, behind = shares_of_split(borders, i, planes)
        folded = float(min(gamma, np.pi - gamma))
        shape = WarpShape(
            near=frustum.near,
            far=frustum.far,
            z_0=frustum.end_depths[0],
            z_1=frustum.end_depths[1],
            extent=frustum.extent,
            half_fov=half_fov,
            gamma=folded,
            pseudo_near=before,
            pseudo_far=behind,
            distance=curve.warp_distance,
        )
        distances.append(warp.bounded_distance(shape))
    z, m_x, m_z = partitioned_errors(borders, half_fov, distances, gamma, STEPS)
    return Errors(curve, borders, tuple(distances), z, m_x, m_z)


def run_analysis(analysis: Analysis, out: str | Path) -> Path:
    """Evaluates all curves and writes the result folder.

    Returns:
        The table.

    Raises:
        InputError: The folder cannot be written or holds something else.
    """
    out = Path(out)
    environment = {
        "identity": describe_identity(analysis.to_yaml(), None),
        "run": {"name": analysis.name, "kind": "analysis", "labels": [curve.label for curve in analysis.curves]},
        "environment": describe_machine("cpu", 1),
        "metrics": {},
    }
    Store.open(out, analysis.to_yaml(), environment, resume=False)
    found = [errors_of(curve, analysis.camera.fov_deg) for curve in analysis.curves]
    rows = [
        {"label": e.curve.label, "z": float(z), "m_x": float(m_x), "m_z": float(m_z)}
        for e in found
        for z, m_x, m_z in zip(e.z, e.m_x, e.m_z, strict=True)
    ]
    with refusing(out):
        write_text(out / "analysis.csv", table_text(COLUMNS, rows))
        write_text(out / "factors.csv", table_text(FACTORS, [_factors(e) for e in found]))
        published = {e.curve.label: e.curve.published for e in found}
        write_published(out, compare_published(published, {e.curve.label: _quantities(e) for e in found}))
        save(plot_errors(found), out / "plots" / "perspective_error", ["png", "svg"])
    return out / "analysis.csv"


def _factors(errors: Errors) -> dict[str, str | int | float]:
    m_x, m_z = float(errors.m_x.max()), float(errors.m_z.max())
    curve = errors.curve
    factor = curve.splits * m_x * m_z
    return dict(zip(FACTORS, (curve.label, curve.splits, curve.warp, m_x, m_z, factor), strict=True))


def _quantities(errors: Errors) -> dict[str, float]:
    """Values of ``experiments.schema.published.CURVE_QUANTITIES``."""
    out: dict[str, float] = {}
    for name, m in (("m_x", errors.m_x), ("m_z", errors.m_z)):
        values = (m[0], m[-1], m.min(), m.max())
        out |= {f"{name}_{at}": float(v) for at, v in zip(("near", "far", "min", "max"), values, strict=True)}
    return out | {"storage_factor": errors.curve.splits * out["m_x_max"] * out["m_z_max"]}


def plot_errors(found: list[Errors]) -> Figure:
    """m_x and m_z side by side; a mark at each side of a split border, dotted lines at pseudo planes."""
    look = Look([e.curve.label for e in found])
    with styled():
        figure = Figure(figsize=(11.0, 4.6), dpi=100)
        axes_x, axes_z = figure.subplots(1, 2)
        for axes, name in ((axes_x, "m_x"), (axes_z, "m_z")):
            for e in found:
                m, label = getattr(e, name), e.curve.label
                text = f"{label}: {m.min():.3g} to {m.max():.3g}"
                axes.plot(e.z, m, color=look.color(label), ls=look.dash(label), lw=1.5, label=text)
                sides = np.r_[STEPS - 1 : len(m) - 1 : STEPS, STEPS : len(m) : STEPS]
                axes.plot(e.z[sides], m[sides], look.marker(label), color=look.color(label), markersize=4.5)
                if e.curve.scheme == "pseudo":
                    for plane, tag in zip(e.planes, ("PN", "PF"), strict=True):
                        axes.axvline(plane, color=look.color(label), ls=":", lw=1.0)
                        where = axes.get_xaxis_transform()
                        axes.text(plane, 1.01, tag, transform=where, ha="center", fontsize=8, color=look.color(label))
            axes.axhline(1.0, color=INK, lw=0.8, alpha=0.6)
            axes.set_xlabel("eye depth z [scene units]; marks: both sides of split borders")
            axes.set_ylabel(f"{name} [pixels a texel spans], above 1 undersampled")
            log_axis(axes, "x", [e.z for e in found])
            log_axis(axes, "y", [*(getattr(e, name) for e in found), [1.0]])
            axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.16), fontsize=8)
        figure.tight_layout()
        return figure
