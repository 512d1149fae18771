"""``wkernels bench``: the JSON contract, what is said of a missing peer, and that both sides draw the same images."""

from __future__ import annotations

import builtins
import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from experiments import cli
from experiments.bench import rows
from experiments.bench.cases import CASES, TARGETS, run_case, select
from experiments.bench.llvmpipe import Llvmpipe, PeerMissing, clip_matrix
from experiments.bench.meshes import Mix, camera, spheres_on_terrain
from experiments.bench.plan import Bench, Sizes
from experiments.bench.rows import Row, Target, interleaved_medians
from experiments.commands import bench as command
from wkernels.scene.views import HostView, eye_view

SMALL = Mix(12, 1, 12, radii=(10.0, 40.0))
TINY = Sizes(map_side=64, image=(64, 48), frame=(32, 18), mixes=dict.fromkeys(("10k", "250k", "2500k", "soft"), SMALL))
FIELDS = {"name", "ours_ms", "peer", "peer_ms", "ratio", "target", "reached", "mismatch", "note"}
PASSES = ("depth_10k", "depth_250k", "depth_2500k", "gbuffer_250k", "pcss_16_16")


@pytest.fixture
def peer() -> Any:
    """llvmpipe, where this machine has it."""
    try:
        opened = Llvmpipe(1)
    except PeerMissing as missing:
        pytest.skip(f"llvmpipe is missing: {missing}")
    yield opened
    opened.close()


@pytest.fixture
def no_moderngl(monkeypatch: pytest.MonkeyPatch) -> None:
    real = builtins.__import__

    def refuse(name: str, *arguments: Any, **options: Any) -> Any:
        if name == "moderngl":
            raise ImportError(name)
        return real(name, *arguments, **options)

    monkeypatch.setattr(builtins, "__import__", refuse)


def in_json(capsys: pytest.CaptureFixture[str], *wanted: str) -> dict[str, Any]:
    command.run_bench(cases=wanted, as_json=True, threads=1, repeats=1, sizes=TINY)
    result: dict[str, Any] = json.loads(capsys.readouterr().out)
    return result


def test_json_has_every_pass_and_its_environment(capsys: pytest.CaptureFixture[str]) -> None:
    result = in_json(capsys, *PASSES, "threads_1_2")
    assert set(result) == {"environment", "results"}
    assert result["environment"]["threads"] == 1 and result["environment"]["cpu"]
    environment = result["environment"]
    assert set(environment["peers"]) == {"llvmpipe", "mitsuba", "embreex"} and all(environment["peers"].values())
    assert {"cpu_flags", "load_average", "openblas_num_threads", "git", "cores"} <= set(environment)
    assert {"warp-lang", "numpy"} <= set(environment["packages"])
    by_name = {row["name"]: row for row in result["results"]}
    assert list(by_name) == [*PASSES, "threads_1_2.rasteriser", "threads_1_2.pcss"]
    for row in by_name.values():
        assert set(row) == FIELDS and row["ours_ms"] > 0.0
        assert (row["ratio"] is None) == (row["peer_ms"] is None)
        if row["ratio"] is not None:
            assert row["ratio"] == pytest.approx(row["peer_ms"] / row["ours_ms"])
    assert by_name["threads_1_2.pcss"]["peer"] == "1 thread"
    for name, row in by_name.items():
        assert row["target"] == f"ratio >= {TARGETS[name].ratio:g}"
        assert row["reached"] == (None if row["ratio"] is None else row["ratio"] >= TARGETS[name].ratio)


@pytest.mark.usefixtures("no_moderngl")
def test_a_missing_peer_is_named(capsys: pytest.CaptureFixture[str]) -> None:
    result = in_json(capsys, "depth_10k", "pcss_16_16")
    assert result["environment"]["peers"]["llvmpipe"].startswith("missing: moderngl is not installed")
    for row in result["results"]:
        assert row["ours_ms"] > 0.0 and row["peer"] == "llvmpipe"
        assert row["peer_ms"] is row["ratio"] is row["mismatch"] is None
        assert "llvmpipe is missing: moderngl is not installed" in row["note"]


def test_another_renderer_is_not_taken_for_llvmpipe(monkeypatch: pytest.MonkeyPatch) -> None:
    moderngl = pytest.importorskip("moderngl")

    class Context:
        def __init__(self) -> None:
            self.info = {"GL_RENDERER": "Some GPU"}

        def release(self) -> None: ...

    asked: list[int] = []

    def create(device_index: int, **_: Any) -> Context:
        asked.append(device_index)
        if device_index == 2:
            raise RuntimeError("no such device")
        return Context()

    monkeypatch.setattr(moderngl, "create_context", create)
    with pytest.raises(PeerMissing, match="device 1 is Some GPU; no such device"):
        Llvmpipe(1)
    assert asked == [0, 1, 2]


@pytest.mark.peers
@pytest.mark.parametrize("name", PASSES)
def test_both_sides_draw_the_same_image(name: str, peer: Llvmpipe) -> None:
    (row,) = CASES[name](Bench(TINY, 1, 1, peer), name)
    assert row.mismatch is not None and row.mismatch <= 2e-3  # rounding at edges: a handful of 3072 or 4096 pixels


@pytest.mark.peers
def test_a_different_image_is_a_mismatch(peer: Llvmpipe, monkeypatch: pytest.MonkeyPatch) -> None:
    triangle_pass, pcss_pass = peer.triangle_pass, peer.pcss_pass

    def shifted(vertices: np.ndarray, *others: Any) -> Any:
        return triangle_pass(vertices + np.array([0.0, 10.0, 0.0]), *others)

    def without_casters(images: dict[str, np.ndarray], taps: Any, **values: Any) -> Any:
        return pcss_pass({**images, "map_depth": np.full_like(images["map_depth"], 1e6)}, taps, **values)

    monkeypatch.setattr(peer, "triangle_pass", shifted)
    monkeypatch.setattr(peer, "pcss_pass", without_casters)
    for name in ("depth_10k", "gbuffer_250k", "pcss_16_16"):
        (row,) = CASES[name](Bench(TINY, 1, 1, peer), name)
        assert row.mismatch is not None and row.mismatch > 0.02, name


def test_unknown_case_ends_with_status_2(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(sys, "argv", ["wkernels", "bench", "--case", "depth_10k", "--case", "depht_10k"])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    assert ended.value.code == 2
    captured = capsys.readouterr()
    assert captured.err == "error: --case: there is no case 'depht_10k'. Did you mean 'depth_10k'?\n"
    assert not captured.out


def test_cases_are_selected_by_their_beginnings() -> None:
    assert select(["pcss", "depth_2"]) == ["depth_250k", "depth_2500k", "pcss_16_16"]
    assert select([]) == list(CASES)


def test_list_names_every_case_and_times_nothing(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["wkernels", "bench", "--list"])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    assert not ended.value.code
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines] == list(CASES)
    assert all(len(line.split()) > 3 for line in lines)  # each says what it times


def test_targets_belong_to_cases() -> None:
    assert all(any(row == case or row.startswith(f"{case}.") for case in CASES) for row in TARGETS)


def test_a_row_knows_whether_its_target_is_reached() -> None:
    fast, slow = Row("a", 2.0, "p", 5.0), Row("a", 4.0, "p", 5.0)
    least, most = Target(ratio=2.0), Target(ms=3.0)
    for target in (least, most):
        assert replace(fast, target=target).reached is True
        assert replace(slow, target=target).reached is False
    assert replace(fast, peer_ms=None, target=least).reached is None
    assert replace(fast, ours_ms=None, target=most).reached is None
    assert fast.reached is None


def test_further_figures_become_keys_of_the_row() -> None:
    assert Row("a", 1.0, figures={"ns_per_triangle": 3.0}).to_json()["ns_per_triangle"] == 3.0


def test_a_missing_scene_is_named(tmp_path: Path) -> None:
    sizes = replace(
        TINY, scenes=dict.fromkeys(("overlap", "paris", "winter", "bunny", "big_penumbra"), tmp_path / "gone.yaml")
    )
    for name in ("frames.overlap", "reference_256", "paris_1024x768", "scale_samples", "memory_1000_frames"):
        (row,) = run_case(Bench(sizes, 1, 1, "none"), name)
        assert row.name == name and row.ours_ms is None and "gone.yaml is missing" in row.note


def test_table_leaves_dashes_where_nothing_was_measured(capsys: pytest.CaptureFixture[str]) -> None:
    table = [Row("a", 2.0, "p", 5.0, 1e-4, "x"), Row("b", None, note="gone")]
    table += [Row("c", 2.0, target=Target(ms=1.0)), Row("d", 2.0, "p", 5.0, target=Target(ratio=2.5))]
    table += [Row("e", 2.0, "p", target=Target(ratio=2.5))]
    command.print_table(table)
    head, first, second, *asked = capsys.readouterr().out.splitlines()
    assert head.split() == ["case", "ours", "ms", "peer", "ms", "ratio", "mismatch", "target", "peer", "note"]
    assert first.split() == ["a", "2.00", "5.00", "2.50", "1.0e-04", "-", "p", "x"]
    assert second.split() == ["b", "-", "-", "-", "-", "-", "-", "gone"]
    assert asked[0].split() == ["c", "2.00", "-", "-", "-", "<=", "1", "ms", "MISSED", "-"]
    assert asked[1].split() == ["d", "2.00", "5.00", "2.50", "-", "ratio", ">=", "2.5", "reached", "p"]
    assert asked[2].split() == ["e", "2.00", "-", "-", "-", "ratio", ">=", "2.5", "unknown", "p"]


def test_sides_take_turns_and_warm_ups_do_not_count() -> None:
    turns: list[str] = []

    def side(name: str, times: list[float]) -> rows.Timed:
        waiting = iter([1e6] * rows.WARM_UPS + times)

        def run() -> float:
            turns.append(name)
            return next(waiting)

        return run

    assert interleaved_medians([side("a", [3.0, 1.0, 2.0]), side("b", [7.0, 9.0, 50.0])], 3) == [2.0, 9.0]
    assert "".join(turns[2 * rows.WARM_UPS :]) == "ababab"


def test_a_round_of_timed_runs_is_always_made_and_none_begins_too_late() -> None:
    runs: list[int] = []

    def side() -> float:
        runs.append(len(runs))
        return 1.0

    assert interleaved_medians([side], 5, warm_ups=0, most_s=0.0) == [1.0]
    assert len(runs) == 1


def test_mesh_is_what_its_mix_says() -> None:
    vertices, faces = spheres_on_terrain(SMALL)
    assert len(faces) == 12 * 80 + 2 * 12**2 and faces.max() == len(vertices) - 1
    terrain = faces[12 * 80 :]
    a, b, c = (vertices[terrain[:, k]] for k in range(3))
    assert (np.cross(b - a, c - a)[:, 1] > 0.0).all()
    ball = vertices[faces[:80]]
    centre = ball.reshape(-1, 3).mean(axis=0)
    normals = np.cross(ball[:, 1] - ball[:, 0], ball[:, 2] - ball[:, 0])
    assert (np.einsum("ti,ti->t", normals, ball.mean(axis=1) - centre) > 0.0).all()


def test_clip_matrix_spans_the_depth_range() -> None:
    perspective = eye_view(camera(), 8, 6, np.zeros(3))
    axes = {"right_ws": np.eye(3)[0], "up_ws": np.eye(3)[1], "forward_ws": -np.eye(3)[2], "eye_ws": np.zeros(3)}
    orthographic = HostView(**axes, window=(-1, 1, -1, 1), near=2.0, far=7.0, width=8, height=6, perspective=False)
    for view in (perspective, orthographic):
        for depth, expected in ((view.near, -1.0), (view.far, 1.0)):
            x, y, z, w = clip_matrix(view) @ np.append(view.eye_ws + depth * view.forward_ws, 1.0)
            assert (x / w, y / w, z / w) == pytest.approx((0.0, 0.0, expected), abs=1e-9)
