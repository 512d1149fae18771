"""Rows of stability.csv: techniques x cases x levels."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from algorithms.plugins import find
from algorithms.projections.composition import compose
from algorithms.technique import Technique
from experiments.kinds.stability.cases import CASES, HISTORY_FRAMES, Case, Level, Setting
from experiments.kinds.stability.judge import Truth, Verdict, judge
from experiments.kinds.stability.shapes import LIGHT_KINDS
from experiments.results.tables import Row, cell
from wkernels.errors import InputError
from wkernels.frame.session import FrameResult, Session
from wkernels.scene.geometry import Geometry

COLUMNS = ("technique", "case", "level", "status", "detail")
SMALL: Mapping[str, int] = {"resolution": 512, "samples": 16}  # shared parameters that cost time
TRUTH_SAMPLES, TRUTH_SEED = 256, 7


def light_kind_of(technique: type[Technique]) -> str:
    """The first kind of light that a technique works with, those with an area first."""
    needs = technique.needs
    return next(kind for kind in LIGHT_KINDS if kind in needs.lights and not (needs.area and kind == "point"))


def concerned(technique: type[Technique], case: Case) -> bool:
    """Whether a case means anything to a technique."""
    return case.needs is None or case.needs in technique.Params.model_fields


def examine(
    techniques: Mapping[str, type[Technique]],
    cases: Sequence[str],
    *,
    device: str,
    threads: int | None,
    skips: bool = True,
) -> Iterator[Row]:
    """Rows of stability.csv, level by level.

    Args:
        techniques: By name.
        cases: Keys of ``CASES``.
        device: Warp device.
        threads: CPU threads; None for all.
        skips: Whether work that a scene cannot need may be left out.
    """
    for name in cases:
        case = CASES[name]
        easy: dict[str, float | None] = {}
        for level in case.levels:
            views: dict[str, Stage | Verdict] = {}
            for technique in techniques.values():
                if not concerned(technique, case):
                    continue
                kind = light_kind_of(technique)
                if kind not in views:
                    views[kind] = _staged(case, level, kind, device, threads, skips)
                stage, first = views[kind], level == case.levels[0]
                limit = None if first else easy.get(technique.name)
                verdict = stage if isinstance(stage, Verdict) else stage.verdict(technique, limit, case.judged)
                if first:
                    easy[technique.name] = verdict.rmse
                yield _row(technique, case, level, verdict)


def _staged(case: Case, level: Level, kind: str, device: str, threads: int | None, skips: bool) -> Stage | Verdict:
    """A level's scene with its truths; the verdict over every technique where it has none."""
    try:
        return Stage(case.build(level, kind), device, threads, skips)
    except Exception as error:
        return Verdict(True, f"there is nothing to compare with: {type(error).__name__}: {error}", None)


def _row(technique: type[Technique], case: Case, level: Level, verdict: Verdict) -> Row:
    status, detail = "ok", verdict.detail
    reason = technique.stability_limits.get(case.name)
    if verdict.broken:
        status = "declared" if reason else "broken"
        detail = f"{detail}; {reason}" if reason else detail
    return {
        "technique": technique.name, "case": case.name, "level": cell(level), "status": status, "detail": detail,
    }  # fmt: skip


class Stage:
    """One level's scene on the device, with its truths.

    Args:
        setting: The level.
        device: Warp device.
        threads: CPU threads; None for all.
        skips: Whether work that the scene cannot need may be left out.
    """

    def __init__(self, setting: Setting, device: str, threads: int | None, skips: bool = True) -> None:
        self.setting, self.device, self.threads, self.skips = setting, device, threads, skips
        self.geometry = Geometry(setting.scene, device, threads)
        hard, soft = find("ray_cast_point_shadow"), find("reference_multisample")
        fine = {"samples": TRUTH_SAMPLES}
        self.truth = Truth(
            hard=self._render(hard(), TRUTH_SEED).visibility,
            soft=self._render(soft(soft.Params(**fine)), TRUTH_SEED).visibility,
        )

    def verdict(self, technique: type[Technique], easy: float | None, judged: bool) -> Verdict:
        """Renders and judges (``judge``). Input that a technique refuses with a message is no defect; all else is."""
        try:
            result = self._render(technique(self._params(technique)), 1)
        except InputError as error:
            return Verdict(False, f"refused: {error.message}", None)
        except (Exception, SystemExit) as error:
            return Verdict(True, f"{type(error).__name__}: {error}", None)
        return judge(result, self.truth, easy, judged)

    def _params(self, technique: type[Technique]) -> Any:
        fields = technique.Params.model_fields
        values = {name: min(value, fields[name].default) for name, value in SMALL.items() if name in fields}
        for name, value in self.setting.params.items():
            if name in fields:
                most = [item.le for item in fields[name].metadata if hasattr(item, "le")]
                values[name] = min([value, *most])
        return technique.Params(**values)

    def _render(self, technique: Technique, seed: int) -> FrameResult:
        width, height = self.setting.size
        session = Session(
            self.geometry,
            width=width,
            height=height,
            device=self.device,
            threads=self.threads,
            seed=seed,
            projection=compose(self.setting.projection),
            skips=self.skips,
        )
        frames = range(HISTORY_FRAMES) if self.setting.walks else [0] * HISTORY_FRAMES
        for index in frames if technique.needs.history else frames[-1:]:
            session.begin(index)
            result = session.render(technique)
            session.advance()
        return result


def breaking_points(rows: Sequence[Mapping[str, str]]) -> dict[tuple[str, str], tuple[str, str]]:
    """By technique and case: the worst status, and the first level that has it (empty where all is well)."""
    order = ("ok", "declared", "broken")
    out: dict[tuple[str, str], tuple[str, str]] = {}
    for row in rows:
        key = (row["technique"], row["case"])
        held = out.get(key, ("ok", ""))
        worse = order.index(row["status"]) > order.index(held[0])
        out[key] = (row["status"], row["level"]) if worse else held
    return out
