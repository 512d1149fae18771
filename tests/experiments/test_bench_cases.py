"""The bench's longer cases in their smallest forms: references, whole frames, scaling, plots."""

from __future__ import annotations

import sys
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from experiments.bench import frames, plots, scaling
from experiments.bench.cases import CASES, run_case
from experiments.bench.llvmpipe import Llvmpipe
from experiments.bench.meshes import Mix, spheres_on_terrain, sunlit_scene
from experiments.bench.plan import Bench, Sizes
from experiments.bench.ray_peers import EMBREEX, MITSUBA, Mitsuba, ShadowRays, shadow_rays
from experiments.bench.references import OurRays
from experiments.bench.rows import PeerMissing, Row
from experiments.scenes import load_scene

SMALL = Mix(12, 1, 12, radii=(10.0, 40.0))
MOVING = Path(__file__).parents[2] / "configs" / "scenes" / "moving_blocker.yaml"
SUNLIT = sunlit_scene(spheres_on_terrain(SMALL), 6.0, 120.0)
TINY = Sizes(
    map_side=64,
    image=(64, 48),
    frame=(32, 18),
    mixes=dict.fromkeys(("10k", "250k", "2500k", "soft"), SMALL),
    scenes={"overlap": load_scene(MOVING), **dict.fromkeys(("paris", "winter", "bunny", "big_penumbra"), SUNLIT)},
    samples=4,
    walk_frames=2,
    reference=(48, 36),
    reference_frame=0,
    reference_counts=(4, 32),
    embree_rays=4000,
    triangle_mixes={"1e2": Mix(4, 0, 2), "1e3": SMALL},
    map_sides=(32, 64),
    images=((32, 24), (64, 48)),
    sample_counts=(1, 4),
    sampled_frame=(32, 24),
)
BENCH = Bench(TINY, 1, 1, "not wanted here")


def rows_of(name: str, bench: Bench = BENCH) -> dict[str, Row]:
    return {row.name: row for row in run_case(bench, name)}


@pytest.fixture
def few_techniques(monkeypatch: pytest.MonkeyPatch) -> None:
    known = frames.load_all()
    names = ("shadow_map", "tc_soft_paper", "multi_shadow_map")
    monkeypatch.setattr(frames, "load_all", lambda: {name: known[name] for name in names})


@pytest.mark.usefixtures("few_techniques")
def test_without_casters_frames_stand_beside_g_buffer_and_shading(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(frames, "FEW_MS_REPEATS", 2)
    rows = rows_of("nothing_casts")
    assert list(rows) == [f"nothing_casts.{name}" for name in ("shadow_map", "tc_soft_paper", "multi_shadow_map")]
    for row in rows.values():
        assert row.ours_ms and row.peer_ms and row.peer == "G-buffer and shading"
        assert row.target is not None and row.target.ratio == pytest.approx(0.952, abs=1e-3)


@pytest.mark.usefixtures("few_techniques")
def test_frames_say_where_their_time_goes() -> None:
    rows = rows_of("frames.paris")
    assert list(rows) == [f"frames.paris.{name}" for name in ("shadow_map", "tc_soft_paper", "multi_shadow_map")]
    for row in rows.values():
        assert row.ours_ms and row.peer is row.peer_ms is row.ratio is None
        shares: Any = row.figures["passes"]
        assert list(shares.values()) == sorted(shares.values(), reverse=True)
        assert sum(shares.values()) == pytest.approx(1.0, abs=1e-3)  # rounded to 4 digits each
        assert "only the camera moves, maps are kept" in row.note
    assert "samples: 4" in rows["frames.paris.multi_shadow_map"].note
    assert "samples" not in rows["frames.paris.shadow_map"].note
    assert "everything moves" in rows_of("frames.overlap")["frames.overlap.shadow_map"].note


@pytest.mark.usefixtures("few_techniques")
def test_frames_of_a_technique_whose_needs_are_not_met_say_why() -> None:
    hard = replace(TINY, scenes={"paris": sunlit_scene(spheres_on_terrain(SMALL), 0.0, 120.0)})
    rows = rows_of("frames.paris", Bench(hard, 1, 1, ""))
    refused = rows["frames.paris.tc_soft_paper"]
    assert refused.ours_ms is None and "needs a light with an area" in refused.note
    assert rows["frames.paris.shadow_map"].ours_ms


def test_frames_take_turns(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[int] = []

    def sides_of(sides: Any, repeats: int, **_: Any) -> list[float]:
        seen.append(len(sides))
        return [1.0] * len(sides)

    monkeypatch.setattr(frames, "interleaved_medians", sides_of)
    rows = rows_of("frames.paris")
    assert seen == [sum(row.ours_ms is not None for row in rows.values())]  # one call times them all
    rows_of("tc_against_pcss")
    assert seen[1:] == [2]


def test_temporal_frames_beside_pcss() -> None:
    row = rows_of("tc_against_pcss")["tc_against_pcss"]
    assert row.ours_ms and row.peer_ms and row.peer == "our pcss 16/16"
    assert row.target is not None and row.target.ratio == 2.0


def test_a_frame_beside_three_passes_draws_its_map_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    walks: list[frames.Walk] = []

    class Noted(frames.Walk):
        def __init__(self, *arguments: Any, **options: Any) -> None:
            super().__init__(*arguments, **options)
            walks.append(self)

    monkeypatch.setattr(frames, "Walk", Noted)
    row = rows_of("paris_1024x768")["paris_1024x768"]
    assert row.ours_ms and row.peer == "llvmpipe" and "is missing: not wanted here" in row.note
    assert "light depth map" in walks[0].shares()


@pytest.mark.peers
def test_both_maps_of_a_frame_are_the_same() -> None:
    try:
        peer = Llvmpipe(1)
    except PeerMissing as missing:
        pytest.skip(f"llvmpipe is missing: {missing}")
    try:
        row = rows_of("paris_1024x768", Bench(TINY, 1, 1, peer))["paris_1024x768"]
    finally:
        peer.close()
    assert row.mismatch is not None and row.mismatch <= 2e-3  # rounding at edges: a handful of 4096 texels


def cast_by_hand(rays: ShadowRays, vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Visibility of the rays' pixels by a test of every triangle (Moeller and Trumbore 1997), in float64."""
    a, b, c = (vertices[faces[:, k]].astype(float) for k in range(3))
    out = np.zeros(len(rays.origin_ws))
    for i, (origin, normal) in enumerate(zip(rays.origin_ws.astype(float), rays.normal_ws, strict=True)):
        for light in rays.light_ws.astype(float):
            way = light[:3] - light[3] * origin
            if rays.lit_by_front[i] and normal @ way <= 0.0:
                continue
            p = np.cross(way, c - a)
            scale = np.einsum("ij,ij->i", b - a, p)
            with np.errstate(divide="ignore", invalid="ignore"):
                u = np.einsum("ij,ij->i", origin - a, p) / scale
                q = np.cross(origin - a, b - a)
                v = q @ way / scale
                t = np.einsum("ij,ij->i", c - a, q) / scale
            hit = (u >= 0.0) & (v >= 0.0) & (u + v <= 1.0) & (t > 0.0) & ((light[3] == 0.0) | (t < 1.0))
            out[i] += not hit.any()
    return out / len(rays.light_ws)


def test_rays_for_the_peers_are_the_references_own() -> None:
    ours = OurRays(Bench(replace(TINY, reference=(16, 12)), 1, 1, ""), "paris", 8)
    ours.draw()
    rays = ours.rays()
    geometry = ours.session.geometry
    vertices, faces = geometry.points_ws.numpy(), geometry.caster_indices.numpy().reshape(-1, 3)
    theirs = rays.image(cast_by_hand(rays, vertices, faces))
    assert 0.0 < np.nanmean(ours.visibility) < 1.0
    assert ours.mismatch(theirs) <= 0.01  # a ray that grazes an edge, of 192 pixels at most one
    assert ours.mismatch(1.0 - theirs) > 0.5


@pytest.fixture
def few_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    """The cases of hundreds of rays with 32 of them, in two scenes."""
    for name in ("reference_256", "silhouettes_64"):
        case: Any = CASES[name]
        monkeypatch.setitem(CASES, name, partial(case, samples=32, scenes=("paris", "overlap")))


@pytest.mark.usefixtures("few_counts")
@pytest.mark.parametrize(("package", "peer"), [("mitsuba", MITSUBA), ("drjit", MITSUBA), ("embreex", EMBREEX)])
def test_a_missing_ray_caster_is_named(monkeypatch: pytest.MonkeyPatch, package: str, peer: str) -> None:
    for module in [name for name in sys.modules if name.split(".")[0] == package]:
        monkeypatch.setitem(sys.modules, module, None)
    monkeypatch.setitem(sys.modules, package, None)  # an import of it raises ImportError
    rows = rows_of("reference_256")
    assert list(rows) == [f"reference_256.{part}" for part in ("paris", "paris.embreex", "overlap", "overlap.embreex")]
    missing = [row for row in rows.values() if row.peer == peer]
    assert len(missing) == 2
    for row in missing:
        assert row.ours_ms and row.peer_ms is row.ratio is row.mismatch is None
        assert "is missing: " in row.note and "is not installed" in row.note


@pytest.mark.usefixtures("few_counts")
def test_silhouettes_are_a_technique_of_their_own(monkeypatch: pytest.MonkeyPatch) -> None:
    for package in ("mitsuba", "embreex"):
        monkeypatch.setitem(sys.modules, package, None)
    rows = rows_of("silhouettes_64")
    assert {name.split(".")[1] for name in rows} == {"paris", "overlap"} and all(row.ours_ms for row in rows.values())


@pytest.mark.peers
@pytest.mark.usefixtures("few_counts")
def test_ray_casters_see_what_the_reference_sees() -> None:
    pytest.importorskip("mitsuba")
    pytest.importorskip("embreex")
    rows = rows_of("reference_256")
    assert all(row.ours_ms and row.peer_ms for row in rows.values()), [row.note for row in rows.values()]
    for name, row in rows.items():
        if name == "reference_256.overlap.embreex":  # its light is near
            assert row.mismatch is None and "do not end at lights" in row.note
            continue
        # single rays that graze an edge: a few of 1728 pixels, or one or two of embreex' 125
        assert row.mismatch is not None and row.mismatch <= (2e-2 if row.peer == EMBREEX else 5e-3), row


@pytest.mark.peers
def test_a_part_of_the_pixels_is_scaled_to_all() -> None:
    ours = OurRays(BENCH, "paris", 8)
    ours.draw()
    rays = ours.rays()
    try:
        mitsuba = Mitsuba(ours.session, 1)
    except PeerMissing as missing:
        pytest.skip(str(missing))
    whole, part = mitsuba.upload(rays, rays.count), mitsuba.upload(rays, rays.count // 3)
    assert whole.draw() > 0.0 and part.draw() > 0.0
    assert whole.share == 1.0 and part.share == pytest.approx(1.0 / 3.0, abs=0.1)
    np.testing.assert_array_equal(whole.visibility()[part.kept], part.visibility())


def test_rays_over_counts_have_a_row_per_count_and_peer() -> None:
    rows = rows_of("scale_rays")
    assert list(rows) == ["scale_rays.4", "scale_rays.embreex.4", "scale_rays.32", "scale_rays.embreex.32"]
    figure = plots.draw(plots.PLOTS["scale_rays"], list(rows.values()))
    ours = figure.axes[0].get_lines()[0]
    np.testing.assert_allclose(np.asarray(ours.get_xdata(), float), [4.0, 32.0])


@pytest.mark.peers
def test_mitsuba_ends_its_rays_at_lights_within_the_scene() -> None:
    pytest.importorskip("mitsuba")
    sizes = replace(TINY, scenes={"paris": load_scene(MOVING)})
    ours = OurRays(Bench(sizes, 1, 1, ""), "paris", 32)
    ours.draw()
    session = ours.session
    try:
        mitsuba = Mitsuba(session, 1)
    except PeerMissing as missing:
        pytest.skip(str(missing))
    rays = shadow_rays(session, 32, "halton")
    traced = mitsuba.upload(rays, rays.count)
    traced.draw()
    assert (rays.light_ws[:, 3] == 1.0).all()
    assert ours.mismatch(rays.image(traced.visibility())) <= 5e-3  # as above
    with pytest.raises(PeerMissing, match="only suns"):
        mitsuba.direct(4)


def test_scaling_cases_have_a_row_per_size() -> None:
    found = {name: rows_of(name) for name in CASES if name.startswith("scale_")}
    assert all(row.ours_ms for rows in found.values() for row in rows.values())
    assert list(found["scale_triangles"]) == ["scale_triangles.1e2", "scale_triangles.1e3"]
    for row in found["scale_triangles"].values():
        assert row.ours_ms is not None
        triangles: Any = row.figures["triangles"]
        assert row.figures["ns_per_triangle"] == pytest.approx(1e6 * row.ours_ms / triangles)
    assert [row.figures["triangles"] for row in found["scale_triangles"].values()] == [88, 1248]
    assert list(found["scale_map"]) == ["scale_map.32", "scale_map.64"]
    assert {row.figures["pixels"] for row in found["scale_image"].values()} == {768, 3072}
    assert [row.figures["samples"] for row in found["scale_samples"].values()] == [1, 4, 1, 4]
    assert {f"scale_threads.{part}.1" for part in ("rasteriser", "pcss")} <= set(found["scale_threads"])


def test_threads_double_up_to_all_cores(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scaling, "default_threads", lambda: 6)
    names = list(rows_of("scale_threads"))
    assert names[:4] == [f"scale_threads.rasteriser.{n}" for n in (1, 2, 4, 6)]


def test_meshes_beyond_memory_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scaling, "_available_bytes", lambda: 200_000)
    rows = rows_of("scale_triangles")
    assert rows["scale_triangles.1e2"].ours_ms
    assert rows["scale_triangles.1e3"].ours_ms is None and "GB of memory" in rows["scale_triangles.1e3"].note


def test_plots_are_written_for_the_cases_that_ran(tmp_path: Path) -> None:
    rows = [row for name in ("scale_triangles", "scale_threads") for row in run_case(BENCH, name)]
    rows.append(Row("scale_map.64", None, note="not measured"))
    written = plots.write_plots(rows, tmp_path)
    assert [path.stem for path in written] == ["scale_threads", "scale_triangles", "scale_triangles_each"]
    for path in written:
        with Image.open(path) as image:
            assert np.ptp(np.asarray(image.convert("L"))) > 200  # ink on paper


def test_plots_have_both_sides_and_units() -> None:
    rows = [
        Row(f"scale_triangles.{n}", 2.0 * n, "llvmpipe", 5.0 * n, figures={"triangles": 1000 * n}) for n in (1, 10, 100)
    ]
    figure = plots.draw(plots.PLOTS["scale_triangles_each"], rows)
    (axes,) = figure.axes
    ours, theirs = axes.get_lines()
    assert axes.get_xscale() == axes.get_yscale() == "log"
    assert axes.get_xlabel() == "triangles" and axes.get_ylabel() == "time per triangle [ns]"
    assert [text.get_text() for text in axes.get_legend().get_texts()] == ["ours", "llvmpipe"]
    np.testing.assert_allclose(np.asarray(ours.get_ydata(), float), 2000.0)
    np.testing.assert_allclose(np.asarray(theirs.get_ydata(), float), 5000.0)
